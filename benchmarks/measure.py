"""One method on one photo: seconds of the whole call and of its parts, and its errors."""

from __future__ import annotations

import multiprocessing
import statistics
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float

from benchmarks.machine import memory_mib, use_threads
from benchmarks.methods import Flattened, Method, flattened
from benchmarks.photos.cases import Case, read_alike
from benchmarks.photos.truth import load_photo
from benchmarks.report.results import FilmScore, Forward, Measured, Memory
from benchmarks.scores import score_map
from hybrid.learn.networks.weights import parameter_count
from hybrid.metrics import psnr_after_gain_offset

PRINT_SIZE = (512, 512)
"""Size (height, width) at which film and print are compared, both scaled by area averaging."""

MEMORY_LIMIT_S = 300.0
"""A process that takes longer to measure memory is killed, and its figure left out."""


def measure(method: Method, case: Case, megapixels: float, repeats: int, warm: bool) -> Measured:
    """Time a method on a photo; unless ``warm`` (it was called at this size before), a first call is not counted."""
    given, photo, size = method.given(case), case.photo(), case.film_size()
    if not warm:
        flattened(method, given, photo, size)
    seconds, cpu, results = [], [], []
    for _ in range(repeats):
        start, start_cpu = time.perf_counter(), time.process_time()
        result = flattened(method, given, photo, size)
        cpu.append(time.process_time() - start_cpu)
        seconds.append(time.perf_counter() - start)
        results.append(result.parts)
    scored = result.backward is not None and not method.unscored
    return Measured(
        method=method.name,
        case=case.name,
        megapixels=megapixels,
        size=(photo.shape[0], photo.shape[1]),
        seconds=tuple(seconds),
        cpu_seconds=tuple(cpu),
        parts={name: statistics.median(parts[name] for parts in results) for name in result.parts},
        found=result.backward is not None,
        message=result.message,
        score=score_map(result.backward, case.backward, photo) if scored and result.backward is not None else None,
        film=film_score(case, result) if scored else None,
        grid=result.grid,
        output=None if result.image is None else (result.image.shape[0], result.image.shape[1]),
        claim=result.claim,
        sides=sides_off(case, result) if scored and method.flatten is not None else None,
    )


def film_score(case: Case, result: Flattened) -> FilmScore | None:
    """The flat pictures against the print, oriented by the map; None where the print is not known."""
    if not isinstance(case.source, Path) or result.image is None or result.backward is None:
        return None
    way = read_alike(result.backward, case.backward)[1]
    truth = at_print_size(load_photo(case.source.with_suffix(".npz")).read_print())
    lit = cv2.cvtColor(result.image, cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    film = None if result.film is None else at_print_size(way.moved(result.film))
    return FilmScore(
        lit_psnr=psnr_after_gain_offset(at_print_size(way.moved(lit)), truth),
        psnr=None if film is None else psnr_after_gain_offset(film, truth),
    )


def sides_off(case: Case, result: Flattened) -> float | None:
    """How far the flat film's ratio of sides is from the sheet's, as the logarithm's size: the end-point error does not
    show it, as it is taken at film coordinates."""
    if result.image is None or result.backward is None:
        return None
    way = read_alike(result.backward, case.backward)[1]
    height, width = way.moved(result.image[..., 0]).shape
    return abs(float(np.log(height / width / case.sheet_ratio)))


def at_print_size(grey: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "a b"]:
    """A grey picture at the size at which film and print are compared."""
    return cv2.resize(np.ascontiguousarray(grey), PRINT_SIZE[::-1], interpolation=cv2.INTER_AREA)


# ---------------------------------------------------------------- memory


def peak_memory(load: Callable[[], Case], make: Callable[[], Method], megapixels: float, threads: int) -> Memory | None:
    """The most memory that one call of a method takes, in a process that has done nothing before.

    load, make: are pickled into the process. Memory is first read after the photo is loaded and before the method is
    made, so that its weights count as its own and the photo does not, whatever else the method is given. None where the
    process dies or the system does not say.
    """
    context = multiprocessing.get_context("spawn")
    receiving, sending = context.Pipe(duplex=False)
    process = context.Process(target=_call_once, args=(load, make, megapixels, threads, sending), daemon=True)
    process.start()
    sending.close()
    try:
        return receiving.recv() if receiving.poll(MEMORY_LIMIT_S) else None
    except EOFError:  # the process died: out of memory, most likely
        return None
    finally:
        process.kill()
        process.join()


def _call_once(
    load: Callable[[], Case], make: Callable[[], Method], megapixels: float, threads: int, answer: Connection
) -> None:
    use_threads(threads)
    case = load().at(megapixels)
    photo, size = case.photo(), case.film_size()
    before = memory_mib("VmRSS")
    method = make()
    flattened(method, method.given(case.lending(photo)), photo, size)
    peak = memory_mib("VmHWM")
    answer.send(None if before is None or peak is None else Memory(method.name, megapixels, peak, peak - before))


# ---------------------------------------------------------------- networks alone


def forward_time(name: str, network: Any, device: str, batch: int, repeats: int) -> Forward:
    """Seconds of a network's forward pass on a device; the first call is not counted.

    network: its configuration gives the side of its square input.
    """
    network, px = network.to(device).eval(), network.config.input_px
    images = torch.rand(batch, 3, px, px, device=device, generator=torch.Generator(device).manual_seed(0))
    passes = [_one_pass(network, images, device) for _ in range(repeats + 1)][1:]
    seconds, cpu_seconds = zip(*passes, strict=True)
    return Forward(name, device, batch, px, parameter_count(network), seconds, cpu_seconds)


@torch.inference_mode()
def _one_pass(network: torch.nn.Module, images: torch.Tensor, device: str) -> tuple[float, float]:
    """Seconds, and processor seconds."""
    if device == "cuda":
        torch.cuda.synchronize()
    start, start_cpu = time.perf_counter(), time.process_time()
    network(images)
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter() - start, time.process_time() - start_cpu


__all__ = ["at_print_size", "film_score", "forward_time", "measure", "peak_memory"]
