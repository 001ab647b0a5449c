"""UprightNet: reads a flattened film and says which way is up, and whether it is seen from behind.

FilmNet sees films too small to read them; whether a head or its texts are mirrored shows only at the photo's own
resolution. So this small network looks at the film once it is flat, and every part of the film casts a vote.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from jaxtyping import Float, Int64, UInt8
from torch import Tensor, nn
from torch.nn import functional

from hybrid.backward import BackwardMap, Orientation


@dataclass(frozen=True)
class UprightNetConfig:
    """widths: channels at 1/2, 1/4, 1/8, 1/16 and 1/32 of the input. film_px: longer side at which films are read.
    input_px: side of the parts of films that it is trained on."""

    widths: tuple[int, int, int, int, int] = (16, 32, 64, 96, 128)
    film_px: int = 704
    input_px: int = 256


class _Stage(nn.Sequential):
    """Halves the resolution."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, 2, kernel // 2, bias=False),
            nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )


class _Mix(nn.Module):
    """A 3 x 3 convolution beside an identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(x + self.conv(x))


class UprightNet(nn.Module):
    """Five stages to 1/32 of the input, where each place gives a vote for the eight orientations and its weight."""

    def __init__(self, config: UprightNetConfig) -> None:
        super().__init__()
        self.config = config
        stem, *widths = config.widths
        stages: list[nn.Module] = [_Stage(1, stem, 5)]
        for before, after in zip([stem, *widths[:-1]], widths, strict=True):
            stages += [_Stage(before, after), _Mix(after)]
        self.stages = nn.Sequential(*stages, _Mix(widths[-1]))
        self.votes = nn.Conv2d(widths[-1], 8, 1)
        self.weights = nn.Conv2d(widths[-1], 1, 1)

    def forward(self, films: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 8"]:
        """Logits of the eight orientations of films from ``standardised``."""
        places = self.stages(films)
        votes, weights = self.votes(places).flatten(2), functional.softplus(self.weights(places)).flatten(2)
        return (votes * weights).sum(dim=2) / weights.sum(dim=2).clamp(min=1e-3)


def upright_losses(logits: Float[Tensor, "b 8"], truth: Int64[Tensor, " b"]) -> dict[str, Tensor]:
    """Cross-entropy of the eight orientations."""
    return {"orientation": functional.cross_entropy(logits, truth)}


def standardised(film: Float[np.ndarray, "h w"], longer_px: float) -> Float[np.ndarray, "h w"]:
    """The grey of a film (or of a part of one) whose longer side has ``longer_px``, without slow changes of the light:
    less its local mean, over its local spread, within +-4."""
    grey = film.astype(np.float32)
    side = max(3, 2 * round(longer_px / 32) + 1)
    mean = cv2.blur(grey, (side, side))
    spread = cv2.blur((grey - mean) ** 2, (side, side))
    return np.clip((grey - mean) / np.sqrt(spread + 1e-4), -4, 4)


@torch.inference_mode()
def read_orientation(network: UprightNet, film: UInt8[np.ndarray, "h w 3"]) -> tuple[Orientation, float]:
    """What makes a flattened film (sRGB) read right, and the probability that it is so."""
    grey = cv2.cvtColor(film, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    chance = functional.softmax(
        network(torch.from_numpy(standardised(grey, float(max(grey.shape))))[None, None]), dim=1
    )[0]
    best = int(chance.argmax())
    return Orientation.from_index(best), float(chance[best])


def reading_size(film: BackwardMap, config: UprightNetConfig) -> tuple[int, int]:
    """Size (h, w) at which a film is read: the photo's own, but no more than the network is used to."""
    down, across = film.mean_film_pixels()
    scale = min(1.0, config.film_px / max(down, across))
    return max(64, round(down * scale)), max(64, round(across * scale))
