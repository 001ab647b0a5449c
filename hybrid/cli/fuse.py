"""``hybrid fuse``: several photos of one film in, one film out."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Annotated

import tyro

from hybrid.cli.options import PhotoOptions, made_by, parse, photos_among
from hybrid.cli.rectify_files import further_pictures, left_out_photos, report_lines, warnings_of
from hybrid.files import make_folder
from hybrid.image_io import read_photo
from hybrid.outputs import write_result
from hybrid.pipeline import Rectifier, RectifyConfig


@dataclass(frozen=True)
class FuseOptions(PhotoOptions):
    """Make one film from two or more photos of it, taken with the phone or the lamps moved, so that glare vanishes.

    Writes the same files as ``hybrid rectify``, named after the first photo: NAME_fused_film.png and so on. Photos in
    which no film is found are left out. NAME_fused_rectified and the photo beside the film come from the first photo
    that is OK, or else from the first that shows the film, and keep its glare. Photos of different films are refused;
    the exit code is then 1.
    """

    config: Annotated[RectifyConfig, tyro.conf.arg(name="")] = field(default_factory=RectifyConfig)
    """How to rectify and fuse."""


def run(arguments: list[str]) -> int:
    """Parse the command line and fuse; 0 if the photos gave a film."""
    options = parse(FuseOptions, PhotoOptions, arguments, "hybrid fuse", RectifyConfig.of)
    paths = photos_among(options.photos)
    if len(paths) < 2:
        told = "name two or more photos of one film, for example: hybrid fuse a.jpg b.jpg -o out"
        print(f"hybrid fuse: {told}", file=sys.stderr)
        return 2
    make_folder(options.out)
    result = Rectifier(options.config).fuse(paths, [path.name for path in paths])
    made = made_by(options.effort, RectifyConfig.of(options.effort), options.config)
    shown = read_photo(paths[result.photo])
    files = write_result(options.out, paths, shown, result, options.rectified_format, made, options.dicom)
    warnings = [*warnings_of(result), *left_out_photos(paths, result), *further_pictures(paths)]
    print("\n".join(report_lines(paths[0], result, files, warnings, options.verbose)))
    if not options.verbose:
        for stage in result.stages:
            if stage.name == "fuse":
                print(f"  {stage.name}: {stage.reason}")
    return 0 if result.status.has_film else 1
