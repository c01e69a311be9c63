"""The command: ``python -m benchmarks --help``."""

import os
import tempfile
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

_WARM_UP_FRAMES = 12
_FOLLOW_HZ = 10.0
_OUT = Path("runs/bench")


class Part(StrEnum):
    """What can be measured."""

    SPEED = "speed"
    STEPS = "steps"
    ACCURACY = "accuracy"
    MEMORY = "memory"
    SCALING = "scaling"
    VIEWER = "viewer"
    FOLLOWING = "following"


class Satellite(StrEnum):
    """The shipped ones."""

    BOXSAT = "boxsat"
    TWINWING = "twinwing"
    CUBESAT6U = "cubesat6u"


def main(
    frames: Annotated[
        int, typer.Option(min=20, help="Frames of each sequence; accuracy counts the second half.")
    ] = 100,
    long_frames: Annotated[
        int, typer.Option(min=1000, help="Frames of the long sequence of the memory part.")
    ] = 5000,
    batch_runs: Annotated[
        int, typer.Option(min=2, help="Runs of the batch of the scaling part.")
    ] = 24,
    follow_frames: Annotated[
        int, typer.Option(min=20, help="Frames that arrive in the following part, ten a second.")
    ] = 200,
    only: Annotated[list[Part] | None, typer.Option(help="Measure only this; repeatable.")] = None,
    satellite: Annotated[
        list[Satellite] | None, typer.Option(help="Compare only on this one; repeatable.")
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="Folder for the comparison's tables.")
    ] = _OUT,
    compare: Annotated[
        bool, typer.Option("--compare", help="Beside the last entry of the folder's history.")
    ] = False,
) -> None:
    """Measure pcnav against its peers, print tables and write the comparison to a folder.

    Times and memory are added to a history in that folder.

    Example: `python -m benchmarks --only speed --compare`
    """
    # As the command line of pcnav does; NumPy reads it when it is first imported, below.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    parts = only or list(Part)
    console = Console(width=max(150, Console().width))
    console.print(f"{os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} before the start")
    numbers: dict[str, float] = {}
    with tempfile.TemporaryDirectory(prefix="pcnav-bench-") as name:
        folder = Path(name)
        if Part.SPEED in parts:
            numbers |= _speed(frames, folder, console)
        if Part.STEPS in parts:
            numbers |= _steps(frames, folder, console)
        if Part.ACCURACY in parts:
            _accuracy(frames, satellite or list(Satellite), folder, out, console)
        if Part.MEMORY in parts:
            numbers |= _memory(long_frames, folder, console)
        if Part.SCALING in parts:
            _scaling(batch_runs, console)
        if Part.VIEWER in parts:
            _viewer(folder, console)
        if Part.FOLLOWING in parts:
            _following(follow_frames, folder, console)
    if numbers:
        _history(out, numbers, console, compare=compare)


def _history(out: Path, numbers: dict[str, float], console: Console, *, compare: bool) -> None:
    from benchmarks.history import append, comparison_table, entry_of, last_of_same, read

    entry, earlier = entry_of(numbers), read(out)
    append(out, entry)
    before = last_of_same(earlier, entry)
    if compare and before is not None:
        console.print(comparison_table(before, entry))
    elif compare:
        console.print(f"nothing to compare with in {out}: this is its first entry")


def _speed(frames: int, folder: Path, console: Console) -> dict[str, float]:
    from benchmarks.scenes import load, record, shortened
    from benchmarks.speed import measure_throughput, throughput_table
    from benchmarks.steps import measure_steps, steps_table

    warm_up = record("boxsat", shortened("boxsat", _WARM_UP_FRAMES), folder / "warm-up")
    measure_throughput(warm_up, folder / "warm-up-result")
    scene = record("boxsat", shortened("boxsat", frames), folder / "speed")
    throughput = measure_throughput(scene, folder / "speed-result")
    console.print(throughput_table(scene, throughput))
    case = load(scene)
    steps = measure_steps(case)
    console.print(steps_table(case, steps))
    return {**throughput.numbers, **steps.numbers}


def _steps(frames: int, folder: Path, console: Console) -> dict[str, float]:
    from benchmarks.step_cases import step_cases
    from benchmarks.step_comparison import compare_steps, compared_table

    compared = []
    for case in step_cases(frames, folder / "steps"):
        compared.append(compare_steps(case))
        console.print(f"{case.title}: {compared[-1].steps.median:.1f} ms in the median")
    console.print(compared_table(compared))
    return {
        f"{one.title} {one.size_px[0]} px: {name}": figure
        for one in compared
        for name, figure in one.steps.numbers.items()
    }


def _accuracy(
    frames: int, satellites: list[Satellite], folder: Path, out: Path, console: Console
) -> None:
    from benchmarks.accuracy import score_case
    from benchmarks.comparison import (
        case_table,
        conditions,
        judge,
        verdict_table,
        write_comparison,
    )
    from benchmarks.scenes import load, noise_levels, record, shortened

    for sentence in conditions():
        console.print(sentence)
    cases = []
    for name in satellites:
        for sigma_m in noise_levels(name):
            path = folder / f"{name}-{sigma_m:g}"
            cases.append(score_case(load(record(name, shortened(name, frames, sigma_m), path))))
            console.print(case_table(cases[-1]).to_rich())
            # Whatever is measured is kept, should a later case be interrupted.
            write_comparison(out, cases)
    console.print(verdict_table([judge(case) for case in cases]).to_rich())
    console.print(f"tables: {out}")


def _memory(long_frames: int, folder: Path, console: Console) -> dict[str, float]:
    from benchmarks.memory import SHORT_FRAMES, measure_memory, memory_table

    short, long = measure_memory(SHORT_FRAMES, folder), measure_memory(long_frames, folder)
    console.print(memory_table(short, long))
    return short.numbers


def _scaling(batch_runs: int, console: Console) -> None:
    from benchmarks.scaling import FEW, MANY, measure_batch, memory_table, speed_table

    one, two = (measure_batch("real", batch_runs, jobs) for jobs in (1, 2))
    console.print(speed_table(one, two))
    few, many = (measure_batch("cheap", runs, 2) for runs in (FEW, MANY))
    console.print(memory_table(few, many))


def _viewer(folder: Path, console: Console) -> None:
    from benchmarks.viewer import measure_viewer, viewer_table

    console.print(viewer_table(measure_viewer(folder)))


def _following(frames: int, folder: Path, console: Console) -> None:
    from benchmarks.following import following_table, measure_following
    from benchmarks.scenes import record, shortened

    pipeline = shortened("boxsat", frames)
    scenario = pipeline.scenario.model_copy(update={"frame_rate_hz": _FOLLOW_HZ})
    pipeline = pipeline.model_copy(update={"scenario": scenario})
    scene = record("boxsat", pipeline, folder / "arrives")
    measured = [
        measure_following(scene, folder / f"follow-{killed}", killed_after=killed)
        for killed in (None, frames // 2)
    ]
    console.print(following_table(measured))


if __name__ == "__main__":
    typer.run(main)
