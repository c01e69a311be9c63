"""Faults of sensor and model: error, status and consistency for each, and no silent wrong lock."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
import trimesh

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.core.statistics import mean, percentile
from pcnav.files.text_table import TextTable
from pcnav.simulation.depth import Scene
from pcnav.simulation.random_truth import satellite
from pcnav.target.satellite import Rectangle, Target

from ..following import JudgedRun, follow, status_shares
from ..tables import Claim, at_most, marked_frames, never, table_of
from .tumbles import boxsat, tumble

NAME = "faults"
FRAMES = 100
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
    return _boxed(target.mesh, target)


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
    return _boxed(with_bent_panel(target), target)


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


CASES = {fault: (fault,) for fault in FAULTS}


@dataclass(frozen=True)
class FaultRun:
    """A run with a fault."""

    fault: str
    seed: int
    run: JudgedRun

    @property
    def silent(self) -> BoolArray:
        """(n,) frames called locked or ambiguous that are wrong."""
        if self.fault == WRONG_TARGET:
            return self.run.claims
        return self.run.claims & ~self.run.is_right(boxsat().target)

    @property
    def longest_silent(self) -> int:
        """Most such frames in a row."""
        stretches = (len(list(same)) for wrong, same in groupby(self.silent) if wrong)
        return max(stretches, default=0)


FaultRuns = Mapping[str, Sequence[FaultRun]]
"""By fault."""


def run_fault(fault: str, seed: int, frames: int = FRAMES) -> FaultRun:
    """One track of boxsat with a fault: truth and noise are the seed's."""
    truth, target, wrong = tumble(seed, frames), boxsat().target, FAULTS[fault]
    noise = NoiseTable.model_validate({**truth.noise.model_dump(), **wrong.noise})
    scene = Scene.of(truth.model_copy(update={"noise": noise}), wrong.reshape(target))
    return FaultRun(fault, seed, follow(scene, target))


def tables(found: FaultRuns) -> list[TextTable]:
    """All faults, and the runs with silent wrong frames."""
    silent = [run for own in found.values() for run in own if run.silent.any()]
    return [_table(found), _silent_table(silent)]


def silent_frames(runs: Sequence[FaultRun]) -> int:
    """Frames called locked or ambiguous that are wrong."""
    return sum(int(np.count_nonzero(run.silent)) for run in runs)


def claims(found: FaultRuns) -> list[Claim]:
    """No silent wrong lock under any fault, and few frames of another satellite called locked."""
    longest = [run.longest_silent for run in found[WRONG_TARGET]]
    return [
        *(
            never(NAME, f"{fault}: frames of silent wrong lock", silent_frames(own))
            for fault, own in found.items()
            if fault != WRONG_TARGET
        ),
        at_most(NAME, f"{WRONG_TARGET}: frames in a row called locked", longest, _MAX_WRONG),
    ]


def _table(found: FaultRuns) -> TextTable:
    return table_of(
        "faults",
        found.values(),
        {
            "fault": lambda own: own[0].fault,
            "status": lambda own: status_shares([each.run.said for each in own]),
            "runs": len,
            "position, mm": lambda own: _compared(own, lambda run: 1e3 * run.position_m),
            "attitude, deg": lambda own: _compared(own, lambda run: np.rad2deg(run.attitude_rad)),
            "pose NEES": lambda own: _compared(own, lambda run: run.pose_nees / 6.0, mean),
            "inlier ratio": lambda own: mean(
                _late(own, lambda run: run.said.notes["inlier_ratio"])
            ),
            "silent wrong": silent_frames,
            "in a row": lambda own: max(each.longest_silent for each in own),
        },
        text_columns=2,
    )


def _late(own: Sequence[FaultRun], of: Callable[[JudgedRun], FloatArray]) -> FloatArray:
    """Of the second half of all runs."""
    return np.concatenate([of(each.run)[len(each.run) // 2 :] for each in own])


def _inlier_ratio(run: JudgedRun) -> FloatArray:
    return run.said.notes["inlier_ratio"]


def _middle_and_most(values: FloatArray) -> list[float]:
    return [percentile(values, percent) for percent in (50, 95)]


def _compared(
    own: Sequence[FaultRun],
    of: Callable[[JudgedRun], FloatArray],
    statistic: Callable[[FloatArray], object] = _middle_and_most,
) -> object:
    """What the errors come to; of another satellite there are none."""
    return None if own[0].fault == WRONG_TARGET else statistic(_late(own, of))


def _silent_table(runs: Sequence[FaultRun]) -> TextTable:
    return table_of(
        "silent_wrong",
        runs,
        {
            "fault": lambda each: each.fault,
            "seed": lambda each: each.seed,
            **marked_frames(lambda each: each.silent),
        },
    )


def _boxed(mesh: trimesh.Trimesh, target: Target) -> trimesh.Trimesh:
    T_model_face = _rectangle(target, _BOX_ON).T_model_rect
    x, y = _BOX_OFF_CENTRE_M
    # The box's thin side stands up along the face's normal, which is z of the face's frame.
    height, length, width = _BOX_M
    on_face = make_transform(np.eye(3), np.array([x, y, 0.5 * height]))
    box = trimesh.creation.box((width, length, height), transform=T_model_face @ on_face)
    joined = trimesh.util.concatenate([mesh, box])
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def _rectangle(target: Target, name: str) -> Rectangle:
    return next(rectangle for rectangle in target.rectangles if rectangle.name == name)


def _part_with_corner(mesh: trimesh.Trimesh, p_model: FloatArray) -> BoolArray:
    """(n,) whether each vertex belongs to the closed part that has a corner at a point."""
    labels = trimesh.graph.connected_component_labels(mesh.edges_unique, len(mesh.vertices))
    corner = int(np.argmin(np.linalg.norm(np.asarray(mesh.vertices) - p_model, axis=1)))
    return np.asarray(labels == labels[corner])
