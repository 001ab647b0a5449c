"""``hybrid rectify``: the options, the run over the photos, the exit code."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from hybrid.cli_options import parse
from hybrid.outputs import RectifiedFormat, rectify_files
from hybrid.pipeline import Effort, Rectifier, RectifyConfig


@dataclass(frozen=True)
class RectifyOptions:
    """Flatten photos of CT films.

    For each photo NAME this writes NAME_film.png (16 bit, light removed), NAME_rectified (flat, light kept),
    NAME_slices/01.png and so on, NAME_side_by_side.jpg and NAME.json. A photo that fails is told, and the next one
    follows; the exit code is 1 if any failed. Films that may be off are written too, and named at the end.
    """

    photos: tyro.conf.Positional[tuple[Path, ...]]
    """Photos: JPEG, PNG, TIFF, WebP or HEIC."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("out")
    """Folder for the results; it is made if need be."""

    rectified_format: RectifiedFormat = "jpg"
    """Format of the rectified photo."""

    effort: Effort = "default"
    """How much work a photo is worth; it sets the options below that are not named."""

    config: Annotated[RectifyConfig, tyro.conf.arg(name="")] = field(default_factory=RectifyConfig)
    """How to rectify."""


def run(arguments: list[str]) -> int:
    """Parse the command line and rectify; 0 if every photo gave a film."""
    options = parse(RectifyOptions, arguments, "hybrid rectify", RectifyConfig.of)
    if not options.photos:
        told = "no photos; name at least one, for example: hybrid rectify photo.jpg -o out"
        print(f"hybrid rectify: {told}", file=sys.stderr)
        return 2
    outcomes = rectify_files(
        options.photos, options.out, Rectifier(options.config), options.rectified_format, tqdm.write
    )
    failed = [outcome for outcome in outcomes if not outcome.ok]
    if len(outcomes) > 1:
        print(f"{len(outcomes) - len(failed)} of {len(outcomes)} photos flattened, in {options.out}")
        for outcome in failed:
            print(f"  failed: {outcome.photo}: {outcome.message}")
    for outcome in outcomes:
        if outcome.ok and not outcome.sure:
            print(f"warning: {outcome.photo}: {outcome.message}")
    return 1 if failed else 0
