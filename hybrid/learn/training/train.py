"""The trainer: ``hybrid train --preset NAME --data SHARDS --out DIR``. Resumes exactly; one seed gives one result.

Several processes share the work under ``torchrun``: each takes its part of every batch, and the first one tests, writes
and shows progress.
"""

from __future__ import annotations

import copy
import csv
import math
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset
from tqdm import tqdm

from hybrid.command import flag_of
from hybrid.errors import ConfigError, DataError, HybridError, describe
from hybrid.files import make_folder, write_bytes
from hybrid.image_io import write_rgb
from hybrid.learn.datasets.shards import data_digest
from hybrid.learn.networks.inference import fast_bfloat16
from hybrid.learn.networks.weights import images_shown, load_into, notes_of, save_weights
from hybrid.learn.paper.dewarpnet import DewarpNet
from hybrid.learn.training.presets import Preset, preset, weighted_sum


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


@dataclass(frozen=True)
class Rank:
    """Which of the processes this is, and how many there are."""

    number: int
    count: int

    @property
    def first(self) -> bool:
        return self.number == 0


class _Batches(Dataset):
    """This process's part of batch ``step``: each image is a pure function of the seed and of its number in the run, so
    that a resumed run, or one with another number of processes, sees the same."""

    def __init__(self, plan: Plan, places: list[Any], rank: Rank) -> None:
        self.plan, self.places, self.rank = plan, places, rank

    def __len__(self) -> int:
        return self.plan.steps

    def __getitem__(self, step: int) -> tuple[Tensor, Any] | HybridError:
        """An error is returned, not raised: PyTorch would turn it into a stack trace in a loader process."""
        plan, seed = self.plan, self.plan.config.seed
        mine = range(step * plan.batch + self.rank.number, (step + 1) * plan.batch, self.rank.count)
        places = [self.places[_place_of(k, seed, len(self.places))] for k in mine]
        generators = [np.random.default_rng([seed, 1, k]) for k in mine]
        try:
            return plan.preset.feed.batch(places, plan.px_at(step), generators)
        except HybridError as error:
            return error


def _place_of(image: int, seed: int, count: int) -> int:
    """Which of ``count`` places an image of the run shows: in each epoch every place once, in a new order."""
    epoch, k = divmod(image, count)
    return int(_order(seed, epoch, count)[k])


@lru_cache(maxsize=2)
def _order(seed: int, epoch: int, count: int) -> np.ndarray:
    return np.random.default_rng([seed, epoch]).permutation(count)


def train(config: TrainConfig) -> None:
    """Run or resume a training; writes ``PRESET.safetensors``, ``checkpoint.pt``, ``curves.csv`` and ``samples.png``.

    A run that is resumed with more passes continues on the longer schedule.

    Raises:
        ConfigError: an option is impossible, in general or on this machine; an option or the data differ from those
        that the run to resume began with; no samples are left besides those held out. DataError: data cannot be read,
        or the loss is not a number.
    """
    plan = Plan.of(config)
    if config.device == "cuda" and not torch.cuda.is_available():
        do = "Train on the processor (--device cpu), or install a PyTorch that was built for CUDA."
        raise ConfigError(describe(what="--device", got="cuda, of which PyTorch finds none", do=do))
    places = plan.preset.feed.open(config.data)
    held_out, trained_on = plan.preset.feed.split(places, config.held_out)
    if not trained_on:
        got, allowed = f"{len(places)} samples", f"> {config.held_out} held out"
        raise ConfigError(describe(what="train", got=got, allowed=allowed, do="Make more data, or hold out fewer."))
    make_folder(config.out, "--out")
    with _processes(config.device) as rank:
        if plan.batch % rank.count:
            got, allowed = f"{plan.batch} images", f"multiples of the {rank.count} processes"
            raise ConfigError(describe(what="--batch", got=got, allowed=allowed, do="Choose another --batch."))
        if plan.batch < plan.preset.least_batch * rank.count:
            allowed = f">= {plan.preset.least_batch} for each of {rank.count} processes"
            raise ConfigError(describe(what="--batch", got=plan.batch, allowed=allowed, do="Choose another --batch."))
        state = _State(plan, rank, len(places))
        loader = DataLoader(
            _Batches(plan, trained_on, rank),
            batch_size=None,
            sampler=range(state.step, plan.steps),
            num_workers=config.loaders,
            prefetch_factor=4 if config.loaders else None,
            worker_init_fn=_begin_loader,
        )
        _run(state, loader, held_out)


def _begin_loader(number: int) -> None:
    """Allow one thread in a process that prepares views: PyTorch limits only its own."""
    cv2.setNumThreads(1)
    threadpool_limits(1)


