"""Random truths of shipped satellites, and the frames of a simulated sequence in memory."""

from pathlib import Path

import numpy as np
import pytest

from pcnav.core.camera import project
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, rotation_angle, transform_points
from pcnav.dynamics.inertia_parameters import parameters_from_ratios
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.recordings.opening import open_sequence
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import true_motion
from pcnav.simulation.random_truth import Spread, random_truth, satellite

SPREAD = Spread(range_m=(10.0, 30.0), rate_deg_s=(1.0, 5.0), speed_m_s=0.02)


def test_truths_follow_the_prior_of_the_target_and_the_limits() -> None:
    of = satellite("boxsat")
    truths = [random_truth(of, SPREAD, k, frames=2, frame_rate_hz=5.0) for k in range(200)]
    assert truths[3] == random_truth(of, SPREAD, 3, frames=2, frame_rate_hz=5.0)
    com = np.array([truth.body.com_model_m for truth in truths])
    # 200 draws: a mean is known to sd / 14, a deviation to 5 %.
    com_sd, _ = of.target.mass.prior.sd
    assert np.all(np.abs(com.mean(axis=0) - of.target.com_model) < 4.0 * com_sd / 14.0)
    assert com.std(axis=0) == pytest.approx(com_sd, rel=0.2)
    ratios = np.array([truth.body.inertia_ratios for truth in truths])
    assert all(is_physical_inertia(inertia_from_ratios(row)) for row in ratios)
    drawn = np.array([parameters_from_ratios(row) for row in ratios])
    off = drawn - parameters_from_ratios(of.target.inertia_ratios)
    off = off / np.sqrt(np.diag(of.target.mass.parameter_covariance))
    # What no body can have is cut off.
    assert np.abs(off.mean(axis=0)).max() < 0.7 and 0.4 < off.std() < 1.1
    rates = np.linalg.norm([truth.body.omega_body_deg_s for truth in truths], axis=1)
    assert rates.min() >= 1.0 and rates.max() <= 5.0 and rates.mean() == pytest.approx(3.0, abs=0.4)
    speeds = np.linalg.norm([truth.orbit.v_hill_m_s for truth in truths], axis=1)
    assert speeds.max() <= 0.02


def test_attitudes_are_uniform_on_the_rotations() -> None:
    """The mean of a uniform rotation is zero, and its angle has density (1 - cos a) / pi."""
    of = satellite("boxsat")
    attitudes = np.stack(
        [
            exp_rotation(
                np.deg2rad(
                    random_truth(
                        of, SPREAD, k, frames=1, frame_rate_hz=1.0
                    ).body.attitude_rotvec_deg
                )
            )
            for k in range(300)
        ]
    )
    assert np.abs(attitudes.mean(axis=0)).max() < 4.0 * np.sqrt(1.0 / 3.0 / 300.0)
    assert rotation_angle(attitudes).mean() == pytest.approx(np.pi / 2 + 2 / np.pi, abs=0.15)


@pytest.mark.parametrize("name", ["boxsat", "cubesat6u", "twinwing"])
def test_targets_are_in_view(name: str) -> None:
    of = satellite(name)
    factor = of.target.diameter_m / satellite("boxsat").target.diameter_m
    camera = of.pipeline.camera.pinhole
    size = np.array([camera.width, camera.height])
    for seed in range(40):
        truth = random_truth(of, SPREAD.scaled(factor), seed, frames=1, frame_rate_hz=5.0)
        T_cam_model = true_motion(truth).truth.poses[0]
        middle = transform_points(T_cam_model, of.target.mesh.bounds.mean(axis=0)[None])
        assert 10.0 * factor <= middle[0, 2] <= 30.0 * factor
        assert np.all(np.abs(project(camera, middle)[0] - 0.5 * size) < 0.5 * size)
        pixels = project(camera, transform_points(T_cam_model, np.array(of.target.mesh.vertices)))
        # A sphere that fits the smaller side has room to spare only where it is off the axis.
        if of.target.diameter_m * camera.fx / middle[0, 2] < 0.8 * size.min():
            assert np.all(pixels > -0.05 * size) and np.all(pixels < 1.05 * size)
        assert np.any(np.all((pixels > 0) & (pixels < size), axis=1))


def test_an_unknown_satellite_is_refused() -> None:
    with pytest.raises(InputError, match="shipped by this name"):
        satellite("sputnik")


def test_frames_in_memory_are_those_of_a_recording(tmp_path: Path) -> None:
    of = satellite("boxsat")
    truth = random_truth(of, SPREAD, 11, frames=3, frame_rate_hz=5.0)
    Scene.showing(of.target, truth).write(tmp_path / "sequence")
    recorded = open_sequence(tmp_path / "sequence")
    scene = Scene.of(truth, of.target.mesh)
    assert scene.info.range_sigma_m == recorded.info.range_sigma_m
    for ours, stored in zip(scene.frames(), recorded, strict=True):
        np.testing.assert_allclose(ours.depth_m, stored.depth_m, atol=1e-5)
        np.testing.assert_allclose(ours.T_cam_world, stored.T_cam_world, atol=1e-12)
        assert ours.time_s == stored.time_s and np.any(ours.depth_m)
    dark = [np.any(frame.depth_m) for frame in scene.frames(blind=range(1, 2))]
    assert dark == [True, False, True]
