"""The paper's tables (PAPER.tex, tables 1 to 3): their rows, its figures, and ours beside them as text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Figures = tuple[float | None, float | None, float | None]
"""PSNR in dB, SSIM and MS-SSIM; None where the paper has no figure."""

SCORES = ("psnr", "ssim", "ms_ssim")


@dataclass(frozen=True)
class Table:
    """A table of the paper.

    kinds: which of our scores it holds ("raw": of the unwarped photo; "deshifted": without the mean shift, which only
    the truth tells; "map": of the backward map as an image). rows: methods by name, with a label. published: the
    paper's figures by method and kind, from its own test set.
    """

    title: str
    kinds: tuple[str, ...]
    rows: Mapping[str, str]
    published: Mapping[tuple[str, str], Figures] = field(default_factory=dict)


TABLES = (
    Table(
        "Table 1, comparison",
        ("raw", "deshifted"),
        {
            "dewarpnet_published": "DewarpNet as published",
            "dewarpnet": "DewarpNet, read rightly",
            "firenet": "FiReNet",
            "firenet_uv": "FiReNet, by its uv map",
            "filmnet_one_look": "FilmNet, one look",
            "filmnet": "FilmNet, network alone",
            "hybrid": "hybrid, whole pipeline",
        },
        {
            ("dewarpnet_published", "raw"): (16.98, 0.4501, 0.6879),
            ("dewarpnet_published", "deshifted"): (17.18, 0.4611, 0.6932),
            ("firenet", "raw"): (25.30, 0.8621, 0.9523),
            ("firenet", "deshifted"): (25.60, 0.8715, 0.9564),
        },
    ),
    Table(
        "Table 2, uv against backward map, from true 3D maps",
        ("map", "raw", "deshifted"),
        {"net_bw": "Net_bw", "net_uv": "Net_uv"},
        {
            ("net_bw", "map"): (44.79, 0.9994, 0.9985),
            ("net_bw", "raw"): (18.46, 0.6126, 0.8044),
            ("net_bw", "deshifted"): (19.53, 0.6172, 0.8088),
            ("net_uv", "map"): (10.77, 0.8038, 0.4894),
            ("net_uv", "raw"): (15.13, 0.2642, 0.5028),
            ("net_uv", "deshifted"): (22.83, 0.7791, 0.9198),
        },
    ),
    Table(
        "Table 3, ablation of FiReNet",
        ("deshifted",),
        {"firenet_uv_only": "uv", "firenet_multimap": "uv + maps", "firenet": "uv + maps + deformation"},
        {
            ("firenet_uv_only", "deshifted"): (25.16, None, 0.9515),
            ("firenet_multimap", "deshifted"): (25.51, None, 0.9553),
            ("firenet", "deshifted"): (25.60, None, 0.9564),
        },
    ),
)
"""Table 3's fourth row, a baseline with a backward map (23.76 dB, 0.9446), is left out: the paper does not say what
network it is."""


def table_text(table: Table, rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The table with our figures beside the paper's, and below it how each network was trained, as rows may differ in
    that; rows: summaries by method (benchmarks.tables)."""
    pairs = "".join(f" | {kind + ', dB SSIM MS-SSIM':<25} {'paper':<20}" for kind in table.kinds)
    head = f"{'':<25}{pairs} | {'px mean':>8} {'median':>7} {'%':>6} {'lost':>5} {'up':>6} {'ms':>8} {'M':>6}"
    lines = [f"{table.title} ({_counts(rows)} photos)", head]
    for name, label in table.rows.items():
        row = rows.get(name, {})
        pairs = "".join(f" | {_triple(row.get(kind)):<25} {_published(table, name, kind):<20}" for kind in table.kinds)
        lines.append(f"{label:<25}{pairs} | {_figures(row)}")
    how = {label: rows.get(name, {}).get("training") for name, label in table.rows.items()}
    lines += [f"{label}: {training}" for label, training in how.items() if training]
    return "\n".join(lines)


def _counts(rows: Mapping[str, Mapping[str, Any]]) -> int:
    return max((row.get("count", 0) for row in rows.values()), default=0)


def _triple(scores: Mapping[str, float] | None) -> str:
    return "-" if scores is None else "{:.2f} {:.4f} {:.4f}".format(*(scores[name] for name in SCORES))


def _published(table: Table, name: str, kind: str) -> str:
    figures = table.published.get((name, kind))
    if figures is None:
        return "-"
    return " ".join("-" if x is None else f"{x:.{places}f}" for x, places in zip(figures, (2, 4, 4), strict=True))


def _figures(row: Mapping[str, Any]) -> str:
    if not row.get("trained"):
        return "not trained" if row else "not asked for"
    error, percent = row.get("end_point_px", {}), row.get("end_point_percent", {})
    size = row["parameters"]
    cells = (
        _cell(error.get("mean"), 8, ".2f"),
        _cell(error.get("median"), 7, ".2f"),
        _cell(percent.get("median"), 6, ".2f"),
        _cell(float(row["lost"]), 5, ".0f"),
        _cell(row["up"], 6, ".1%"),
        _cell(1e3 * row["seconds"]["median"], 8, ".1f"),
        _cell(size and size / 1e6, 6, ".1f"),
    )
    return " ".join(cells)


def _cell(value: float | None, width: int, places: str) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}{places}}"


__all__ = ["TABLES", "Table", "table_text"]
