"""The check against the path tracer, as far as it can run without one."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from benchmarks.radiance import main
from benchmarks.scenes.path_tracer import mitsuba


def test_without_the_path_tracer_it_is_told_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("benchmarks.radiance.check_open3d", lambda: None)
    monkeypatch.setitem(sys.modules, "drjit", None)
    mitsuba.cache_clear()
    assert main(["--json", str(tmp_path / "radiance.json")]) == 1
    assert capsys.readouterr().err.startswith("benchmarks.radiance: path tracer: got no Mitsuba. Install the package")
    assert not (tmp_path / "radiance.json").exists()
