"""The trainer: ``hybrid train --preset NAME --data SHARDS --out DIR``. Resumes exactly; one seed gives one result.

Several processes share the work under ``torchrun``: each takes its part of every batch, and the first one tests, writes
and shows progress.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import torch
from threadpoolctl import threadpool_limits
from torch import Tensor
from torch.utils.data import DataLoader, Dataset
from tqdm import tqdm

from hybrid.errors import ConfigError, HybridError, describe
from hybrid.files import make_folder
from hybrid.image_io import write_rgb
from hybrid.learn.training.curves import append_row
from hybrid.learn.training.plan import Plan, TrainConfig
from hybrid.learn.training.state import Rank, State


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
        state = State(plan, rank, len(places))
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


def _run(state: State, loader: DataLoader, held_out: list[Any]) -> None:
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
                    append_row(state.curves, {"passes": state.step * plan.batch} | terms | figures)
                    bar.set_postfix({name.removeprefix("test_"): f"{value:.3g}" for name, value in figures.items()})
            bar.update(plan.batch)
            if not state.rank.first:
                continue
            if time.monotonic() - saved > 60 * config.minutes_per_save or last:
                state.save()
                saved = time.monotonic()


@contextmanager
def _saved_if_stopped(state: State) -> Iterator[None]:
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


def _test(state: State, held_out: list[Any]) -> dict[str, float]:
    """Figures of the averaged network on the held-out samples, at the input size of the current step; also writes a
    picture of its output on some of them."""
    config, feed, px = state.plan.config, state.plan.preset.feed, state.plan.px_at(state.step - 1)
    if not held_out:
        return {}
    if feed.picture is not None:
        write_rgb(config.out / "samples.png", feed.picture(state.averaged, held_out, px, config.device))
    return feed.test(state.averaged, held_out, px, config.device)


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


__all__ = ["train"]