def _run(state: _State, loader: DataLoader, held_out: list[Any]) -> None:
    """Run the remaining steps, with tests and saves on the way."""
    plan, config = state.plan, state.plan.config
    saved = time.monotonic()
    done = {"total": plan.steps * plan.batch, "initial": state.step * plan.batch}
    with tqdm(unit="image", disable=not state.rank.first, **done) as bar, _saved_if_stopped(state):
        if state.step >= plan.steps and state.rank.first:
            state.save()  # its files may have been removed since, or never written
        for batch in loader:
            if isinstance(batch, HybridError):
                raise batch
            last = state.step + 1 == plan.steps
            with _undivided():
                terms = state.update(*batch)
                if state.rank.first and (state.step % config.steps_per_test == 0 or last):
                    figures = _test(state, held_out)
                    _log(state.curves, {"passes": state.step * plan.batch} | terms | figures)
                    bar.set_postfix({name.removeprefix("test_"): f"{value:.3g}" for name, value in figures.items()})
            bar.update(plan.batch)
            if not state.rank.first:
                continue
            if time.monotonic() - saved > 60 * config.minutes_per_save or last:
                state.save()
                saved = time.monotonic()


@contextmanager
def _saved_if_stopped(state: _State) -> Iterator[None]:
    """Ctrl-C loses nothing: the last finished step is saved."""
    try:
        yield
    except KeyboardInterrupt:
        if state.rank.first and state.step:
            state.save()
        raise


