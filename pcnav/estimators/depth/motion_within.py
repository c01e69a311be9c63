"""How a target moves in the camera while a frame is taken, to second order in time."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    moved_pose,
    pose_error,
    pose_rate,
)
from pcnav.filtering.error_state import MotionModel
from pcnav.target.row_motion import Readout

TimedPose = tuple[float, FloatArray]
"""Time, s, and T_cam_model (4, 4)."""


def motion_about(poses: Sequence[TimedPose], k: int) -> Readout | None:
    """Through the poses of some frames, about the k-th: a parabola through three, a line through
    two; None of a single one."""
    beside = sorted((j for j in range(len(poses)) if j != k), key=lambda j: abs(j - k))[:2]
    if not beside:
        return None
    steps = np.array([poses[j][0] - poses[k][0] for j in beside])
    moved = np.stack([pose_error(poses[k][1], poses[j][1]) for j in beside])
    return _through(steps, moved)


def _through(steps_s: FloatArray, moved: FloatArray) -> Readout:
    """The motion through displacements (m, 6) after times (m,), m = 1 or 2."""
    rates = np.linalg.solve(steps_s[:, None] ** np.arange(1, len(steps_s) + 1), moved)
    return Readout(rates[0], rates[1] if len(rates) > 1 else None)


def predicted_motion(
    state: NavigationState,
    time_s: float,
    model: MotionModel[NavigationState],
    observer: ObserverPose,
    camera_before: TimedPose | None,
    half_s: float,
    mean_motion_rad_s: float,
) -> Readout:
    """Of a state at a time, so far back and ahead.

    ``camera_before`` is where the camera was in the frame before (T_cam_world): it moves on as it
    did.
    """
    here = state.T_cam_model(observer.T_cam_world, observer.R_hill_world)
    by_camera = np.zeros(6)
    if camera_before is not None:
        before_s, T_before = camera_before
        by_camera = pose_error(T_before, observer.T_cam_world) / (time_s - before_s)
    moved = []
    for step_s in (-half_s, half_s):
        then = model.propagate(state, time_s, step_s)[0]
        T_cam_world = moved_pose(observer.T_cam_world, step_s * by_camera)
        # The orbit turns evenly: as far from time 0 on as from any other.
        turn = R_hill_world(step_s, mean_motion_rad_s)
        moved.append(pose_error(here, then.T_cam_model(T_cam_world, turn @ observer.R_hill_world)))
    within = _through(np.array([-half_s, half_s]), np.stack(moved))
    return replace(within, own=pose_rate(state, observer))
