"""The methods in ``benchmarks.run``: the floor, the scanner, the paper's networks, ``hybrid`` and its parts.

The paper's networks run twice. As wide as published, with random weights: this gives their run time, and no error
(``benchmarks.rivals.published``). With trained weights, from the named folder or the package: this gives their error,
and the run time of a network of that width. Each row says which it is.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.methods import METHODS, Flattened, Method, configured, path_in
from benchmarks.photos.cases import Case
from benchmarks.rivals.published import full_dewarpnet, full_dewarpnet_published, full_firenet
from benchmarks.rivals.scanner import map_of_corners, scan, true_corners
from hybrid.coords import opencv_from_photo
from hybrid.errors import ConfigError, describe
from hybrid.learn.reading.predict import PredictConfig
from hybrid.pipeline import RectifyConfig
from hybrid.rectify.edges.outline import OutlineConfig
from hybrid.rectify.edges.paths import EdgeConfig, PathConfig
from hybrid.rectify.film.deilluminate import DeilluminateConfig
from hybrid.rectify.grid.borders import BorderConfig
from hybrid.rectify.grid.repeat import RepeatConfig
from hybrid.rectify.refine.config import RefineConfig

Maker = Callable[[Path | None], Method | None]
"""Makes a method from a folder of weights; None where it needs weights that are not there."""

TOLD = "told the true map"

MAIN = "hybrid"
"""The pipeline with its default options."""

EFFORTS: dict[str, tuple[str, RectifyConfig]] = {
    "hybrid_fast": ("hybrid, fast", RectifyConfig.of("fast")),
    MAIN: ("hybrid", RectifyConfig.of("default")),
    "hybrid_thorough": ("hybrid, thorough", RectifyConfig.of("thorough")),
}
"""The pipeline at its efforts, by name: label and options. One line each; all run at every size."""

UNREAD = PathConfig(min_mass=2.0)
"""No probability reaches 2: the network runs, and its output does not count."""

CONFIGURATIONS: dict[str, tuple[str, RectifyConfig]] = {
    "hybrid_two_looks": ("hybrid, two looks", RectifyConfig(predict=PredictConfig(looks=2))),
    "hybrid_no_edges": (
        "hybrid, EdgeNet unheard (it runs all the same)",
        RectifyConfig(
            edges=EdgeConfig(paths=UNREAD),
            refine=RefineConfig(outline=OutlineConfig(band=0.05)),
        ),
    ),
    "hybrid_read_once": ("hybrid, edges not read again", RectifyConfig(edges=EdgeConfig(doubtful=0.0))),
    "hybrid_refined_once": ("hybrid, nothing refined again", RectifyConfig(tries=0)),
    "hybrid_no_borders": (
        "hybrid, BorderNet unheard (it runs all the same)",
        RectifyConfig(refine=RefineConfig(borders=BorderConfig(paths=UNREAD))),
    ),
    "hybrid_no_phases": ("hybrid, cells by the print alone", RectifyConfig(told_cells=False)),
    "hybrid_no_lines": ("hybrid, no rules or gutters", RectifyConfig(refine=RefineConfig(line_rounds=0))),
    "hybrid_no_repeats": (
        "hybrid, no repeated cells",
        RectifyConfig(refine=RefineConfig(repeat=RepeatConfig(min_correlation=2.0))),  # no correlation reaches 2
    ),
    "hybrid_no_spline": (
        "hybrid, spline never believed: the map that FilmNet gives",
        RectifyConfig(refine=RefineConfig(max_move=0.0)),
    ),
    "hybrid_light_kept": ("hybrid, light kept", RectifyConfig(light=DeilluminateConfig(even_light=float("inf")))),
}
"""The pipeline with one thing changed, by name: label and options. These run at the first size only."""

OWN = frozenset({"filmnet_one_look", "filmnet", *EFFORTS, *CONFIGURATIONS})
"""What belongs to this project; all others are rivals, except the floor."""


# ---------------------------------------------------------------- floor and scanner


def remap(weights: Path | None) -> Method:
    """The floor: one bilinear lookup by OpenCV through a given map, to a film of the common size."""

    def given(case: Case) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        at = opencv_from_photo(case.backward.dense(case.film_size()))
        return case.photo(), np.ascontiguousarray(at[..., 0]), np.ascontiguousarray(at[..., 1])

    def flatten(known: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Flattened:
        photo, x, y = known
        return Flattened(image=cv2.remap(photo, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    return Method("remap", lambda known: None, given, flatten, label="cv2.remap alone", unscored=TOLD)


def scanner(weights: Path | None) -> Method:
    """Four corners found by OpenCV."""
    return Method("scanner", scan, label="four-corner scanner")


def scanner_true(weights: Path | None) -> Method:
    """The scanner's upper bound: it is told the true corners."""
    return Method(
        "scanner_true",
        lambda known: map_of_corners(known[1]),
        lambda case: (case.photo(), true_corners(case.backward)),
        label="four corners, told the true ones",
    )


# ---------------------------------------------------------------- all


def _pipeline(name: str, label: str, config: RectifyConfig) -> Maker:
    return lambda weights: configured(name, replace(config, weights=path_in(weights, "filmnet")), label)


LINEUP: dict[str, Maker] = {
    "remap": remap,
    "scanner": scanner,
    "scanner_true": scanner_true,
    "dewarpnet_published_full": full_dewarpnet_published,
    "dewarpnet_full": full_dewarpnet,
    "firenet_full": full_firenet,
    "dewarpnet_published": METHODS["dewarpnet_published"],
    "dewarpnet": METHODS["dewarpnet"],
    "firenet": METHODS["firenet"],
    "firenet_uv": METHODS["firenet_uv"],
    "filmnet_one_look": METHODS["filmnet_one_look"],
    "filmnet": METHODS["filmnet"],
    **{name: _pipeline(name, label, config) for name, (label, config) in (EFFORTS | CONFIGURATIONS).items()},
}
"""All methods that are compared, in the order of the tables."""


def lineup(added: tuple[Path, ...] = ()) -> dict[str, Maker]:
    """All methods, including those of the files that were added.

    Raises:
        ConfigError: a file is not a Python module with a table METHODS, or a name is taken.
    """
    everyone = dict(LINEUP)
    for path in added:
        found = _methods_of(path)
        taken = sorted(set(found) & set(everyone))
        if taken:
            raise ConfigError(describe(what="--add", where=path, got=", ".join(taken), do="Choose other names."))
        everyone |= found
    return everyone


def _methods_of(path: Path) -> Mapping[str, Maker]:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ConfigError(describe(what="--add", where=path, got="no Python file", do="Name a .py file."))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    methods = getattr(module, "METHODS", None)
    if not isinstance(methods, dict) or not all(callable(make) for make in methods.values()):
        do = "Give it METHODS = {name: function of a folder of weights}, as benchmarks/methods.py says."
        raise ConfigError(describe(what="--add", where=path, got="no table METHODS", do=do))
    return methods


__all__ = ["CONFIGURATIONS", "EFFORTS", "LINEUP", "MAIN", "OWN", "TOLD", "Maker", "lineup"]
