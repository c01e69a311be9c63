"""Targets that turn by large angles between frames; their motion is scipy's."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pcnav.config.depth import FilterTable, PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform, rotation_angle
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.estimators.depth.fast_turns import slowest
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.runs.status import Status
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

SIGMA_M, STEP_S, DISTANCE_M = 0.02, 0.5, 18.0
CAMERA = PinholeCamera.from_field_of_view(160, 160, np.deg2rad(25.0))
AXIS = np.array([0.8, -0.35, 0.5]) / np.linalg.norm([0.8, -0.35, 0.5])
FIRST = Rotation.from_rotvec([0.4, 0.7, -0.5])


def attitudes(target: Target, turn_deg: float, frames: int) -> list[FloatArray]:
    """R_cam_model (3, 3) of a body whose first rate turns it by so much a frame, if it lasted."""
    inertia = inertia_from_ratios(target.inertia_ratios * np.array([1.06, 0.95, 1.0, 1.0, 1.0]))

    def slope(_: float, y: FloatArray) -> FloatArray:
        q, rate = y[:4], y[4:]
        vector, scalar = q[:3], q[3]
        turned = 0.5 * np.append(scalar * rate + np.cross(vector, rate), -vector @ rate)
        spin = np.linalg.solve(inertia, -np.cross(rate, inertia @ rate))
        return np.concatenate([turned, spin])

    begin = np.concatenate([FIRST.as_quat(), np.deg2rad(turn_deg) / STEP_S * AXIS])
    times = STEP_S * np.arange(frames)
    found = solve_ivp(slope, (0.0, times[-1]), begin, t_eval=times, rtol=1e-10, atol=1e-10)
    return [Rotation.from_quat(q).as_matrix() for q in found.y[:4].T]


def frames_of(target: Target, turned: list[FloatArray]) -> list[Frame]:
    renderer, rng = DepthRenderer(target.mesh, CAMERA), np.random.default_rng(8)
    frames = []
    for k, R in enumerate(turned):
        # It turns about its mass centre, which stays where it is.
        place = np.array([0.1, -0.1, DISTANCE_M]) - R @ target.com_model
        depth_m = renderer.render(make_transform(R, place)).depth_m
        noisy = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
        depth_m = np.where(depth_m > 0.0, noisy, 0.0).astype(np.float32)
        frames.append(Frame(k, STEP_S * k, depth_m, CAMERA, np.eye(4)))
    return frames


@pytest.mark.parametrize("turn_deg", [40.0, 90.0, 150.0])
def test_a_fast_tumble_is_started_by_the_frames_that_decide_it(
    boxsat: Target, turn_deg: float
) -> None:
    turned = attitudes(boxsat, turn_deg, 6)
    info = SequenceInfo("boxsat", 0.0, SIGMA_M, None, calibration=EXACT)
    tracker = Tracker(boxsat, info, PerceptionTable(), FilterTable(), seed=0)
    estimates = [tracker.step(frame) for frame in frames_of(boxsat, turned)]
    claimed = [k for k, each in enumerate(estimates) if each.status == Status.LOCKED]
    assert claimed and 3 <= claimed[0] <= 4
    for k in claimed:
        pose = estimates[k].T_cam_target
        assert pose is not None
        assert np.rad2deg(rotation_angle(pose[:3, :3].T @ turned[k])) < 0.2


def test_a_rate_is_taken_if_it_is_clearly_the_slowest() -> None:
    assert slowest([(3.0, "fast"), (1.0, "slow")]) == "slow"
    assert slowest([(1.5, "one"), (1.0, "other")]) is None
    assert slowest([]) is None
