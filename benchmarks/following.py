"""`pcnav run --follow` in real time: frames arrive at a rate, the run is killed and gone on with.

A thread writes frames as a recorder would, each under a hidden name that is then changed, at the
times that their stamps say. The command is a process of its own. In the middle it is killed and
begun again at once; frames go on arriving meanwhile. Its answers must be those of a run on the
whole recording, to the digit.

Others who use the machine make frames late that nobody else would: what the processor times of the
frames would have made of the same arrivals, one after the other, is shown beside.
"""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from benchmarks.scenes import Scene
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.pipeline import run
from pcnav.recordings.bop import DEPTH_FOLDER
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import STATES_FILE
from pcnav.runs.timing import AnswerTime, Timing, read_timing

_READY = b"waiting for frames"
"""What the command says when it is ready for the first frame."""
_LOOK_S = 0.02


@dataclass(frozen=True)
class Followed:
    """How the frames of one run were answered."""

    title: str
    budget_s: float
    rate_hz: float
    rows: tuple[Timing, ...]
    """In order of time."""
    claimed: int | None
    """Place of the first frame whose pose is claimed."""
    killed_after: int | None
    """Frames that were answered when it was killed; None where it was not."""
    same: bool
    """Whether its answers are those of a run on the whole recording."""

    def late(self, word: AnswerTime) -> int:
        """How many frames were answered so."""
        return sum(row.answer is word for row in self.rows)

    def late_after_claim(self) -> int:
        """Frames answered late after the first claim, not counting what was caught up on."""
        first = len(self.rows) if self.claimed is None else self.claimed
        return sum(row.answer is AnswerTime.LATE for row in self.rows[first + 1 :])

    @property
    def delays_s(self) -> FloatArray:
        """(n,) of the frames whose coming was seen; nan of the others."""
        return np.array([row.delay_s for row in self.rows])

    @property
    def processor_s(self) -> FloatArray:
        """(n,) that each frame took; nan where it was not measured."""
        return np.array([row.processor_s for row in self.rows])

    @property
    def alone_s(self) -> FloatArray:
        """(n,) delays that the processor times alone make."""
        delays, free_s = [], 0.0
        for k, cost_s in enumerate(np.nan_to_num(self.processor_s)):
            came_s = k / self.rate_hz
            free_s = max(free_s, came_s) + float(cost_s)
            delays.append(free_s - came_s)
        return np.array(delays)


def measure_following(
    scene: Scene, folder: Path, *, budget_s: float = 0.1, killed_after: int | None = None
) -> Followed:
    """Feed a scene in real time to the command, and kill it after so many answers, if told."""
    arriving, out, whole = folder / "arriving", folder / "live", folder / "whole"
    (arriving / DEPTH_FOLDER).mkdir(parents=True)
    for path in scene.path.iterdir():
        if path.is_file() and path.name != "scene_gt.json":
            shutil.copy(path, arriving)
    words = ["-m", "pcnav", "run", "--follow", str(arriving), "-o", str(out), "--no-report"]
    command = [sys.executable, *words, "--budget", str(budget_s)]
    process = _ready(command)
    rate_hz = scene.pipeline.scenario.frame_rate_hz
    recorder = threading.Thread(target=_record, args=(scene.path, arriving, rate_hz))
    recorder.start()
    answered = None
    if killed_after is not None:
        answered = _wait_for(out, killed_after, process)
        process.send_signal(signal.SIGKILL)
        process.wait()
        answered = len(read_run(out))
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    recorder.join()
    (arriving / "END").touch()
    if process.wait() != 0:
        raise RuntimeError(f"{' '.join(words)}: exit code {process.returncode}")
    run(scene.path, whole, Pipeline(), report=False)
    found = read_run(out)
    states = [(path / STATES_FILE).read_bytes() for path in (out, whole)]
    rows = tuple(row for _, row in sorted(read_timing(out).items()))
    claims = [k for k, word in enumerate(found.status) if word in ("locked", "ambiguous")]
    title = f"{scene.name}, {len(rows)} frames at {rate_hz:g} Hz"
    first = claims[0] if claims else None
    same = states[0] == states[1]
    return Followed(title, budget_s, rate_hz, rows, first, answered, same)


def following_table(measured: list[Followed]) -> Table:
    """What came of each."""
    table = Table(title=f"Frames answered as they arrive, {os.getloadavg()[0]:.1f} others busy")
    table.add_column("")
    for heading in (
        *("late", "after the first claim", "behind", "delay: median", "largest, ms"),
        *("late by processor time", "after the first claim", "processor: median", "largest, ms"),
        "answers",
    ):
        table.add_column(heading, justify="right")
    for each in measured:
        killed = "" if each.killed_after is None else f", killed after {each.killed_after}"
        first = len(each.rows) if each.claimed is None else each.claimed + 1
        alone = each.alone_s > each.budget_s
        table.add_row(
            f"{each.title}{killed}",
            str(each.late(AnswerTime.LATE)),
            str(each.late_after_claim()),
            str(each.late(AnswerTime.BEHIND)),
            *_spread_ms(each.delays_s),
            str(np.count_nonzero(alone)),
            str(np.count_nonzero(alone[first:])),
            *_spread_ms(each.processor_s[first:]),
            "the same" if each.same else "OTHERS",
        )
    return table


def _spread_ms(seconds: FloatArray) -> tuple[str, str]:
    known = 1e3 * seconds[np.isfinite(seconds)]
    return (f"{np.median(known):.0f}", f"{known.max():.0f}") if len(known) else ("-", "-")


def _ready(command: list[str]) -> "subprocess.Popen[bytes]":
    """The command, waiting for frames."""
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert process.stderr is not None, "it is a pipe"
    for line in process.stderr:
        if _READY in line:
            # Nobody may be held up by a pipe that is full.
            threading.Thread(target=process.stderr.read, daemon=True).start()
            return process
    raise RuntimeError(f"{' '.join(command)}: exit code {process.wait()}")


def _record(source: Path, folder: Path, rate_hz: float) -> None:
    began_s = time.monotonic()
    for k, image in enumerate(sorted((source / DEPTH_FOLDER).iterdir())):
        time.sleep(max(began_s + k / rate_hz - time.monotonic(), 0.0))
        hidden = folder / DEPTH_FOLDER / f".{image.name}"
        shutil.copy(image, hidden)
        hidden.rename(hidden.with_name(image.name))


def _wait_for(out: Path, frames: int, process: "subprocess.Popen[bytes]") -> int:
    """Until a result has so many rows."""
    while process.poll() is None:
        states = out / STATES_FILE
        done = states.read_bytes().count(b"\n") - 1 if states.is_file() else 0
        if done >= frames:
            return done
        time.sleep(_LOOK_S)
    raise RuntimeError(f"the run ended before {frames} frames: exit code {process.returncode}")
