"""The state of a training run: network, average, optimiser and step, which are saved and resumed together."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from hybrid.errors import ConfigError, DataError, describe
from hybrid.learn.datasets.shards import data_digest
from hybrid.learn.networks.inference import fast_bfloat16
from hybrid.learn.networks.weights import images_shown, load_into, notes_of, save_weights
from hybrid.learn.paper.dewarpnet import DewarpNet
from hybrid.learn.training.curves import cut_rows
from hybrid.learn.training.plan import Plan
from hybrid.learn.training.presets import weighted_sum

_KEPT = (
    *("width", "input_px", "start", "coarse_share", "coarse_px", "held_out"),
    *("batch", "learning_rate", "weight_decay", "ema", "seed"),
)
"""Options that must not change when a run is resumed, besides its preset, data and precision."""

_AS_BEFORE = {"data": "data, in the order", "precision": "kind of processor"}
"""What to go on with, where it is not an option."""


@dataclass(frozen=True)
class Rank:
    """Which of the processes this is, and how many there are."""

    number: int
    count: int

    @property
    def first(self) -> bool:
        return self.number == 0


class State:
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
            load_start(self.network, config.start)
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
            cut_rows(self.curves, self.step * self.plan.batch)

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


def load_start(network: nn.Module, files: tuple[Path, ...]) -> None:
    """Read the weights to start from: of the whole network, or of its stages."""
    parts = [network]
    if len(files) > 1 and isinstance(network, DewarpNet):
        parts = [network.shape_net, network.backward_net]
    if len(files) != len(parts):
        got, do = f"{len(files)} files", "Name one, or for dewarpnet those of its two stages."
        raise ConfigError(describe(what="--start", got=got, allowed=f"{len(parts)}", do=do))
    for part, file in zip(parts, files, strict=True):
        load_into(part, file)


__all__ = ["Rank", "State", "load_start"]
