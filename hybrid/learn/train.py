"""The trainer: ``hybrid train --data SHARDS --out DIR``. Resumes exactly; one seed, one result."""

from __future__ import annotations

import csv
import math
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, Dataset
from tqdm import tqdm

from hybrid.errors import ConfigError, describe
from hybrid.learn.data import AugmentConfig, batch_of, training_view
from hybrid.learn.losses import LossWeights, Targets, loss_terms, masked_mean, total_loss
from hybrid.learn.network import FilmNet, FilmNetConfig
from hybrid.learn.shards import Shard, open_dataset
from hybrid.learn.weights import save_weights


@dataclass(frozen=True)
class TrainConfig:
    """Train FilmNet on a data set made by ``python -m data_gen.generate``.

    data: data set folders. out: folder for checkpoint, curves and weights; a run that was cut off goes on from it.
    passes: images shown in all. coarse_share: share of them shown at ``coarse_px``, which costs less, before the rest
    at the network's own input size. held_out: the first samples of the data, only tested on.
    batch, learning_rate, weight_decay: of AdamW with one cosine cycle and a warm-up. ema: decay of the averaged
    weights, which are the ones saved. loaders: processes that prepare views. device: cpu or cuda.
    """

    data: tuple[Path, ...]
    out: Path
    passes: int = 200_000
    coarse_share: float = 0.6
    coarse_px: int = 128
    held_out: int = 512
    batch: int = 32
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    ema: float = 0.998
    seed: int = 0
    loaders: int = 1
    steps_per_test: int = 500
    minutes_per_save: float = 3.0
    device: str = "cpu"
    network: FilmNetConfig = field(default_factory=FilmNetConfig)
    augment: AugmentConfig = field(default_factory=AugmentConfig)
    loss: LossWeights = field(default_factory=LossWeights)

    @property
    def steps(self) -> int:
        return max(1, self.passes // self.batch)

    def px_at(self, step: int) -> int:
        """Side of the training views at a step: coarse first, then the network's own."""
        return self.coarse_px if step < self.coarse_share * self.steps else self.network.input_px

    def rate_at(self, step: int) -> float:
        """Learning rate at a step: linear warm-up over 2 % of the steps, then a half cosine to zero."""
        warm = max(1, self.steps // 50)
        if step < warm:
            return self.learning_rate * (step + 1) / warm
        return 0.5 * self.learning_rate * (1 + math.cos(math.pi * (step - warm) / max(1, self.steps - warm)))


Place = tuple[Shard, int]
"""A sample: its shard and its number in it."""


class _Batches(Dataset):
    """Batch number ``step`` as a pure function of the seed and the step, so that a resumed run sees the same."""

    def __init__(self, config: TrainConfig, places: list[Place]) -> None:
        self.config, self.places = config, places

    def __len__(self) -> int:
        return self.config.steps

    def __getitem__(self, step: int) -> tuple[Tensor, Targets]:
        config = self.config
        epoch, first = divmod(step * config.batch, len(self.places))
        order = np.random.default_rng([config.seed, epoch]).permutation(len(self.places))
        rng = np.random.default_rng([config.seed, 1, step])
        views = []
        for k in range(first, first + config.batch):
            shard, index = self.places[order[k % len(order)]]
            views.append(training_view(shard, index, config.px_at(step), rng, config.augment))
        return batch_of(views)


def train(config: TrainConfig) -> None:
    """Run or resume a training; writes ``filmnet.safetensors``, ``curves.csv`` and ``checkpoint.pt`` to ``out``.

    Raises:
        ConfigError: fewer samples than are held out. DataError: a data set that cannot be read.
    """
    places = [(shard, k) for folder in config.data for shard in open_dataset(folder) for k in range(len(shard))]
    if len(places) <= config.held_out:
        raise ConfigError(
            describe(
                what="train",
                got=f"{len(places)} samples",
                allowed=f"> {config.held_out} held out",
                do="Make more data.",
            )
        )
    config.out.mkdir(parents=True, exist_ok=True)
    state = _State(config)
    loader = DataLoader(
        _Batches(config, places[config.held_out :]),
        batch_size=None,
        sampler=range(state.step, config.steps),
        num_workers=config.loaders,
        prefetch_factor=4 if config.loaders else None,
    )
    saved = time.monotonic()
    with tqdm(total=config.steps * config.batch, initial=state.step * config.batch, unit="image") as bar:
        for images, targets in loader:
            terms = state.update(images, targets)
            bar.update(len(images))
            if state.step % config.steps_per_test == 0 or state.step == config.steps:
                row = terms | test(state.averaged, places[: config.held_out], config)
                _log(config.out / "curves.csv", {"passes": state.step * config.batch} | row)
                bar.set_postfix(uv=f"{row['test_uv_percent']:.2f}%", iou=f"{row['test_mask_iou']:.3f}")
            if time.monotonic() - saved > 60 * config.minutes_per_save or state.step == config.steps:
                state.save()
                saved = time.monotonic()


class _State:
    """Network, its average, optimiser and step; saved and loaded whole."""

    def __init__(self, config: TrainConfig) -> None:
        torch.manual_seed(config.seed)
        self.config, self.step = config, 0
        self.network = FilmNet(config.network).to(config.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.averaged = FilmNet(config.network).to(config.device).eval().requires_grad_(False)
        self.averaged.load_state_dict(self.network.state_dict())
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
        )
        self.path = config.out / "checkpoint.pt"
        if self.path.exists():
            self._load()

    def update(self, images: Tensor, targets: Targets) -> dict[str, float]:
        """One optimiser step; the loss terms."""
        config, device = self.config, self.config.device
        for group in self.optimiser.param_groups:
            group["lr"] = config.rate_at(self.step)
        self.network.train()
        with torch.autocast(device, torch.bfloat16, enabled=_fast_bfloat16(device)):
            output = self.network(images.to(device))
        moved = Targets(*(getattr(targets, name).to(device) for name in ("mask", "uv", "xyz", "albedo")))
        terms = loss_terms(output, moved)
        self.optimiser.zero_grad(set_to_none=True)
        total_loss(terms, config.loss).backward()
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), 5.0)
        self.optimiser.step()
        self.step += 1
        self._average()
        return {f"train_{name}": float(term.detach()) for name, term in terms.items()}

    def save(self) -> None:
        """Checkpoint and weights; each replaces its predecessor only when it is whole."""
        names = ("network", "averaged", "optimiser")
        part = self.path.with_suffix(".part")
        torch.save({"step": self.step} | {name: getattr(self, name).state_dict() for name in names}, part)
        part.replace(self.path)
        notes = {"passes": self.step * self.config.batch, "seed": self.config.seed, "loss": asdict(self.config.loss)}
        save_weights(self.config.out / "filmnet.safetensors", self.averaged, notes)

    def _load(self) -> None:
        stored = torch.load(self.path, map_location=self.config.device, weights_only=True)
        self.step = stored["step"]
        for name in ("network", "averaged", "optimiser"):
            getattr(self, name).load_state_dict(stored[name])

    def _average(self) -> None:
        decay = min(self.config.ema, (1 + self.step) / (10 + self.step))
        theirs = self.network.state_dict()
        with torch.no_grad():
            for name, value in self.averaged.state_dict().items():
                if value.is_floating_point():
                    value.lerp_(theirs[name], 1 - decay)
                else:
                    value.copy_(theirs[name])


