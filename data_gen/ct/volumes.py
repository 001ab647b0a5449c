"""CT volumes: the record, slices in other planes, and what of the patient they show."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int16

from hybrid.errors import DataError, describe

BODY_WIDTH_MM = 235.0
"""No head is as wide as this, ears and blur included; no adult's trunk is narrower."""

THICKER_THAN_TABLES_MM = 36.0
"""A table is about 20 mm thick; the walls of a chest, front and back together, are more than this."""


DENSER_THAN_AIR_HU = -300

PATIENT_SHARE = 0.25
"""A slice with less tissue than this share of the fullest one's misses the patient or just touches them."""

LEAST_SPAN_HU = 300
"""Fat and soft tissue alone, with blur and noise, lie further apart; the values of masks and empty images do not."""

Plane = Literal["axial", "coronal", "sagittal"]
"""How the slices of a volume lie in the patient."""


@dataclass(frozen=True, eq=False)
class CtVolume:
    """A CT series.

    hu: (slices, rows, cols) Hounsfield units; slice 0 is caudal, row 0 anterior, column 0 the patient's right. For
        other planes see ``reformatted``.
    spacing_mm: (z, y, x) distances between voxel centres, along hu's axes, all positive.
    name: for messages and to choose by; that of the file, if it has one.
    label: what data sets call it, since a file's name may be a patient's; by default the name.
    plane: of the slices.
    """

    hu: Int16[np.ndarray, "slices rows cols"]
    spacing_mm: tuple[float, float, float]
    name: str
    label: str = ""
    plane: Plane = "axial"

    def __post_init__(self) -> None:
        if self.hu.ndim != 3 or self.hu.dtype != np.int16 or min(self.hu.shape) < 1:
            got = f"shape {self.hu.shape}, {self.hu.dtype}"
            raise DataError(
                describe(
                    what="CT volume",
                    where=self.name,
                    got=got,
                    allowed="(slices, rows, cols) int16, none of them 0",
                    do="Check the file's 'hu' array",
                )
            )
        z, y, x = (float(s) for s in self.spacing_mm)
        if not all(np.isfinite(s) and s > 0 for s in (z, y, x)):
            raise DataError(
                describe(
                    what="CT volume spacing",
                    where=self.name,
                    got=(z, y, x),
                    allowed="three positive lengths in mm (z, y, x)",
                    do="Check the file's 'spacing_mm'",
                )
            )
        object.__setattr__(self, "spacing_mm", (z, y, x))
        object.__setattr__(self, "label", self.label or self.name)


_AXES: dict[Plane, tuple[int, int, int]] = {"axial": (0, 1, 2), "coronal": (1, 0, 2), "sagittal": (2, 0, 1)}
"""Which axes of an axial volume (up, back, left) are the slices, rows and columns of each plane."""


def reformatted(volume: CtVolume, plane: Plane) -> CtVolume:
    """An axial volume cut in another plane, the head at the top. Coronal: slice 0 anterior, column 0 the patient's
    right; sagittal: slice 0 the patient's right, column 0 anterior."""
    if plane == volume.plane:
        return volume
    axes = _AXES[plane]
    hu = np.ascontiguousarray(volume.hu.transpose(axes)[:, ::-1])
    down, across = volume.spacing_mm[axes[1]], volume.spacing_mm[axes[2]]
    return replace(volume, hu=hu, spacing_mm=(volume.spacing_mm[axes[0]], down, across), plane=plane)


def within_patient(volume: CtVolume) -> CtVolume:
    """The longest run of slices that show a good part of the patient, without those of only air or table."""
    shown = (volume.hu[:, ::4, ::4] > DENSER_THAN_AIR_HU).mean(axis=(1, 2))
    turns = np.flatnonzero(np.diff(np.pad(shown >= PATIENT_SHARE * shown.max(), 1)))
    first, last = turns.reshape(-1, 2)[np.argmax(np.diff(turns)[::2])]
    return replace(volume, hu=volume.hu[first:last])


def tissue_width_mm(volume: CtVolume) -> float:
    """Median over axial slices of the width in mm of what is denser than fat, mostly without tables and clothes."""
    (height, depth, width), steps = np.argsort(_AXES[volume.plane]), [1, 1, 1]
    steps[height], steps[depth], steps[width] = max(1, volume.hu.shape[height] // 12), 4, 4
    rough = volume.hu[tuple(slice(None, None, step) for step in steps)].transpose(height, depth, width)
    tissue = (rough > -150).sum(axis=1) * 4 * volume.spacing_mm[depth] >= THICKER_THAN_TABLES_MM
    widths = [float(np.ptp(np.flatnonzero(row))) if row.any() else 0.0 for row in tissue]
    return float(np.median(widths)) * 4 * volume.spacing_mm[width]


def is_body(volume: CtVolume) -> bool:
    """True if the volume is as wide as a trunk, False for a head or a limb."""
    return tissue_width_mm(volume) > BODY_WIDTH_MM


def not_ct(hu: np.ndarray) -> str:
    """Why these values show no scanned body in Hounsfield units; empty if they may."""
    low, high = float(hu.min()), float(hu.max())
    if high - low < LEAST_SPAN_HU:
        return f"values from {low:g} to {high:g}: a mask or an empty image, not Hounsfield units"
    return ""


def resample_slices(
    hu: Int16[np.ndarray, "slices rows cols"], positions: Float[np.ndarray, " n"]
) -> Int16[np.ndarray, "n rows cols"]:
    """Slices at fractional positions (0 is the first), interpolated linearly between their two neighbours."""
    lower = np.clip(np.floor(positions).astype(int), 0, max(len(hu) - 2, 0))
    share = (positions - lower).astype(np.float32)[:, None, None]
    upper = np.minimum(lower + 1, len(hu) - 1)
    return np.rint(hu[lower] * (1 - share) + hu[upper] * share).astype(np.int16)


def as_hounsfield(values: np.ndarray) -> Int16[np.ndarray, "*shape"]:
    """Numbers of any type as int16; NaN becomes air."""
    if values.dtype == np.int16:
        return values
    return np.clip(np.rint(np.nan_to_num(values, nan=-1024.0)), -32768, 32767).astype(np.int16)
