"""Faults of sensor and model: error, status and consistency for each, and no silent wrong lock."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import trimesh

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import Case, Run, runs_of
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.files.text_table import TextTable, number
from pcnav.simulation.random_truth import Spread, random_truth, satellite
from pcnav.simulation.scene import Scene
from pcnav.target.satellite import Rectangle, Target

from ..folder import Chapter
from ..progress import Progress
from .bars import NONE, Bar, at, joined
from .following import JudgedRun, follow, status_shares

NAME = "faults"
FRAMES = 100
_FRAME_RATE_HZ = 2.0
_SPREAD = Spread(range_m=(15.0, 30.0), rate_deg_s=(1.0, 5.0), speed_m_s=0.02)
_WRONG_RAD = float(np.deg2rad(2.0))
_WRONG_FRACTION = 0.03
"""A pose further off than either (share of the diameter) that is called locked is a silent wrong
lock."""
_MAX_WRONG = 10
"""Frames in a row for which a satellite that is another one may be called locked."""
_BOX_M = (0.3, 0.5, 0.4)
_BOX_ON = "bus_x_plus"
_BOX_OFF_CENTRE_M = (0.25, -0.4)
_BENT_PANEL = "panel_long_front"
_BEND_RAD = float(np.deg2rad(3.0))
_OTHER_SATELLITE = "cubesat6u"

Reshape = Callable[[Target], trimesh.Trimesh]


@dataclass(frozen=True)
class Fault:
    """What is wrong with the frames; the tracker is told of none of it."""

    noise: dict[str, float]
    """Fields of `NoiseTable` that differ from the shipped pipeline's."""
    reshape: Reshape
    """The body that is really there."""


def as_modelled(target: Target) -> trimesh.Trimesh:
    """The target itself."""
    return target.mesh


def with_box(target: Target) -> trimesh.Trimesh:
    """The target with a box of 0.5 x 0.4 x 0.3 m on a face of its bus, off the face's middle."""
    T_model_face = _rectangle(target, _BOX_ON).T_model_rect
    x, y = _BOX_OFF_CENTRE_M
    # The box's thin side stands up along the face's normal, which is z of the face's frame.
    height, length, width = _BOX_M
    on_face = make_transform(np.eye(3), np.array([x, y, 0.5 * height]))
    box = trimesh.creation.box((width, length, height), transform=T_model_face @ on_face)
    joined = trimesh.util.concatenate([target.mesh, box])
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def with_bent_panel(target: Target) -> trimesh.Trimesh:
    """The target with a panel turned by 3 degrees about the edge it is hung on."""
    panel = _rectangle(target, _BENT_PANEL)
    short, long, _ = panel.T_model_rect[:3, :3].T
    ends = panel.T_model_rect[:3, 3] + np.outer([-0.5, 0.5], panel.length_m * long)
    root = ends[np.argmin(np.linalg.norm(ends, axis=1))]
    R = exp_rotation(_BEND_RAD * short)
    vertices = np.array(target.mesh.vertices)
    part = _part_with_corner(target.mesh, root + 0.5 * panel.width_m * short)
    vertices[part] = (vertices[part] - root) @ R.T + root
    return trimesh.Trimesh(vertices, target.mesh.faces, process=False)


def with_box_and_bent_panel(target: Target) -> trimesh.Trimesh:
    """Both."""
    bent, boxed = with_bent_panel(target), with_box(target)
    vertices = np.array(boxed.vertices)
    vertices[: len(bent.vertices)] = bent.vertices
    return trimesh.Trimesh(vertices, boxed.faces, process=False)


def another_satellite(target: Target) -> trimesh.Trimesh:
    """Quite another satellite, scaled to the target's diameter."""
    other = satellite(_OTHER_SATELLITE).target
    mesh: trimesh.Trimesh = other.mesh.copy()
    mesh.apply_scale(target.diameter_m / other.diameter_m)
    return mesh


