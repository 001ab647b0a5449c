"""The card of a data set: what it is, how it was made, how its values are spread: ``python -m data_gen.card DIR``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro
from jaxtyping import Float
from PIL import Image
from scipy.interpolate import make_interp_spline

from data_gen.card_text import card_text
from data_gen.charts import bars, histogram, sheet
from data_gen.manifest import write_file
from data_gen.work import run_command
from hybrid.coords import rgb_from_bgr
from hybrid.draw import contact_sheet, fitted
from hybrid.errors import DataError, describe
from hybrid.learn.datasets.shards import Shard, open_dataset, read_description

SHEET_SIDE = 8
TILE = 224
"""Photos along each side of the contact sheet, and their size in pixels."""

MOST_DECODED = 2048
"""Photos that are decoded, at most, for the histogram of brightness."""

SEED = 0
"""Of the choice of photos to show and to decode."""


@dataclass(frozen=True)
class Label:
    """A quantity of which the card shows the spread.

    unit: of numbers; None for kinds. of: its value for a sample, from the sample's record with
    ``bend_of`` in it.
    """

    title: str
    unit: str | None
    of: Callable[[dict[str, Any]], Any]


LABELS = (
    Label("Bend: largest slope", "deg", lambda r: r["bend"][0]),
    Label("Bend: largest curvature", "per m", lambda r: r["bend"][1]),
    Label("Film in the photo", "%", lambda r: 100 * r["coverage"]),
    Label("Glare on the film", None, lambda r: glare_of(r["glare_share"])),
    Label("Light", None, lambda r: light_of(r["light"])),
    Label("Background", None, lambda r: r["backdrop"]["kind"]),
    Label("Over the film", None, lambda r: ", ".join(sorted({t["thing"] for t in r["things"]})) or "nothing"),
    Label("Roughness of the film", "", lambda r: r["material"]["roughness"]),
    Label("Roll of the photo", "deg", lambda r: r["view"]["roll_deg"]),
    Label("Tilt of the view", "deg", lambda r: r["view"]["tilt_deg"]),
    Label("Seen from", None, lambda r: "behind" if r["view"]["behind"] else "the front"),
    Label("Bending recipe", None, lambda r: r["recipe"]),
    Label("Layout: rows x columns", None, lambda r: f"{r['rows']} x {r['cols']}"),
    Label("Between the slices", None, lambda r: r["style"]),
    Label("Scan", None, lambda r: r["print"]["volume"]),
)


def write_card(folder: Path) -> None:
    """Write card.md, histograms.png and contact_sheet.jpg into a data set's folder.

    Raises:
        DataError: no data set there, or a damaged one.
    """
    shards = open_dataset(folder)
    values = label_values(shards)
    values["Brightness"] = brightness(shards)
    panels = [
        histogram(title, unit, np.array(values[title])) if unit is not None else bars(title, values[title])
        for title, unit in [*((label.title, label.unit) for label in LABELS), ("Brightness", "of 255")]
    ]
    write_file(folder / "histograms.png", _encoded(sheet(panels, 4), "PNG"))
    write_file(folder / "contact_sheet.jpg", _encoded(Image.fromarray(chosen_photos(shards)), "JPEG"))
    layouts = Counter(values["Layout: rows x columns"])
    numbers = {label.title: (np.array(values[label.title]), label.unit) for label in LABELS if label.unit is not None}
    text = card_text(read_description(folder), [shard.entry for shard in shards], numbers, layouts)
    write_file(folder / "card.md", text.encode())


def label_values(shards: Sequence[Shard]) -> dict[str, list[Any]]:
    """The values of all labels, in the order of the samples."""
    values: dict[str, list[Any]] = {label.title: [] for label in LABELS}
    for shard in shards:
        for k in range(len(shard)):
            record = shard.record(k)
            if "grid" not in record:
                got, do = "photos of your own, of which a card has nothing to tell", "Leave it out."
                raise DataError(describe(what="card", where=shard.path.parent, got=got, do=do))
            record["bend"] = bend_of(record)
            for label in LABELS:
                values[label.title].append(label.of(record))
    return values


def bend_of(record: dict[str, Any]) -> tuple[float, float]:
    """How far a film is bent, from the corners of its slices: angle in degrees between its normal and the mean one
    at most, and the largest principal curvature in 1/m.

    The corners are interpolated by a bicubic spline over the flat film, whose first and second fundamental forms
    (E F G, L M N) give the curvatures (do Carmo, Differential Geometry, 3-3).
    """
    world, film = np.array(record["grid"]["world"]), np.array(record["grid"]["film"])
    height, width = record["size_mm"]
    across, down = _derivatives(film[0, :, 0] * width), _derivatives(film[:, 0, 1] * height)
    s, t, ss, tt = (across[1] @ world, down_of(down[1], world), across[2] @ world, down_of(down[2], world))
    st = across[1] @ down_of(down[1], world)
    normal = np.cross(s, t)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    mean = normal.mean(axis=(0, 1))
    slope = np.arccos(np.clip(normal @ (mean / np.linalg.norm(mean)), -1, 1)).max()
    e, f, g = ((a * b).sum(axis=-1) for a, b in ((s, s), (s, t), (t, t)))
    l, m, n = ((a * normal).sum(axis=-1) for a in (ss, st, tt))  # noqa: E741 - the form's usual names
    area = e * g - f * f
    gauss, middle = (l * n - m * m) / area, (e * n - 2 * f * m + g * l) / (2 * area)
    curvature = np.abs(middle) + np.sqrt(np.maximum(middle**2 - gauss, 0))
    return float(np.rad2deg(slope)), float(1000 * curvature.max())


def light_of(light: dict[str, Any]) -> str:
    """What lights a film most: a light box, the room and lamps in it, or the room alone."""
    if light["box"]:
        return "light box"
    return "room and lamps" if light["lamps"] else "room"


def glare_of(share: float) -> str:
    """How much of a film is lost in glare, in words: most photos have none, and a histogram would show only that."""
    if share == 0:
        return "none"
    return "under 1 %" if share < 0.01 else "1 to 5 %" if share < 0.05 else "over 5 %"


def down_of(matrix: Float[np.ndarray, "r r"], points: Float[np.ndarray, "r c 3"]) -> Float[np.ndarray, "r c 3"]:
    """A linear combination along each column of points."""
    return np.einsum("ai,icx->acx", matrix, points)


def _derivatives(at: Float[np.ndarray, " n"]) -> list[Float[np.ndarray, "n n"]]:
    """Matrices that give a spline's value, slope and second derivative at its own nodes from its values there."""
    spline = make_interp_spline(at, np.eye(len(at)), k=min(3, len(at) - 1))
    return [spline(at, nu=order) for order in range(3)]


