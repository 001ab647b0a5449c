"""What kind of photo a case is: cell style, light, bend and coverage, for the splits of the figures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from benchmarks.cases import Case
from benchmarks.photos import load_photo
from benchmarks.results import CaseNote
from data_gen.card import bend_of, light_of
from hybrid.draw import outline_curve

UNKNOWN = "unknown"


def note_of(case: Case) -> CaseNote:
    """The traits of a case, whatever size its photo is resized to."""
    height, width = case.photo().shape[:2]
    coverage = _coverage(outline_curve(case.backward), (height, width))
    if isinstance(case.source, Path):
        truth = load_photo(case.source.with_suffix(".npz"))
        light = "light box" if "back" in truth.meta.get("light", {}) else "room"
        bend = None if truth.xyz is None else _bend_deg(truth.xyz)
        return CaseNote(case.name, truth.style, light, bend, coverage, (height, width), f"{truth.rows}x{truth.cols}")
    shard, k = case.source
    record = shard.record(k)
    light, style = record.get("light", {}), record.get("style", UNKNOWN)
    known = light_of(light) if {"box", "lamps"} <= set(light) else UNKNOWN
    bend = bend_of(record)[0] if "grid" in record else None
    return CaseNote(case.name, style, known, bend, coverage, (height, width))


def _coverage(outline: Float[np.ndarray, "n 2"], size: tuple[int, int]) -> float:
    """Share of a picture of ``size`` within the outline."""
    drawn = np.zeros((256, 256), np.uint8)
    points = outline * (256 / np.array(size[::-1]))
    cv2.fillPoly(drawn, [np.rint(np.clip(points, -1e4, 1e4) * 16).astype(np.int32)], 1, shift=4)
    return float(drawn.mean())


def _bend_deg(xyz: Float[np.ndarray, "n n 3"]) -> float:
    """The largest angle between the normals of a lattice of points and their mean."""
    across, down = np.gradient(xyz.astype(np.float64), axis=1), np.gradient(xyz.astype(np.float64), axis=0)
    normal = np.cross(across, down)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    mean = normal.mean(axis=(0, 1))
    return float(np.degrees(np.arccos(np.clip(normal @ (mean / np.linalg.norm(mean)), -1, 1)).max()))


__all__ = ["note_of"]
