"""Truth against conserved quantities and closed forms."""

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.spatial import exp_rotation, rotation_angle
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.simulation.motion import rotate_torque_free, true_motion

N = 0.0011


def pipeline(**tables: object) -> Pipeline:
    return Pipeline.model_validate(tables)


def test_energy_and_momentum_are_conserved_over_1000_s() -> None:
    inertia = inertia_from_ratios(np.array([0.8, 1.2, 0.05, -0.08, 0.03]))
    omega = np.deg2rad([5.0, -8.0, 4.0])
    R, rates = rotate_torque_free(np.eye(3), omega, inertia, np.arange(0.0, 1000.1, 0.5))
    momentum = np.einsum("nij,nj->ni", R, rates @ inertia)
    energy = np.einsum("ni,ni->n", rates @ inertia, rates)
    # The rate must move for this to say anything.
    assert np.ptp(rates, axis=0).min() > 0.1 * np.linalg.norm(omega)
    scale = np.linalg.norm(momentum[0])
    assert np.abs(momentum - momentum[0]).max() < 1e-9 * scale
    np.testing.assert_allclose(energy, energy[0], rtol=1e-9)
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-14
    )


def test_axisymmetric_body_matches_closed_form() -> None:
    # Axis of symmetry z, moments (1, 1, c): the body rate turns about z at (c - 1) w_z, and the
    # attitude is a turn about the fixed momentum followed by a turn about z.
    c = 1.6
    inertia = np.diag([1.0, 1.0, c])
    omega = np.array([0.05, 0.02, 0.08])
    start = exp_rotation(np.array([0.4, -1.0, 0.3]))
    times_s = np.linspace(0.0, 300.0, 31)
    R, rates = rotate_torque_free(start, omega, inertia, times_s)
    spin = (c - 1.0) * omega[2]
    momentum_world = start @ inertia @ omega
    for t, attitude, rate in zip(times_s, R, rates, strict=True):
        about_z = exp_rotation(np.array([0.0, 0.0, -spin * t]))
        np.testing.assert_allclose(rate, about_z.T @ omega, atol=1e-12)
        expected = exp_rotation(momentum_world * t) @ start @ about_z
        assert rotation_angle(expected.T @ attitude) < 1e-10


def test_spin_about_the_middle_axis_flips_and_others_do_not() -> None:
    inertia = np.diag([1.0, 0.8, 0.6])
    times_s = np.linspace(0.0, 600.0, 1201)
    for axis, flips in ((0, False), (1, True), (2, False)):
        omega = np.full(3, 1e-4)
        omega[axis] = 0.2
        _, rates = rotate_torque_free(np.eye(3), omega, inertia, times_s)
        assert (rates[:, axis].min() < -0.19) == flips


def test_track_joins_orbit_rotation_and_camera() -> None:
    motion = true_motion(
        pipeline(
            scenario={"frames": 5, "frame_rate_hz": 0.1},
            orbit={"mean_motion_rad_s": N, "v_hill_m_s": [0.01, -0.02, 0.03]},
            body={"com_model_m": [0.1, -0.2, 0.3], "omega_body_deg_s": [1.0, 2.0, 3.0]},
        )
    )
    np.testing.assert_array_equal(motion.truth.time_s, [0.0, 10.0, 20.0, 30.0, 40.0])
    start = np.array([25.0, 0.0, 0.0, 0.01, -0.02, 0.03])
    for k in range(len(motion)):
        state = motion.state(k)
        moved = hill_transition(N, 10.0 * k) @ start
        np.testing.assert_allclose([*state.r_hill, *state.v_hill], moved)
        # Boresight +x: image right is +y (minus orbit normal), down is nadir, depth is along-track.
        T = motion.truth.poses[k]
        p_cam_com = T[:3, :3] @ state.com_model + T[:3, 3]
        np.testing.assert_allclose(p_cam_com, state.r_hill[[1, 2, 0]], atol=1e-12)
    # The camera is fixed in the turning Hill frame, so it turns in the world by -n about y.
    R_world_cam = motion.T_cam_world[:, :3, :3].transpose(0, 2, 1)
    turned = exp_rotation(np.array([0.0, -N * 40.0, 0.0]))
    np.testing.assert_allclose(R_world_cam[4], turned @ R_world_cam[0], atol=1e-14)


def test_two_body_truth_differs_from_hill_by_little() -> None:
    tables = {"scenario": {"frames": 2, "frame_rate_hz": 1e-3}}
    orbit = {"mean_motion_rad_s": N, "r_hill_m": [25.0, 3.0, 5.0]}
    hill = true_motion(pipeline(**tables, orbit=orbit)).state(1).r_hill
    two_body = true_motion(pipeline(**tables, orbit={**orbit, "model": "two_body"})).state(1).r_hill
    assert 1e-6 < np.linalg.norm(hill - two_body) < 1e-2


@pytest.mark.parametrize("boresight", [(1, 0, 0), (-1, 2, 0.5), (0, 0, 1), (0, 0, -3), (0, 1, 0)])
def test_camera_axes(boresight: tuple[float, float, float]) -> None:
    R = pipeline(camera={"boresight_hill": boresight}).camera.R_cam_hill
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    forward = np.array(boresight) / np.linalg.norm(boresight)
    np.testing.assert_allclose(R[2], forward, atol=1e-15)
    down = R[1]
    if abs(forward[2]) < 1.0:
        assert down[2] > 0.8
        assert R[0][2] == pytest.approx(0.0)
    else:
        np.testing.assert_allclose(down, [-1.0, 0.0, 0.0], atol=1e-15)


def test_one_frame_is_enough() -> None:
    for model in ("hill", "two_body"):
        motion = true_motion(pipeline(scenario={"frames": 1}, orbit={"model": model}))
        assert len(motion) == 1
        np.testing.assert_array_equal(motion.state(0).r_hill, [25.0, 0.0, 0.0])
