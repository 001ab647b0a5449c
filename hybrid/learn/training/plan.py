"""What a training run is asked for, and what follows from that: batch, rates and steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hybrid.command import flag_of
from hybrid.errors import ConfigError, describe
from hybrid.learn.training.presets import Preset, preset

MOST_SEED = 2**64 - 1
"""The largest seed that PyTorch accepts."""


@dataclass(frozen=True)
class TrainConfig:
    """Train a network on data of ``python -m data_gen.generate`` (for upright and slices ``data_gen.flat_prints``, for
    light ``data_gen.lit_films``). The same command resumes an interrupted run."""

    data: tuple[Path, ...]
    """Data set folders."""
    out: Path
    """Folder for checkpoint, curves and weights."""
    preset: str = "filmnet"
    """Which network: filmnet, upright, slices, edges, borders, light, or one of the paper's (docs/training.md)."""
    width: float | None = None
    """Factor on the channels of the paper's networks."""
    input_px: int | None = None
    """Side of the network's input, if not the preset's."""
    start: tuple[Path, ...] = ()
    """Weights to start from, as for fine-tuning; for dewarpnet those of its stages, shape first, if these were trained
    separately."""
    passes: int = 200_000
    """Total number of images shown."""
    coarse_share: float = 0.0
    """Share of them shown first, at ``coarse_px``, which costs less; the rest follow at the network's own input size
    (networks with one input size only: none)."""
    coarse_px: int = 128
    """Side of the input of that share."""
    held_out: int = 512
    """First samples of the data, used for tests only; 0 for no tests. Photos of one flat film are held out together."""
    batch: int | None = None
    """Images per step, if not the preset's."""
    learning_rate: float | None = None
    """Of AdamW with a warm-up and one half cosine, if not the preset's."""
    weight_decay: float = 1e-2
    """Of AdamW."""
    ema: float = 0.998
    """Decay of the averaged weights, which are the ones saved."""
    seed: int = 0
    """Of weights, order and views."""
    loaders: int = 1
    """Processes that prepare views."""
    steps_per_test: int = 500
    """Steps between tests."""
    minutes_per_save: float = 3.0
    """Minutes between checkpoints."""
    device: Literal["cpu", "cuda"] = "cpu"
    """Where the network is trained."""

    def __post_init__(self) -> None:
        Plan.of(self)  # refuses impossible options before any data is read


@dataclass(frozen=True)
class Plan:
    """A training run with everything decided: the preset as asked for, batch, rate and number of steps."""

    config: TrainConfig
    preset: Preset
    batch: int
    learning_rate: float

    @staticmethod
    def of(config: TrainConfig) -> Plan:
        """What a configuration asks for.

        Raises:
            ConfigError: no such preset, or an option that it does not have.
        """
        _refuse_numbers(config)
        coarse_px = config.coarse_px if config.coarse_share else None
        chosen = preset(config.preset)
        if config.width is not None:
            chosen = chosen.at_width(config.width)
        if config.input_px is not None:
            chosen = chosen.at_input(config.input_px)
        if coarse_px is not None and chosen.one_size:
            got, do = f"--coarse-share {config.coarse_share}", "Leave it out."
            raise ConfigError(describe(what=f"--preset {config.preset}", got=got, allowed="one input size", do=do))
        for name, px in (("input_px", chosen.config.input_px), ("coarse_px", coarse_px)):
            if px is not None and px % chosen.px_multiple:
                allowed, do = f"multiples of {chosen.px_multiple}", "Choose another."
                raise ConfigError(describe(what=flag_of(name), got=px, allowed=allowed, do=do))
        return Plan(config, chosen, config.batch or chosen.batch, config.learning_rate or chosen.learning_rate)

    @property
    def steps(self) -> int:
        return max(1, self.config.passes // self.batch)

    def px_at(self, step: int) -> int:
        """Side of the input at a step: coarse first, then the network's own."""
        coarse = step < self.config.coarse_share * self.steps
        return self.config.coarse_px if coarse else self.preset.config.input_px

    def rate_at(self, step: int) -> float:
        """Learning rate at a step: linear warm-up over 2 % of the steps, then a half cosine to zero."""
        warm = max(1, self.steps // 50)
        if step < warm:
            return self.learning_rate * (step + 1) / warm
        return 0.5 * self.learning_rate * (1 + math.cos(math.pi * (step - warm) / max(1, self.steps - warm)))


def _refuse_numbers(config: TrainConfig) -> None:
    """Refuse numbers that are invalid whatever the preset.

    Raises:
        ConfigError: one is invalid.
    """
    coarse_px = config.coarse_px if config.coarse_share else None
    for name, value, least in (
        ("passes", config.passes, 1),
        ("held_out", config.held_out, 0),
        ("loaders", config.loaders, 0),
        ("batch", config.batch, 1),
        ("input_px", config.input_px, 32),
        ("coarse_px", coarse_px, 32),
        ("seed", config.seed, 0),
        ("steps_per_test", config.steps_per_test, 1),
        ("weight_decay", config.weight_decay, 0),
    ):
        if value is not None and not least <= value < math.inf:
            allowed, do = f">= {least}", "Choose another."
            raise ConfigError(describe(what=flag_of(name), got=value, allowed=allowed, do=do))
    if config.seed > MOST_SEED:
        raise ConfigError(describe(what="--seed", got=config.seed, allowed=f"<= {MOST_SEED}", do="Choose another."))
    if not config.minutes_per_save >= 0:
        got, do = config.minutes_per_save, "Choose another."
        raise ConfigError(describe(what="--minutes-per-save", got=got, allowed=">= 0", do=do))
    for name, number in (("learning_rate", config.learning_rate), ("width", config.width)):
        if number is not None and not 0 < number < math.inf:
            raise ConfigError(describe(what=flag_of(name), got=number, allowed="> 0", do="Choose another."))
    for name, share in (("ema", config.ema), ("coarse_share", config.coarse_share)):
        if not 0 <= share < 1:
            raise ConfigError(
                describe(what=flag_of(name), got=share, allowed="from 0 to below 1", do="Choose another.")
            )


__all__ = ["Plan", "TrainConfig"]
