"""What the commands on photos have in common; ``--effort`` sets the default values of the stages' options."""

from __future__ import annotations

import argparse
import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from hybrid.command import with_flags
from hybrid.effort import Effort
from hybrid.errors import ConfigError, describe
from hybrid.image_io import SUFFIXES
from hybrid.outputs import FOLDERS, RectifiedFormat, is_result

Options = TypeVar("Options")

ALL = "--help-all"
"""Shows every option of every stage, hundreds in all; ``--help`` shows the few that most people need."""


@dataclass(frozen=True)
class PhotoOptions:
    """The options that most people need; those of the stages come on top."""

    photos: tyro.conf.Positional[tuple[Path, ...]]
    """Photos (JPEG, PNG, TIFF, WebP or HEIC), or folders of them; all must come before the first option."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """Folder for the results; it is created if needed. Results of the same photos in it are replaced; other photos of
    the same name get a number."""

    rectified_format: RectifiedFormat = "jpg"
    """Format of the rectified photo."""

    dicom: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Also write film and slices as DICOM Secondary Captures into NAME_dicom, without patient, date or spacing."""

    effort: Effort = "default"
    """How much work a photo is worth: fast takes four fifths of the time for a third more error, thorough refines
    doubtful films in four orientations. It sets the options of the stages that are not given."""

    verbose: Annotated[bool, tyro.conf.arg(aliases=["-v"]), tyro.conf.FlagCreatePairsOff] = False
    """Report what each stage saw and how long it took."""


def parse(
    kind: type[Options], few: type[PhotoOptions], arguments: list[str], prog: str, config_of: Callable[[Any], Any]
) -> Options:
    """The options that the arguments give; the help and options not given show the values of the chosen effort.

    kind: ``few``, which the shorter help shows, plus a field ``config``. config_of: returns the configuration of an
    effort; an effort unknown to it is reported like any other wrong option.
    """
    if {"-h", "--help"} & set(arguments):
        more = f"{inspect.getdoc(kind)}\n\nThe options of all stages: {prog} {ALL}."
        tyro.cli(few, args=["--help"], prog=prog, description=more, default=few(photos=()))
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    first.add_argument("--effort", nargs="?", default="default")
    effort = first.parse_known_args(arguments)[0].effort
    try:
        config_of(effort)
    except ConfigError:
        effort = "default"
    default: Any = kind(photos=(), effort=effort, config=config_of(effort))  # type: ignore[call-arg]
    try:
        _refuse_photos_like_options(arguments)
        return tyro.cli(kind, args=["--help" if a == ALL else a for a in arguments], prog=prog, default=default)
    except ConfigError as error:
        print(f"{prog}: {with_flags(str(error), kind)}", file=sys.stderr)
        raise SystemExit(2) from None


def _refuse_photos_like_options(arguments: Sequence[str]) -> None:
    """Refuse photos whose names begin with a dash, as ``*.jpg`` may give them: the rest would not be photos."""
    for word in arguments:
        if word.startswith("-") and Path(word).suffix.lower() in SUFFIXES and os.path.isfile(word):
            got, do = "a name that is taken for an option", f"Write ./{word}."
            raise ConfigError(describe(what="Photos", where=word, got=got, do=do))


def photos_among(paths: Sequence[Path]) -> list[Path]:
    """The photos named and those in named folders, without results of earlier runs; prints how many are left out.

    If only results are named, they are meant: ``*.jpg`` would have named their photos, too.
    A folder without any photo stands for itself: it is then reported as a photo that cannot be read.
    """
    named = [path for path in paths if not os.path.isdir(path)]
    meant = set(named) if all(map(is_result, named)) else set()
    files = [photo for path in paths for photo in (_photos_in(path) if os.path.isdir(path) else [path])]
    photos = [path for path in files if path in meant or not is_result(path)]
    less = len(files) - len(photos)
    if less:
        one, several = "is left out: it is a result of an earlier run", "are left out: they are results of earlier runs"
        print(f"{less} of these files {one if less == 1 else several}")
    return photos


def _photos_in(folder: Path) -> list[Path]:
    """Files with a photo's suffix directly in a folder, without hidden ones; the folder itself if there are none or if
    it cannot be listed. Links that lead nowhere are left for the reader to refuse."""
    try:
        shown = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    except OSError:
        return [folder]
    within = [path.name for path in shown if path.is_dir() and not path.name.endswith(FOLDERS)]
    if within:
        print(f"{folder}: folders within it are left out: {', '.join(within)}")
    return [path for path in shown if path.suffix.lower() in SUFFIXES and not path.is_dir()] or [folder]


def made_by(effort: Effort, usual: Any, config: Any) -> dict[str, Any]:
    """How a film is made, for its JSON: the effort, and the options (a dataclass) that differ from its usual ones."""
    return {"effort": effort, "options": _differing(asdict(usual), asdict(config))}


def _differing(usual: Mapping[str, Any], given: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Values that differ, by their dotted names."""
    found: dict[str, Any] = {}
    for name, value in given.items():
        if isinstance(value, Mapping):
            found |= _differing(usual[name], value, f"{before}{name}.")
        elif value != usual[name]:
            found[before + name] = value if _is_plain(value) else str(value)
    return found


def _is_plain(value: Any) -> bool:
    """Whether JSON can represent it, which is not so for infinity."""
    if isinstance(value, tuple):
        return all(map(_is_plain, value))
    return isinstance(value, (bool, int, str)) or (isinstance(value, float) and math.isfinite(value))


__all__ = ["PhotoOptions", "made_by", "parse", "photos_among"]
