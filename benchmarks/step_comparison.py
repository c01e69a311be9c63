"""Steps of the tracker beside the floor and beside ICP on the same frames, case by case."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from time import process_time

import numpy as np
from rich.table import Table

from benchmarks.peers import followed
from benchmarks.scenes import Case
from benchmarks.steps import StepTimes, measure_steps
from pcnav.estimators.interface import FirstPose
from pcnav.estimators.peers.icp import Open3dIcp, SmallGicp

MEDIAN_BAR, P99_BAR, LONGEST_BAR_MS, PEER_BAR = 3.0, 3.0, 33.0, 0.25
"""Most that the median may be over the floor, the 99th percentile over the median, the largest
step, and the median over that of a peer."""


@dataclass(frozen=True)
class ComparedSteps:
    """One case. Times are milliseconds of processor time, each method on one thread."""

    title: str
    faces: int
    size_px: tuple[int, int]
    target_px: float
    """Returns of a frame, in the median."""
    steps: StepTimes
    open3d_ms: float
    """Of point-to-plane ICP to points sampled from the mesh, from depth image to pose; in the
    median after the start of the tracker."""
    small_gicp_ms: float

    @property
    def outcomes(self) -> tuple[tuple[float, bool], ...]:
        """Each figure that has a bar, and whether it is within: median over floor, 99th percentile
        over median, largest step, median over Open3D's and over small_gicp's."""
        steps = self.steps
        bars = (MEDIAN_BAR, P99_BAR, LONGEST_BAR_MS, PEER_BAR, PEER_BAR)
        figures = (
            *(steps.median / steps.floor, steps.p99 / steps.median, steps.longest),
            *(steps.median / self.open3d_ms, steps.median / self.small_gicp_ms),
        )
        return tuple((figure, figure <= bar) for figure, bar in zip(figures, bars, strict=True))


def compare_steps(case: Case) -> ComparedSteps:
    """Time the tracker, the floor and both peers on a case in memory."""
    steps, camera = measure_steps(case), case.frames[0].camera
    peers = []
    for make in (partial(Open3dIcp, threads=1), partial(SmallGicp, threads=1)):
        seconds = followed(make, FirstPose.NEAR, case, process_time).seconds
        peers.append(1e3 * float(np.median(seconds[-steps.frames :])))
    return ComparedSteps(
        title=case.scene.name,
        faces=len(case.scene.target.mesh.faces),
        size_px=(camera.width, camera.height),
        target_px=float(np.median([np.count_nonzero(frame.depth_m) for frame in case.frames])),
        steps=steps,
        open3d_ms=peers[0],
        small_gicp_ms=peers[1],
    )


def compared_table(compared: Sequence[ComparedSteps]) -> Table:
    """A row for each case; what is beyond its bar is marked."""
    table = Table(
        title="Steps of the tracker after its start, beside the floor and ICP on the same frames",
        caption="ms of processor time on one thread, medians but for the 99th percentile and the "
        "largest. The floor reads a frame, renders three views and sums three normal equations. "
        "A star marks what is beyond its bar.",
    )
    for column in ("target", "faces", "image, px", "returns", "floor", "median", "99 %", "largest"):
        table.add_column(column, justify="left" if column == "target" else "right")
    bars = (f"/ floor <= {MEDIAN_BAR:g}", f"99 % / median <= {P99_BAR:g}")
    for column in (*bars, f"largest <= {LONGEST_BAR_MS:g}", "Open3D", "small_gicp"):
        table.add_column(column, justify="right")
    for column in (f"/ Open3D <= {PEER_BAR:g}", f"/ small_gicp <= {PEER_BAR:g}", "start"):
        table.add_column(column, justify="right")
    for one in compared:
        steps = one.steps
        shown = [f"{figure:.2f}{'' if met else ' *'}" for figure, met in one.outcomes]
        table.add_row(
            *(one.title, f"{one.faces:,}", "{} x {}".format(*one.size_px), f"{one.target_px:,.0f}"),
            *(f"{ms:.1f}" for ms in (steps.floor, steps.median, steps.p99, steps.longest)),
            *(*shown[:3], f"{one.open3d_ms:.1f}", f"{one.small_gicp_ms:.1f}", *shown[3:]),
            f"{steps.start:.0f}",
        )
    return table
