"""Charts: labels of points overlap nothing else and stay within the frame."""

import itertools

import numpy as np
import pytest
from PIL import Image, ImageDraw

from benchmarks.report import charts
from benchmarks.report.charts import COLOURS, Axis, Chart, Points, scatter


def overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


@pytest.mark.parametrize("corner", [(90.0, 60.0), (790.0, 480.0), (440.0, 270.0)])
def test_labels_of_points_that_crowd_lie_apart_and_within_the_frame(corner):
    draw = ImageDraw.Draw(Image.new("RGB", (charts.WIDTH, charts.HEIGHT)))
    points = [(corner[0] + 3.0 * k, corner[1] + 2.0 * k) for k in range(3)]
    dots = [(x - 6, y - 6, x + 6, y + 6) for x, y in points]
    taken = list(dots)
    for at in points:
        charts._label(draw, at, "a label of some length", "#000000", taken)
    labels = taken[len(dots) :]
    assert len(labels) == len(points)
    assert not any(overlap(a, b) for a, b in itertools.combinations(labels, 2))
    assert not any(overlap(label, dot) for label in labels for dot in dots)
    assert all(left > charts._LEFT and right < charts._RIGHT for left, _, right, _ in labels)
    assert all(top > charts._TOP and bottom < charts._BOTTOM for _, top, _, bottom in labels)


def test_a_label_without_room_is_left_out():
    draw = ImageDraw.Draw(Image.new("RGB", (charts.WIDTH, charts.HEIGHT)))
    full = [(0.0, 0.0, float(charts.WIDTH), float(charts.HEIGHT))]
    charts._label(draw, (440.0, 270.0), "no room", "#000000", full)
    assert len(full) == 1


def test_a_chart_of_a_dozen_kinds_shows_a_dozen_colours():
    kinds = tuple(Points(f"kind {k}", ((float(k + 1), 1.0),)) for k in range(12))
    picture = scatter(Chart("a chart", Axis("x", 0.5, 20.0), Axis("y", 0.1, 10.0), kinds, {"a mark": 2.0}))
    seen = {tuple(int(v) for v in colour) for colour in np.unique(picture.reshape(-1, 3), axis=0)}
    wanted = {tuple(bytes.fromhex(colour[1:])) for colour in COLOURS}
    assert len(wanted) == 12
    assert wanted <= seen
