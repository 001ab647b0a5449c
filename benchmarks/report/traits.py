"""What kind of photo a case is: cell style, light, bend and coverage, by which figures are split."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.photos.cases import Case
from benchmarks.photos.truth import load_photo
from benchmarks.report.results import CaseNote
from data_gen.card import light_of
from hybrid.draw import outline_curve

UNKNOWN = "unknown"


def note_of(case: Case) -> CaseNote:
    """The traits of a case, whatever size its photo is resized to."""
    height, width = case.photo().shape[:2]
    coverage = _coverage(outline_curve(case.backward), (height, width))
    if isinstance(case.source, Path):
        truth = load_photo(case.source.with_suffix(".npz"))
        bend = None if truth.xyz is None else _bend_deg(_normals(truth.xyz))
        return CaseNote(
            case.name, truth.style, _light_of(truth.meta), bend, coverage, (height, width), f"{truth.rows}x{truth.cols}"
        )
    shard, k = case.source
    record = shard.record(k)
    light, style = record.get("light", {}), record.get("style", UNKNOWN)
    known = light_of(light) if {"box", "lamps"} <= set(light) else UNKNOWN
    bend = None
    if shard.has("normal"):
        normal = shard.field("normal", k)
        bend = _bend_deg(normal[np.isfinite(normal).all(axis=-1)])
    grid = f"{record['rows']}x{record['cols']}" if {"rows", "cols"} <= set(record) else ""
    return CaseNote(case.name, style, known, bend, coverage, (height, width), grid)


def _light_of(meta: Mapping[str, Any]) -> str:
    """What lights a photo of another renderer, according to its metadata."""
    behind = "back" in meta.get("light", {}) or meta.get("through", 0) > 0
    return light_of({"box": behind, "lamps": meta.get("lamps")})


def _coverage(outline: Float[np.ndarray, "n 2"], size: tuple[int, int]) -> float:
    """Share of a picture of ``size`` within the outline."""
    drawn = np.zeros((256, 256), np.uint8)
    points = outline * (256 / np.array(size[::-1]))
    cv2.fillPoly(drawn, [np.rint(np.clip(points, -1e4, 1e4) * 16).astype(np.int32)], 1, shift=4)
    return float(drawn.mean())


def _normals(xyz: Float[np.ndarray, "n n 3"]) -> Float[np.ndarray, "m 3"]:
    """Unit normals of a lattice of points."""
    across, down = np.gradient(xyz.astype(np.float64), axis=1), np.gradient(xyz.astype(np.float64), axis=0)
    normal = np.cross(across, down).reshape(-1, 3)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _bend_deg(normal: Float[np.ndarray, "m 3"]) -> float | None:
    """The largest angle between normals spread over the film and their mean; None if there are no normals."""
    mean = normal.mean(axis=0, dtype=np.float64) if len(normal) else np.zeros(3)
    length = float(np.linalg.norm(mean))
    return float(np.degrees(np.arccos(np.clip(normal @ (mean / length), -1, 1)).max())) if length else None


__all__ = ["note_of"]
