"""Processor time of single steps of the tracker, beside the least that a frame can take."""

import gc
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from rich.table import Table

from benchmarks.scenes import Case
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import pixel_rays
from pcnav.estimators.interface import Given
from pcnav.estimators.registry import make_estimator
from pcnav.recordings.depth_png import read_depth_png
from pcnav.target.rendering import DepthRenderer

_PASSES = 3
"""Renders and normal equations of a frame at the floor."""
_FLOOR_FRAMES = 20


@dataclass(frozen=True)
class StepTimes:
    """Milliseconds of processor time, on one thread."""

    frames: int
    """After the start."""
    start: float
    """All frames up to the first pose that is claimed, together."""
    median: float
    p99: float
    longest: float
    floor: float
    """Reading a frame, three renders and three normal equations of its pixels, in the median."""

    @property
    def numbers(self) -> dict[str, float]:
        """By name, for a history. Ratios say more than times do of a machine that is not alone."""
        return {
            "step median, ms": self.median,
            "step 99th percentile over median": self.p99 / self.median,
            "largest step over median": self.longest / self.median,
            "step median over floor": self.median / self.floor,
            "start over floor": self.start / self.floor,
        }


def measure_steps(case: Case) -> StepTimes:
    """Track a case in memory, the floor measured in between: both on the machine as it is then.

    Raises ``LookupError`` where no pose is ever claimed.
    """
    estimator = make_estimator("depth", Given(case.scene.pipeline, case.info, case.scene.target))
    images = sorted((case.scene.path / "depth").glob("*.png"))
    renderer = DepthRenderer(case.scene.target.mesh, case.frames[0].camera)
    # The first one makes what all others share.
    _floor_of(images[0], renderer, case.T_cam_model[0], case)
    every = max(len(images) // _FLOOR_FRAMES, 1)
    times: list[float] = []
    claimed: list[bool] = []
    floor: list[float] = []
    for k, frame in enumerate(case.frames):
        before = process_time()
        estimate = estimator.step(frame)
        times.append(1e3 * (process_time() - before))
        if estimate.is_claimed and not any(claimed):
            # As `pcnav.navigation.Navigation` does.
            gc.freeze()
        claimed.append(estimate.is_claimed)
        if k % every == 0:
            before = process_time()
            _floor_of(images[k], renderer, case.T_cam_model[k], case)
            floor.append(1e3 * (process_time() - before))
    if not any(claimed[:-1]):
        raise LookupError(f"{case.title}: no pose was claimed before the last frame")
    first = claimed.index(True)
    after = np.array(times[first + 1 :])
    return StepTimes(
        frames=len(after),
        start=float(np.sum(times[: first + 1])),
        median=float(np.median(after)),
        p99=float(np.percentile(after, 99)),
        longest=float(after.max()),
        floor=float(np.median(floor)),
    )


def _floor_of(image: Path, renderer: DepthRenderer, T_cam_model: FloatArray, case: Case) -> None:
    """What no comparison with rendered views goes without."""
    depth_m = read_depth_png(image).astype(np.float64)
    camera = case.frames[0].camera
    for _ in range(_PASSES):
        rendered = renderer.render(T_cam_model)
        inside = rendered.triangle[rendered.window] >= 0
        rays = pixel_rays(camera)[rendered.window][inside]
        normal = rendered.inverse_depth_planes[rendered.triangle[rendered.window][inside]]
        p_model = rays * rendered.depth_m[rendered.window][inside][:, None] - T_cam_model[:3, 3]
        residual = depth_m[rendered.window][inside] - rendered.depth_m[rendered.window][inside]
        rows = np.column_stack([normal, np.cross(p_model, normal), residual])
        _ = rows.T @ rows


def steps_table(case: Case, times: StepTimes) -> Table:
    """Times of the steps, and each over the median and over the floor."""
    table = Table(
        title=f"a step of the tracker: {case.title}",
        caption="Processor time on one thread. The floor reads a frame, renders three views and "
        "sums three normal equations.",
    )
    table.add_column("step")
    for column in ("ms", "over median", "over floor"):
        table.add_column(column, justify="right")
    for name, ms in (
        ("floor", times.floor),
        ("median", times.median),
        ("99th percentile", times.p99),
        ("largest after the start", times.longest),
        ("all of the start", times.start),
    ):
        over = f"{ms / times.median:.2f}", f"{ms / times.floor:.1f}"
        table.add_row(name, f"{ms:.2f}", *over)
    return table