def brightness(shards: Sequence[Shard]) -> list[float]:
    """Mean grey level (0 to 255, sRGB) of photos, of a random part of them where there are many."""
    flags = cv2.IMREAD_REDUCED_GRAYSCALE_8
    return [float(_decoded(shard, k, flags).mean()) for shard, k in _choice(shards, MOST_DECODED)]


def chosen_photos(shards: Sequence[Shard]) -> np.ndarray:
    """Randomly chosen photos with their numbers on one sheet."""
    chosen = _choice(shards, SHEET_SIDE**2)
    tiles = [fitted(rgb_from_bgr(_decoded(shard, k, cv2.IMREAD_COLOR)), (TILE, TILE)) for shard, k in chosen]
    return contact_sheet(tiles, [str(shard.entry.first + k) for shard, k in chosen], SHEET_SIDE)


def _choice(shards: Sequence[Shard], count: int) -> list[tuple[Shard, int]]:
    places = [(shard, k) for shard in shards for k in range(len(shard))]
    chosen = np.random.default_rng(SEED).permutation(len(places))[:count]
    return [places[i] for i in sorted(chosen)]


def _decoded(shard: Shard, k: int, flags: int) -> np.ndarray:
    photo = cv2.imdecode(shard.member("photo.jpg", k), flags)
    if photo is None:
        raise DataError(describe(what="shard", where=shard.path, got=f"photo {k} unreadable", do="Make it again."))
    return photo


def _encoded(image: Image.Image, kind: str) -> bytes:
    file = BytesIO()
    image.save(file, kind, optimize=True)
    return file.getvalue()


@dataclass(frozen=True)
class CardConfig:
    """Write card.md, histograms.png and contact_sheet.jpg into a data set's folder."""

    folder: tyro.conf.Positional[Path]
    """Of a data set."""


def main() -> None:
    """Command line."""
    stopped = "the card is not whole, and the same command makes all of it anew"
    run_command("data_gen.card", CardConfig, lambda config: write_card(config.folder), stopped)


if __name__ == "__main__":
    main()