_EVERYTHING = {"dropout_fraction": 0.3, "outlier_fraction": 0.05, "mixed_pixel_fraction": 1.0}
WRONG_TARGET = "another satellite"
FAULTS = {
    "none": Fault({}, as_modelled),
    "30 % dropouts": Fault({"dropout_fraction": 0.3}, as_modelled),
    "5 % outliers": Fault({"outlier_fraction": 0.05}, as_modelled),
    "half of the edge pixels mixed": Fault({"mixed_pixel_fraction": 0.5}, as_modelled),
    "all edge pixels mixed": Fault({"mixed_pixel_fraction": 1.0}, as_modelled),
    "box on the bus, not modelled": Fault({}, with_box),
    "panel bent by 3 degrees": Fault({}, with_bent_panel),
    "all of these at once": Fault(_EVERYTHING, with_box_and_bent_panel),
    WRONG_TARGET: Fault({}, another_satellite),
}


@dataclass(frozen=True)
class FaultRun:
    """A run with a fault."""

    fault: str
    seed: int
    run: JudgedRun

    @property
    def silent(self) -> FloatArray:
        """(n,) frames called locked or ambiguous that are wrong, as 0 and 1."""
        if self.fault == WRONG_TARGET:
            return self.run.claims.astype(np.float64)
        limit_m = _WRONG_FRACTION * satellite("boxsat").target.diameter_m
        wrong = (self.run.attitude_rad > _WRONG_RAD) | (self.run.position_m > limit_m)
        return (self.run.claims & wrong).astype(np.float64)

    @property
    def longest_silent(self) -> int:
        """Most such frames in a row."""
        longest = current = 0
        for wrong in self.silent:
            current = current + 1 if wrong else 0
            longest = max(longest, current)
        return longest


@dataclass(frozen=True)
class FaultResult:
    """All faults and what they come to."""

    chapter: Chapter
    bars: tuple[Bar, ...]
    runs: tuple[FaultRun, ...]


def run_fault(fault: str, seed: int, frames: int = FRAMES) -> FaultRun:
    """One track of boxsat with a fault: truth and noise are the seed's."""
    of, wrong = satellite("boxsat"), FAULTS[fault]
    truth = random_truth(of, _SPREAD, seed, frames=frames, frame_rate_hz=_FRAME_RATE_HZ)
    noise = NoiseTable.model_validate({**truth.noise.model_dump(), **wrong.noise})
    truth = truth.model_copy(update={"noise": noise})
    return FaultRun(fault, seed, follow(Scene.of(truth, wrong.reshape(of.target)), of.target))


def _run(run: Run[str], frames: int) -> FaultRun:
    return run_fault(run.case.settings, run.seed, frames)


def planned_faults(count: int) -> list[Run[str]]:
    """So many runs of every fault, on the same truths."""
    return runs_of(NAME, [Case(fault, fault) for fault in FAULTS], count)


def fault_chapter(
    runs: list[Run[str]], frames: int, workers: Workers, progress: Progress
) -> FaultResult:
    """Run the faults and lay them out."""
    found = run_all(partial(_run, frames=frames), runs, workers, lambda: progress.add(frames))
    of = {fault: [run for run in found if run.fault == fault] for fault in FAULTS}
    chapter = Chapter("Faults", _TEXT, (_table(of), _silent_table(found)))
    return FaultResult(chapter, _bars(of), tuple(found))


def _bars(of: dict[str, list[FaultRun]]) -> tuple[Bar, ...]:
    silent = {fault: int(sum(run.silent.sum() for run in own)) for fault, own in of.items()}
    bars = [
        Bar(NAME, f"{fault}: frames of silent wrong lock", "0", str(count), count == 0)
        for fault, count in silent.items()
        if fault != WRONG_TARGET
    ]
    longest = max(run.longest_silent for run in of[WRONG_TARGET])
    bars.append(
        Bar(
            NAME,
            f"{WRONG_TARGET}: frames in a row called locked",
            f"<= {_MAX_WRONG}",
            str(longest),
            longest <= _MAX_WRONG,
        )
    )
    return tuple(bars)


