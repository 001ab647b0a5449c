"""Which way is up: the views that UprightNet learns from."""

from dataclasses import replace

import numpy as np
import torch

from hybrid.backward import Orientation
from hybrid.learn.upright import UprightNet, UprightNetConfig, standardised
from hybrid.learn.upright_data import PrintAugment, upright_view

CLEAN = PrintAugment(
    warp=1e-9, blur_px=(0.3, 0.31), noise=(1e-4, 1.1e-4), veil=0.0, gamma=1e-9, longer_px=(700.0, 701.0)
)


def test_slow_changes_of_the_light_are_taken_out():
    rng = np.random.default_rng(0)
    film = rng.random((300, 240))
    v, u = np.mgrid[0:1:300j, 0:1:240j]
    lit = film * (0.4 + 0.3 * u + 0.2 * v) + 0.1 * u
    assert np.corrcoef(standardised(film, 300.0).ravel(), standardised(lit, 300.0).ravel())[0, 1] > 0.995


def test_the_label_of_a_view_makes_it_read_right():
    """A print with all its ink in the top-left quarter, once moved as its label says, has it there again."""
    flat = np.zeros((700, 560), np.uint8)
    flat[:350, :280] = np.random.default_rng(0).integers(0, 256, (35, 28), dtype=np.uint8).repeat(10, 0).repeat(10, 1)
    labels = set()
    for seed in range(40):
        small = replace(CLEAN, longer_px=(240.0, 241.0))
        view, index = upright_view(flat, 256, np.random.default_rng([3, seed]), small)
        ink = np.abs(Orientation.from_index(index).moved(view))
        assert ink[:115, :90].mean() > 5 * ink[130:].mean()
        assert ink[:115, :90].mean() > 5 * ink[:, 110:].mean()
        labels.add(index)
    assert labels == set(range(8))


def test_votes_are_weighed_not_counted():
    """Empty borders, where nothing is printed, can be ignored: logits are a weighted mean over places."""
    torch.manual_seed(0)
    network = UprightNet(UprightNetConfig()).eval()
    with torch.no_grad():
        logits = network(torch.randn(2, 1, 128, 96))
    assert logits.shape == (2, 8)
    assert torch.isfinite(logits).all()
