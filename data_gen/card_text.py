"""The words of a data set's card."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from data_gen.sample import SampleConfig
from data_gen.sources import PHANTOMS
from hybrid.learn.datasets import coding
from hybrid.learn.datasets.shards import ShardEntry

_SAID = ("size", "map_size")
"""Options of a sample that the command has words for."""

_TEMPLATE = """\
# Photos of bent CT films, with the truth

{count} photos of {films}: {size} x {size} px, maps {map_size} x {map_size}. {shards} shards, {gigabytes:.3g} GB.
Everything is simulated: printed CT slices, bent sheets, light, camera.

![{shown} of the photos](contact_sheet.jpg)

## How it was made

```bash
{command}
```

hybrid {version}. {same}; a larger count adds to them. `dataset.json` holds every option, `manifest.json` the size and
sha256 of each shard.

- Scans: {volumes}.
- Rooms: {environments}.

## A sample

Each shard is a plain tar file in the WebDataset layout. The files of a sample share a key, its number in the data set:

| file | what | stored as |
| --- | --- | --- |
| KEY.photo.jpg | the photo, sRGB | JPEG |
| KEY.mask.npy | pixels that see film | bool (h, w) |
| KEY.uv.npy | film coordinates, origin top left | uint16 (h, w, 2) |
| KEY.xyz.npy | mm, camera axes (x right, y down, z forward); depth is z | uint16 (h, w, 3) |
| KEY.normal.npy | unit normal, camera axes, towards the side that reads right | int16 (h, w, 2) |
| KEY.albedo.npy | display grey of the print | uint8 (h, w) |
| KEY.glare.npy | film clipped or veiled beyond recovery | bool (h, w) |
| KEY.backward.npy | photo point of film nodes, edges included | float32 (65, 65, 2) |
| KEY.json | size of the film, camera, grid vertices, coding, every parameter | JSON |

{coding}
`hybrid.learn.datasets.shards.open_dataset(DIR)` gives the maps decoded (`shard.field("xyz", 0)`) or in place and as
stored (`shard.stored("xyz", 0)`); `webdataset` and `tarfile` read the same files.

## How it is spread

![Histograms](histograms.png)

| | 5 % | median | 95 % |
| --- | --- | --- | --- |
{numbers}

Layouts (rows x columns): {layouts}.

## Licence and limits

Prints of embedded phantoms in embedded rooms are free of others' rights. Scans and environments that are named above
keep their own licences: give the credit they ask for when the set is passed on. No name, number or date of a patient is
printed; the texts on the films are made up. Simulated photos are no clinical data: judge methods on real ones as well.
"""


def card_text(
    description: Mapping[str, Any],
    entries: Sequence[ShardEntry],
    numbers: Mapping[str, tuple[np.ndarray, str]],
    layouts: Mapping[str, int],
) -> str:
    """The card in Markdown, for a data set's description, shards, and values of its labels."""
    count, sample = sum(entry.count for entry in entries), description["sample"]
    films = -(-count // sample["photos_per_film"])
    sources, shares = description["sources"], sorted(layouts.items(), key=lambda item: -item[1])
    return _TEMPLATE.format(
        count=count,
        films="1 film" if films == 1 else f"{films} films",
        size=sample["size"],
        map_size=sample["map_size"],
        shards=len(entries),
        gigabytes=sum(entry.bytes for entry in entries) / 1e9,
        shown=min(count, 64),
        command=command(description),
        version=description["hybrid"],
        same=_same(description),
        volumes=_share_of(sources["volumes"], "embedded phantoms", sources["real_share"]),
        environments=_share_of(sources["environments"], "embedded procedural rooms", sources["real_share"]),
        coding=_coding_table(),
        numbers="\n".join(_row(title, *values) for title, values in numbers.items()),
        layouts=", ".join(f"{name} {100 * n / sum(layouts.values()):.2g} %" for name, n in shares),
    )


def command(description: Mapping[str, Any]) -> str:
    """The command that makes a data set; folders have stand-in names, as the description holds no paths."""
    sources, sample = description["sources"], description["sample"]
    words = [
        f"python -m data_gen.generate --count {description['count']} --seed {description['seed']} --out DIR",
        f"--size {sample['size']} --map-size {sample['map_size']} --shard-size {description['shard_size']}",
    ]
    words += ["--ct CT_FOLDER"] if sources["volumes"] else []
    words += ["--hdri HDRI_FOLDER"] if sources["environments"] else []
    words += [f"--real-share {sources['real_share']}"]
    if sources.get("reformatted_share"):
        words += [f"--reformatted-share {sources['reformatted_share']}"]
    words += [f"--only {shlex.join(sources['only'])}"] if sources["only"] else []
    words += [f"--leave-out {shlex.join(sources['leave_out'])}"] if sources["leave_out"] else []
    words += ["--phantoms {} {}".format(*sources["phantoms"])] if sources["phantoms"] != [0, PHANTOMS] else []
    return " \\\n    ".join(words)


def _same(description: Mapping[str, Any]) -> str:
    """What gives the same bytes: the command, and options that it has no words for."""
    usual = json.loads(json.dumps(asdict(SampleConfig())))
    other = [name for name, value in description["sample"].items() if name not in _SAID and value != usual[name]]
    if not other:
        return "The same command gives the same bytes"
    return (
        f"Made in Python, as other samples than the command's own: `{'`, `'.join(other)}`. The same command with "
        "`GenerateConfig.sample` as in `dataset.json` gives the same bytes"
    )


def _share_of(names: Sequence[str], embedded: str, real_share: float) -> str:
    if not names:
        return f"{embedded} only"
    return f"{', '.join(names)} ({100 * real_share:g} % of the films); {embedded} (the others)"


def _coding_table() -> str:
    """The table of codings and of their errors, as the module that does it has it."""
    assert coding.__doc__ is not None
    return coding.__doc__.partition("\n\n")[2]


def _row(title: str, values: np.ndarray, unit: str) -> str:
    low, median, high = np.percentile(values, [5, 50, 95])
    return f"| {title}{f' ({unit})' if unit else ''} | {low:.3g} | {median:.3g} | {high:.3g} |"
