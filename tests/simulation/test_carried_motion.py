"""Motions that are not free, against numerical derivatives and closed forms."""

from typing import Any

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation, rotation_angle
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY
from pcnav.simulation.motion import TrueMotion, true_motion

RATE_HZ = 200.0
OMEGA_DEG_S = (3.0, 5.0, -4.0)


def motion(kind: str, seconds: float = 6.0, **tables: Any) -> TrueMotion:
    """A motion in a laboratory, sampled so finely that differences stand for derivatives."""
    body = {"omega_body_deg_s": OMEGA_DEG_S, "inertia_ratios": (0.7, 0.5, 0.02, 0.0, 0.0)}
    found = {
        "seed": 5,
        "scenario": {"frames": int(seconds * RATE_HZ) + 1, "frame_rate_hz": RATE_HZ},
        "body": body | tables.pop("body", {}),
        "motion": {"kind": kind, "extent_m": 0.3, **tables},
    }
    return true_motion(Pipeline.model_validate(found))


def rates(R: FloatArray, step_s: float) -> FloatArray:
    """(n - 2, 3) body rates by central differences."""
    return np.asarray(log_rotation(np.swapaxes(R[:-2], 1, 2) @ R[2:]) / (2.0 * step_s))


@pytest.mark.parametrize("kind", ["free", "spin", "sway", "path", "hand"])
def test_velocity_and_rate_are_those_of_the_pose(kind: str) -> None:
    truth = motion(kind).truth
    step = 1.0 / RATE_HZ
    velocity = (truth[POSITION][2:] - truth[POSITION][:-2]) / (2.0 * step)
    np.testing.assert_allclose(velocity, truth[VELOCITY][1:-1], atol=2e-4)
    np.testing.assert_allclose(rates(truth[ATTITUDE], step), truth[RATE][1:-1], atol=5e-4)
    if kind not in ("free", "spin"):
        # They move, and begin where the pipeline says.
        assert np.ptp(truth[POSITION], axis=0).max() > 0.05
        assert rotation_angle(truth[ATTITUDE]).max() > np.deg2rad(5.0)
        np.testing.assert_allclose(truth[POSITION][0], [25.0, 0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(truth[ATTITUDE][0], np.eye(3), atol=1e-12)


def test_a_spin_keeps_its_rate_where_a_free_body_does_not() -> None:
    spin, free = motion("spin", 30.0).truth, motion("free", 30.0).truth
    assert np.ptp(free[RATE], axis=0).max() > 0.01
    np.testing.assert_allclose(spin[RATE], np.tile(np.deg2rad(OMEGA_DEG_S), (len(spin), 1)))
    turned = exp_rotation(30.0 * np.deg2rad(OMEGA_DEG_S))
    np.testing.assert_allclose(spin[ATTITUDE][-1], turned, atol=1e-10)


def test_a_path_rests_in_every_pose_and_stays_within_its_extent() -> None:
    found = motion("path", 20.0, leg_s=4.0, extent_deg=25.0).truth
    for k in range(6):
        np.testing.assert_allclose(found[VELOCITY][int(k * 4 * RATE_HZ)], 0.0, atol=1e-12)
        np.testing.assert_allclose(found[RATE][int(k * 4 * RATE_HZ)], 0.0, atol=1e-12)
    assert np.abs(found[POSITION] - [25.0, 0.0, 0.0]).max() <= 0.3
    assert np.abs(log_rotation(found[ATTITUDE])).max() <= np.deg2rad(25.0) + 1e-12


def test_a_hand_has_the_accelerations_and_the_band_that_are_asked_for() -> None:
    found = motion("hand", 120.0, acceleration_m_s2=0.6, band_hz=(0.5, 3.0)).truth
    acceleration = np.diff(found[VELOCITY], axis=0) * RATE_HZ
    assert acceleration.std() == pytest.approx(0.6, rel=0.05)
    power = np.square(np.abs(np.fft.rfft(acceleration, axis=0))).sum(axis=1)
    frequency = np.fft.rfftfreq(len(acceleration), 1.0 / RATE_HZ)
    inside = (frequency > 0.45) & (frequency < 3.05)
    assert power[inside].sum() > 0.98 * power.sum()


@pytest.mark.parametrize("at_s", [0.0, 2.0, 2.00123])
def test_an_impulse_changes_velocity_and_rate_but_not_the_pose(at_s: float) -> None:
    dv, dw = (0.1, -0.2, 0.3), (20.0, -10.0, 5.0)
    told = motion("impulse", at_s=at_s, impulse_v_m_s=dv, impulse_omega_deg_s=dw).truth
    free = motion("free").truth
    before = told.time_s <= at_s
    for block in (POSITION, VELOCITY, ATTITUDE, RATE):
        np.testing.assert_allclose(told[block][before], free[block][before], atol=1e-10)
    after = int(np.argmin(before))
    since = told.time_s[after] - at_s
    np.testing.assert_allclose(
        told[POSITION][after:] - free[POSITION][after:],
        (told.time_s[after:] - at_s)[:, None] * np.array(dv),
        atol=1e-10,
    )
    change = told[RATE][after] - free[RATE][after]
    np.testing.assert_allclose(change, np.deg2rad(dw), atol=0.2 * since + 1e-9)
    angle = rotation_angle(free[ATTITUDE][after].T @ told[ATTITUDE][after])
    assert angle == pytest.approx(since * np.linalg.norm(np.deg2rad(dw)), rel=0.02)


def test_a_torque_accelerates_a_ball_evenly() -> None:
    body = {"inertia_ratios": (1.0, 1.0, 0.0, 0.0, 0.0)}
    found = motion("torque", at_s=1.5, torque_deg_s2=(1.0, 2.0, -3.0), body=body).truth
    since = np.maximum(found.time_s - 1.5, 0.0)[:, None]
    expected = np.deg2rad(np.array(OMEGA_DEG_S) + since * [1.0, 2.0, -3.0])
    np.testing.assert_allclose(found[RATE], expected, atol=1e-10)


def test_a_torque_changes_the_angular_momentum_by_its_integral() -> None:
    found = motion("torque", at_s=0.0, torque_deg_s2=(0.5, -1.0, 2.0)).truth
    inertia = np.array([[1.0, 0.02, 0.0], [0.02, 0.7, 0.0], [0.0, 0.0, 0.5]])
    torque = inertia @ np.deg2rad([0.5, -1.0, 2.0])
    momentum = np.einsum("nij,nj->ni", found[ATTITUDE], found[RATE] @ inertia)
    torque_world = found[ATTITUDE] @ torque
    steps = 0.5 * (torque_world[1:] + torque_world[:-1]) / RATE_HZ
    np.testing.assert_allclose(momentum[-1] - momentum[0], steps.sum(axis=0), rtol=1e-4)


def test_a_carried_camera_sees_a_free_target_move_as_a_hand_does() -> None:
    told, free = motion("hand", mover="camera"), motion("free")
    np.testing.assert_array_equal(told.truth[ATTITUDE], free.truth[ATTITUDE])
    np.testing.assert_array_equal(told.T_cam_world[0], free.T_cam_world[0])
    assert np.ptp(told.T_cam_world[:, :3, 3], axis=0).min() > 0.01
    # What the frames show is the free body through the camera's own pose.
    for k in (0, 400, 1200):
        state = told.state(k)
        p_cam = told.T_cam_world[k] @ [*state.r_hill, 1.0]
        T = told.truth.poses[k]
        np.testing.assert_allclose(T[:3, :3] @ state.com_model + T[:3, 3], p_cam[:3], atol=1e-12)
    # It looks at the target from wherever it is: the target stays before it.
    middle = told.truth.poses[:, :2, 3] / told.truth.poses[:, 2:3, 3]
    assert np.abs(middle).max() < 0.05


def test_more_frames_show_the_same_motion() -> None:
    for kind in ("sway", "path", "hand"):
        short, long = motion(kind, 3.0).truth, motion(kind, 9.0).truth
        np.testing.assert_array_equal(short[POSITION], long[POSITION][: len(short)])
