"""Where prints and rooms come from: CT data and environments of the given folders, or embedded phantoms and rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import lru_cache
from pathlib import Path

import numpy as np

from data_gen.ct.folder import load_volumes
from data_gen.ct.phantom import body_phantom, head_phantom
from data_gen.ct.volumes import CtVolume, reformatted, within_patient
from data_gen.light.rooms import Environment, load_environments, procedural_room
from hybrid.errors import ConfigError, DataError, describe

PHANTOMS = 12
"""How many different embedded phantoms of each kind a data set prints by default."""

HEAD_SHARE = 0.6
"""Share of head phantoms; the others are bodies."""


@dataclass(frozen=True)
class SourceConfig:
    """What is printed and what lights it; a part can be held out for a test set."""

    ct: Path | None = None
    """Folder with CT volumes (.npz) and DICOM files, folders or zips; without it embedded phantoms are printed."""
    hdri: Path | None = None
    """Folder with .hdr environments; without it embedded rooms light the films."""
    real_share: float = 0.6
    """Share of films (rooms) taken from those folders if they are given."""
    only: tuple[str, ...] = ()
    """Names of the volumes and environments to use, * stands for anything; all if none is named."""
    leave_out: tuple[str, ...] = ()
    """Names not to use."""
    phantoms: tuple[int, int] = (0, PHANTOMS)
    """First embedded phantom and the one after the last; rooms follow the seed."""
    reformatted_share: float = 0.0
    """Share of films whose slices are coronal or sagittal."""

    def __post_init__(self) -> None:
        shares = (self.real_share, self.reformatted_share)
        if not all(0 <= share <= 1 for share in shares) or not 0 <= self.phantoms[0] < self.phantoms[1]:
            raise ConfigError(
                describe(
                    what="sources",
                    got=f"real_share, reformatted_share {shares}, phantoms {self.phantoms}",
                    allowed="shares in [0, 1], 0 <= first phantom < end",
                    do="Change the option.",
                )
            )


def draw_volume(config: SourceConfig, rng: np.random.Generator) -> CtVolume:
    """A CT volume of the given folder or an embedded phantom, some of them cut in another plane."""
    volume = _axial_volume(config, rng)
    if config.reformatted_share > 0 and rng.random() < config.reformatted_share:
        return within_patient(reformatted(volume, "coronal" if rng.random() < 0.5 else "sagittal"))
    return volume


def _axial_volume(config: SourceConfig, rng: np.random.Generator) -> CtVolume:
    if config.ct is not None and rng.random() < config.real_share:
        volumes, _ = loaded(config)
        return volumes[int(rng.integers(len(volumes)))]
    return _phantom(int(rng.integers(*config.phantoms)), bool(rng.random() < HEAD_SHARE))


def draw_environment(config: SourceConfig, rng: np.random.Generator) -> Environment:
    """An environment of the given folder or an embedded procedural room."""
    if config.hdri is not None and rng.random() < config.real_share:
        _, environments = loaded(config)
        return environments[int(rng.integers(len(environments)))]
    return procedural_room(rng)


@lru_cache(maxsize=2)
def loaded(config: SourceConfig) -> tuple[list[CtVolume], list[Environment]]:
    """The volumes and environments that the configuration chooses from its folders, each sorted by file.

    Raises:
        DataError: a folder or file cannot be read. ConfigError: a name matches nothing, or nothing is left.
    """
    try:
        volumes = [] if config.ct is None else load_volumes(config.ct)
        environments = [] if config.hdri is None else load_environments(config.hdri)
    except OSError as error:
        where = f"{config.ct}, {config.hdri}"
        raise DataError(describe(what="--ct, --hdri", where=where, got=error, do="Make it readable.")) from error
    names = [v.name for v in volumes] + [e.name for e in environments]
    for pattern in config.only + config.leave_out:
        if not _matches([pattern], names):
            raise ConfigError(
                describe(
                    what="--only, --leave-out",
                    got=pattern,
                    allowed=", ".join(names) or "names in the folders of --ct and --hdri, of which none is given",
                    do="Correct the name.",
                )
            )
    kept = set(_chosen(names, config))
    chosen = [v for v in volumes if v.name in kept], [e for e in environments if e.name in kept]
    for folder, option, found in zip((config.ct, config.hdri), ("--ct", "--hdri"), chosen, strict=True):
        if folder is not None and not found:
            do = f"Name one of them, or leave out {option}."
            raise ConfigError(
                describe(what=option, where=folder, got="nothing that --only and --leave-out leave", do=do)
            )
    return chosen


def _chosen(names: Sequence[str], config: SourceConfig) -> list[str]:
    wanted = _matches(config.only, names) if config.only else names
    unwanted = _matches(config.leave_out, names)
    return [name for name in wanted if name not in unwanted]


def _matches(patterns: Sequence[str], names: Sequence[str]) -> list[str]:
    return [name for name in names if any(fnmatchcase(name, pattern) for pattern in patterns)]


@lru_cache(maxsize=4 * PHANTOMS)
def _phantom(number: int, head: bool) -> CtVolume:
    rng = np.random.default_rng([number, int(head)])
    return head_phantom(rng) if head else body_phantom(rng)
