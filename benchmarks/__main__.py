"""The command: ``python -m benchmarks --help``."""

import os
import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from benchmarks.accuracy import score_case, score_table
from benchmarks.memory import SHORT_FRAMES, measure_memory, memory_table
from benchmarks.scenes import Scene, load, record, shortened
from benchmarks.speed import measure_throughput, throughput_table

_WARM_UP_FRAMES = 12


class Part(StrEnum):
    """What can be measured."""

    SPEED = "speed"
    ACCURACY = "accuracy"
    MEMORY = "memory"


def main(
    frames: Annotated[int, typer.Option(min=20, help="Frames of each timed sequence.")] = 150,
    long_frames: Annotated[
        int, typer.Option(min=1000, help="Frames of the long sequence of the memory part.")
    ] = 5000,
    only: Annotated[list[Part] | None, typer.Option(help="Measure only this; repeatable.")] = None,
    every_case: Annotated[
        bool, typer.Option("--all", help="All satellites, each at two noise levels.")
    ] = False,
) -> None:
    """Measure pcnav against its peers and print tables.

    Example: `python -m benchmarks --only accuracy --frames 60`
    """
    parts = only or list(Part)
    console = Console(width=max(150, Console().width))
    blas_threads = os.environ.get("OPENBLAS_NUM_THREADS", "not set")
    console.print(
        f"{os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} before the start, "
        f"OPENBLAS_NUM_THREADS {blas_threads}"
    )
    with tempfile.TemporaryDirectory(prefix="pcnav-bench-") as name:
        folder = Path(name)
        if Part.SPEED in parts:
            _speed(frames, folder, console)
        if Part.ACCURACY in parts:
            _accuracy(frames, every_case, folder, console)
        if Part.MEMORY in parts:
            short = measure_memory(SHORT_FRAMES, folder)
            console.print(memory_table(short, measure_memory(long_frames, folder)))


def _speed(frames: int, folder: Path, console: Console) -> None:
    warm_up = record("boxsat", shortened("boxsat", _WARM_UP_FRAMES), folder / "warm-up")
    measure_throughput(warm_up, folder / "warm-up-result")
    scene = record("boxsat", shortened("boxsat", frames), folder / "speed")
    console.print(throughput_table(scene, measure_throughput(scene, folder / "speed-result")))


def _accuracy(frames: int, every_case: bool, folder: Path, console: Console) -> None:
    for scene in _scenes(frames, every_case, folder):
        case = load(scene)
        console.print(score_table(case, score_case(case)))


def _scenes(frames: int, every_case: bool, folder: Path) -> list[Scene]:
    """The benchmark's scene; with ``every_case`` all satellites at their noise and half of it."""
    if not every_case:
        return [record("boxsat", shortened("boxsat", frames), folder / "boxsat")]
    scenes = []
    for name in ("boxsat", "twinwing", "cubesat6u"):
        own_sigma_m = shortened(name, frames).noise.range_sigma_m
        for sigma_m in (own_sigma_m, 0.5 * own_sigma_m):
            pipeline = shortened(name, frames, sigma_m)
            scenes.append(record(name, pipeline, folder / f"{name}-{sigma_m:g}"))
    return scenes


if __name__ == "__main__":
    typer.run(main)