@torch.inference_mode()
def test(network: FilmNet, places: list[Place], config: TrainConfig) -> dict[str, float]:
    """Errors on held-out samples, seen whole: mean |uv error| in % of the film, mask intersection over union."""
    network.eval()
    rng = np.random.default_rng(0)
    uv_error, overlap = [], []
    for start in range(0, len(places), config.batch):
        views = [
            training_view(shard, k, config.network.input_px, rng, None)
            for shard, k in places[start : start + config.batch]
        ]
        images, targets = batch_of(views)
        output = network(images.to(config.device))
        uv, logit = output.uv.cpu(), output.mask_logit.cpu()
        error = (uv - targets.uv).norm(dim=1)
        uv_error.append(100 * float(masked_mean(error, targets.mask)))
        both, either = (logit > 0) & targets.mask, (logit > 0) | targets.mask
        overlap.append(float((both.sum(dim=(1, 2)) / either.sum(dim=(1, 2)).clamp(min=1)).mean()))
    return {"test_uv_percent": float(np.mean(uv_error)), "test_mask_iou": float(np.mean(overlap))}


def _fast_bfloat16(device: str) -> bool:
    """Whether bfloat16 is faster than float32: on GPUs, and on CPUs that have instructions for it."""
    return device == "cuda" or bool(
        torch.ops.mkldnn._is_mkldnn_bf16_supported() and torch.cpu._is_avx512_bf16_supported()
    )


def _log(path: Path, row: dict[str, Any]) -> None:
    """Append a row to a CSV file, with a header if it is new."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(row))
        if new:
            writer.writeheader()
        writer.writerow({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in row.items()})
