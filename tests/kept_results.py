"""That a benchmark's kept results are not put together with others."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import benchmarks.machine
from hybrid.errors import ConfigError


def refused_elsewhere(go_on: Callable[[], object], data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Going on with what is there is refused on another processor, and then with other photos in ``data``, which is
    changed."""
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(benchmarks.machine, "processor", lambda: "another")
        with pytest.raises(ConfigError, match="results of other settings"):
            go_on()
    (shard,) = data.glob("*.tar")
    shard.write_bytes(shard.read_bytes()[:-1] + b"x")  # in what fills a tar up
    with pytest.raises(ConfigError, match="results of other settings"):
        go_on()
