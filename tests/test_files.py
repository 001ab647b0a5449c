"""Folders and files that are written: whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from hybrid.files import write_bytes


def test_failed_write_keeps_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.bin"
    write_bytes(path, b"old")

    def full_disk(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:1])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.bin"]


def test_the_longest_name_that_may_be_given_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / ("\u0444" * 125 + ".json")  # 255 bytes
    write_bytes(path, b"all")
    assert path.read_bytes() == b"all"


def test_a_file_stays_as_it_was_until_the_new_one_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.json"
    write_bytes(path, b"old")

    def breaks(*_: object) -> None:
        raise OSError("no more room")

    monkeypatch.setattr("hybrid.files.os.replace", breaks)
    with pytest.raises(OSError, match="no more room"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
