"""Peak memory of `pcnav run` on a short and on a long sequence, each in a process of its own."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from benchmarks.scenes import record, shortened
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import OrbitTable
from pcnav.config.sensors import CameraTable
from pcnav.runs.provenance import pipeline_toml

SHORT_FRAMES = 500
_SIZE_PX = 96
_FOV_DEG = 40.0
_RANGE_M = 15.0
_MB = 1e-6


@dataclass(frozen=True)
class PeakMemory:
    """Peak resident memory of one run, bytes."""

    frames: int
    tracking: int
    """Up to the last frame: reading, estimating, writing."""
    whole: int
    """With the evaluation and the report."""

    @property
    def numbers(self) -> dict[str, float]:
        """By name, for a history."""
        of = f"peak of {self.frames} frames"
        return {f"{of}, MB": _MB * self.tracking, f"{of} and report, MB": _MB * self.whole}


def long_pipeline(frames: int) -> Pipeline:
    """The benchmark's satellite before a small camera, held in the orbit so that it stays in view.

    Small images and a near target make many frames affordable; what is kept from one frame to the
    next does not depend on their size.
    """
    pipeline = shortened("boxsat", frames)
    orbit = OrbitTable(
        mean_motion_rad_s=pipeline.orbit.mean_motion_rad_s, r_hill_m=(_RANGE_M, 0.0, 0.0)
    )
    camera = CameraTable(width_px=_SIZE_PX, height_px=_SIZE_PX, horizontal_fov_deg=_FOV_DEG)
    return pipeline.model_copy(update={"orbit": orbit, "camera": camera})


def measure_memory(frames: int, folder: Path) -> PeakMemory:
    """Simulate that many frames to disk and run them in a child process."""
    pipeline = long_pipeline(frames)
    scene = record("boxsat", pipeline, folder / f"sequence-{frames}")
    settings = folder / f"pipeline-{frames}.toml"
    settings.write_text(pipeline_toml(pipeline, {}), encoding="utf-8")
    out = folder / f"result-{frames}"
    command = [sys.executable, "-m", "benchmarks.memory_child", scene.path, settings, out]
    done = subprocess.run(
        [str(word) for word in command], check=True, stdout=subprocess.PIPE, text=True
    )
    answer = json.loads(done.stdout)
    return PeakMemory(answer["frames"], answer["tracking_bytes"], answer["whole_bytes"])


def memory_table(short: PeakMemory, long: PeakMemory) -> Table:
    """Both runs and their ratio."""
    table = Table(
        title=f"peak memory of pcnav run, {_SIZE_PX} x {_SIZE_PX} px frames streamed from disk",
        caption="Resident memory, libraries included (peak of a process of its own).",
    )
    table.add_column("up to")
    for run in (short, long):
        table.add_column(f"{run.frames} frames, MB", justify="right")
    table.add_column("ratio", justify="right")
    table.add_column("MB per 1000 frames", justify="right")
    for name, first, second in (
        ("the last frame", short.tracking, long.tracking),
        ("the end of the report", short.whole, long.whole),
    ):
        slope = 1e3 * _MB * (second - first) / (long.frames - short.frames)
        cells = [f"{_MB * first:.1f}", f"{_MB * second:.1f}", f"{second / first:.3f}"]
        table.add_row(name, *cells, f"{slope:.2f}")
    return table