@contextmanager
def _undivided() -> Iterator[None]:
    """Ctrl-C takes effect after this block, not within it: otherwise half a step would be saved and resumed as none, or
    a step would lack the figures of its test."""
    if threading.current_thread() is not threading.main_thread():  # Ctrl-C interrupts no other
        yield
        return
    asked: list[int] = []
    before = signal.signal(signal.SIGINT, lambda number, _: asked.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if asked:
        raise KeyboardInterrupt


def _test(state: _State, held_out: list[Any]) -> dict[str, float]:
    """Figures of the averaged network on the held-out samples, at the input size of the current step; also writes a
    picture of its output on some of them."""
    config, feed, px = state.plan.config, state.plan.preset.feed, state.plan.px_at(state.step - 1)
    if not held_out:
        return {}
    if feed.picture is not None:
        write_rgb(config.out / "samples.png", feed.picture(state.averaged, held_out, px, config.device))
    return feed.test(state.averaged, held_out, px, config.device)


class _State:
    """Network, its average, optimiser and step; saved and loaded together."""

    def __init__(self, plan: Plan, rank: Rank, samples: int) -> None:
        config = plan.config
        torch.manual_seed(config.seed)
        self.plan, self.rank, self.step = plan, rank, 0
        self.began = {name: str(getattr(plan, name, getattr(config, name, None))) for name in _KEPT}
        self.began |= {"preset": config.preset, "samples": str(samples), "data": data_digest(config.data)}
        self.began["precision"] = "bfloat16" if fast_bfloat16(config.device) else "float32"
        self.network, self.before = plan.preset.network(), 0
        self.path = config.out / "checkpoint.pt"
        if config.start and not self.path.exists():
            _load_start(self.network, config.start)
            self.before = max(images_shown(notes_of(file)) or 0 for file in config.start)
        self.network.to(config.device, memory_format=plan.preset.layout)  # type: ignore[call-overload]
        self.averaged = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=plan.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self.curves = config.out / "curves.csv"
        if self.path.exists():
            self._load()
        elif rank.first:
            self.curves.unlink(missing_ok=True)  # of a run that ended before its first checkpoint
        self.shared = nn.parallel.DistributedDataParallel(self.network) if rank.count > 1 else self.network

    def update(self, images: Tensor, targets: Any) -> dict[str, float]:
        """One optimiser step; the loss terms."""
        chosen, device = self.plan.preset, self.plan.config.device
        for group in self.optimiser.param_groups:
            group["lr"] = self.plan.rate_at(self.step)
        self.shared.train()
        images, targets = images.to(device), targets.to(device)
        with torch.autocast(device, torch.bfloat16, enabled=fast_bfloat16(device)):
            output = self.shared(chosen.inputs(images, targets))
        terms = chosen.losses(output, targets)
        self.optimiser.zero_grad(set_to_none=True)
        weighted_sum(terms, chosen.weights).backward()
        norm = torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        if not torch.isfinite(norm):  # of all processes' gradients together: all stop here, before any weight is lost
            do = "What is saved is from before: mend the data and go on, or begin anew with a lower --learning-rate."
            got = f"a loss that is no number, in step {self.step + 1}"
            raise DataError(describe(what="train", where=self.plan.config.out, got=got, do=do))
        self.optimiser.step()
        self.step += 1
        self._average()
        return {f"train_{name}": float(term.detach()) for name, term in terms.items()}

    def save(self) -> None:
        """Checkpoint and weights; each replaces its predecessor only once it is complete."""
        config = self.plan.config
        names = ("network", "averaged", "optimiser")
        part = self.path.with_suffix(".part")
        torch.save(
            {"step": self.step, "before": self.before, "began": self.began}
            | {name: getattr(self, name).state_dict() for name in names},
            part,
        )
        notes = {"passes": self.step * self.plan.batch, "before": self.before, "seed": config.seed}
        notes |= {"weights": dict(self.plan.preset.weights)}
        save_weights(config.out / f"{config.preset}.safetensors", self.averaged, self.plan.preset.config, notes)
        part.replace(self.path)

    def _load(self) -> None:
        with self._told_if_damaged():
            stored = torch.load(self.path, map_location=self.plan.config.device, weights_only=True)
            began = stored.get("began", {})
        for name, now in self.began.items():
            if name not in began:
                got = f"a checkpoint that does not say its {name}, made by an earlier version"
                do = "Choose another --out; its weights can be named by --start."
                raise ConfigError(describe(what="train", where=self.path.parent, got=got, do=do))
            if began[name] != now:
                got, allowed = f"{name} {now}", f"{began[name]}, as the run there began"
                do = f"Go on with the {_AS_BEFORE.get(name, 'options')} it began with, or choose another --out."
                raise ConfigError(describe(what="train", where=self.path.parent, got=got, allowed=allowed, do=do))
        with self._told_if_damaged():
            self.step, self.before = stored["step"], stored.get("before", 0)
            for name in ("network", "averaged", "optimiser"):
                getattr(self, name).load_state_dict(stored[name])
        if self.rank.first:
            _cut_curves(self.curves, self.step * self.plan.batch)

    @contextmanager
    def _told_if_damaged(self) -> Iterator[None]:
        """Turn PyTorch's errors about a file that is no checkpoint of this run into one that says what to do."""
        try:
            yield
        except (OSError, MemoryError, torch.OutOfMemoryError):
            raise
        except Exception as error:  # PyTorch raises nearly anything for a damaged file
            got = f"no whole checkpoint ({(str(error).splitlines() or [type(error).__name__])[0]})"
            weights = f"the weights in {self.plan.config.preset}.safetensors beside it can be named by --start"
            do = f"Delete it, or choose another --out; {weights}."
            raise DataError(describe(what="train", where=self.path, got=got, do=do)) from error

    def _average(self) -> None:
        decay = min(self.plan.config.ema, (1 + self.step) / (10 + self.step))
        theirs = self.network.state_dict()
        with torch.no_grad():
            for name, value in self.averaged.state_dict().items():
                if value.is_floating_point():
                    value.lerp_(theirs[name], 1 - decay)
                else:
                    value.copy_(theirs[name])


def _load_start(network: nn.Module, files: tuple[Path, ...]) -> None:
    """Read the weights to start from: of the whole network, or of its stages."""
    parts = [network]
    if len(files) > 1 and isinstance(network, DewarpNet):
        parts = [network.shape_net, network.backward_net]
    if len(files) != len(parts):
        got, do = f"{len(files)} files", "Name one, or for dewarpnet those of its two stages."
        raise ConfigError(describe(what="--start", got=got, allowed=f"{len(parts)}", do=do))
    for part, file in zip(parts, files, strict=True):
        load_into(part, file)


@contextmanager
def _processes(device: str) -> Iterator[Rank]:
    """Join the other processes if ``torchrun`` started several."""
    count = int(os.environ.get("WORLD_SIZE", "1"))
    if count == 1:
        yield Rank(0, 1)
        return
    torch.distributed.init_process_group("nccl" if device == "cuda" else "gloo")
    if device == "cuda":
        torch.cuda.set_device(int(os.environ["LOCAL_RANK"]))
    try:
        yield Rank(torch.distributed.get_rank(), count)
    finally:
        torch.distributed.destroy_process_group()


_KEPT = (
    *("width", "input_px", "start", "coarse_share", "coarse_px", "held_out"),
    *("batch", "learning_rate", "weight_decay", "ema", "seed"),
)
"""Options that must not change when a run is resumed, besides its preset, data and precision."""

MOST_SEED = 2**64 - 1
"""The largest seed that PyTorch accepts."""

_AS_BEFORE = {"data": "data, in the order", "precision": "kind of processor"}
"""What to go on with, where it is not an option."""


def _cut_curves(path: Path, passes: int) -> None:
    """Remove what a run wrote after its last checkpoint: it will be written again."""
    if path.exists() and (lines := path.read_text().splitlines(keepends=True)):
        kept = [row for row in lines[1:] if int(row.split(",")[0]) <= passes]
        write_bytes(path, "".join([lines[0], *kept]).encode())


def _log(path: Path, row: dict[str, Any]) -> None:
    """Append a row to a CSV file, with a header if it is new."""
    new = not path.exists() or not path.stat().st_size
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row), lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
