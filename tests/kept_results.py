"""Check that a benchmark does not mix its kept results with results of other settings."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import benchmarks.machine
from hybrid.errors import ConfigError


def refused_elsewhere(go_on: Callable[[], object], data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Resuming is refused on another processor, and then with other photos in ``data``, which this changes."""
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr(benchmarks.machine, "processor", lambda: "another")
        with pytest.raises(ConfigError, match="results of other settings"):
            go_on()
    (shard,) = data.glob("*.tar")
    shard.write_bytes(shard.read_bytes()[:-1] + b"x")  # in the tar's padding
    with pytest.raises(ConfigError, match="results of other settings"):
        go_on()