def _table(of: dict[str, list[FaultRun]]) -> TextTable:
    rows = []
    for fault, own in of.items():
        runs = [each.run for each in own]
        half = [slice(len(run) // 2, None) for run in runs]
        position = np.concatenate([run.position_m[h] for run, h in zip(runs, half, strict=True)])
        attitude = np.concatenate([run.attitude_rad[h] for run, h in zip(runs, half, strict=True)])
        nees = np.concatenate([run.pose_nees[h] for run, h in zip(runs, half, strict=True)])
        explained = np.concatenate([run.inlier_ratio[h] for run, h in zip(runs, half, strict=True)])
        millimetres, degrees = 1e3 * position, np.rad2deg(attitude)
        errors = [joined(*(at(percent, v) for percent in (50, 95))) for v in (millimetres, degrees)]
        compared = fault != WRONG_TARGET
        rows.append(
            (
                fault,
                status_shares(runs),
                str(len(runs)),
                *(errors if compared else [NONE] * 2),
                number(_mean(nees) / 6.0) if compared else NONE,
                number(_mean(explained)),
                str(int(sum(each.silent.sum() for each in own))),
                str(max(each.longest_silent for each in own)),
            )
        )
    header = (
        "fault",
        "status",
        "runs",
        "position, mm",
        "attitude, deg",
        "pose NEES",
        "inlier ratio",
        "silent wrong",
        "in a row",
    )
    return TextTable(
        "faults",
        "The tracker under faults it is not told of",
        header,
        tuple(rows),
        "Errors (median / 95 %), mean NEES over its degrees of freedom and mean inlier ratio "
        "over the second half of the runs; status and silent wrong frames over all of them. Silent "
        "wrong: called locked or ambiguous while more than 2 degrees or 3 % of the diameter off; "
        "any frame so called of another satellite. In a row: the longest stretch of them.",
        text_columns=2,
    )


def _silent_table(runs: list[FaultRun]) -> TextTable:
    rows = []
    for each in runs:
        wrong = np.flatnonzero(each.silent)
        if wrong.size:
            rows.append(
                (each.fault, str(each.seed), str(wrong.size), str(wrong[0]), str(wrong[-1]))
            )
    return TextTable(
        "silent_wrong",
        "Runs with silent wrong frames",
        ("fault", "seed", "frames", "first", "last"),
        tuple(rows) or (("none", *[NONE] * 4),),
        "One of them alone: studies.tracking.faults.run_fault(fault, seed).",
    )


def _mean(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else np.nan


def _rectangle(target: Target, name: str) -> Rectangle:
    return next(rectangle for rectangle in target.rectangles if rectangle.name == name)


def _part_with_corner(mesh: trimesh.Trimesh, p_model: FloatArray) -> BoolArray:
    """(n,) whether each vertex belongs to the closed part that has a corner at a point."""
    labels = trimesh.graph.connected_component_labels(mesh.edges_unique, len(mesh.vertices))
    corner = int(np.argmin(np.linalg.norm(np.asarray(mesh.vertices) - p_model, axis=1)))
    return np.asarray(labels == labels[corner])


_TEXT = (
    "Boxsat at 15 to 30 m, tumbling at 1 to 5 deg/s, 2 Hz. Every fault meets the same random "
    "motions. The frames show the fault; the tracker always gets the undisturbed model and is "
    "told the noise along the ray only. Outliers are uniform over the depth of the target, mixed "
    "pixels lie between the two surfaces at an edge, the box (0.5 x 0.4 x 0.3 m) stands on the "
    "bus, and the panel is bent about its root, which puts its tip 0.21 m off. In the last row "
    "the frames show a 6U CubeSat scaled to the size of boxsat.",
)
