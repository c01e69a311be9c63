"""Noisy camera poses: what they make of a measurement, shared by all faces of a frame."""

from typing import Any

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform, rotation_angle
from pcnav.dynamics.state import STATE_SIZE, NavigationState
from pcnav.estimators.depth.camera_noise import CameraNoise
from pcnav.estimators.depth.mass_centre import RectangleMeasurement
from pcnav.estimators.depth.measuring import predicted_pose
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    PoseReference,
    joined,
    moved_pose,
    pose_error,
    seen_pose,
)
from pcnav.estimators.depth.tracker import Tracker
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.runs.status import Status
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target

NOISE = CameraNoise(1e-3, 1e-3)
LEVER_M = 1.5
FOLLOWED = (Status.LOCKED, Status.AMBIGUOUS)


def camera_moved(T_cam_world: FloatArray, unit: FloatArray, noise: CameraNoise) -> FloatArray:
    """Where a camera recorded at T_cam_world (4, 4) is, whose pose errs by so many deviations."""
    shift, turn = noise.position_sd_m * unit[:3], noise.attitude_sd_rad * unit[3:]
    # Its axes turn by `turn` and its place moves by `shift`, in its own axes.
    T_moved_cam = make_transform(exp_rotation(turn).T, -exp_rotation(turn).T @ shift)
    return np.asarray(T_moved_cam @ T_cam_world)


def test_by_unit_is_the_derivative_by_the_camera(observer: ObserverPose) -> None:
    T_world_model = make_transform(exp_rotation(np.array([0.3, 0.5, -0.2])), np.array([1, 2, 25.0]))
    T_cam_model = observer.T_cam_world @ T_world_model
    small = CameraNoise(1e-6, 2e-6)
    made = small.by_unit(T_cam_model)
    for k, unit in enumerate(np.eye(6)):
        seen = camera_moved(observer.T_cam_world, unit, small) @ T_world_model
        np.testing.assert_allclose(made[:, k], pose_error(T_cam_model, seen), atol=2e-10)


def draw(
    state: NavigationState, observer: ObserverPose, rng: np.random.Generator
) -> tuple[ErrorStateFilter[NavigationState], NavigationState, list[PoseMeasurement], FloatArray]:
    """A filter, the truth it errs from, four faces of a frame, and the pose in the camera."""
    sd = np.full(STATE_SIZE, 1e-9)
    sd[:3], sd[9:12] = 3e-3, 1e-3
    kalman = ErrorStateFilter(state, np.diag(sd**2), gate_probability=1.0 - 1e-12)
    true = state.retract(sd * rng.standard_normal(STATE_SIZE))
    T_cam_world = camera_moved(observer.T_cam_world, rng.standard_normal(6), observer.noise)
    seen = true.T_cam_model(T_cam_world, observer.R_hill_world)
    reference = PoseReference(predicted_pose(kalman, observer)[0], observer)
    faces = []
    for _ in range(4):
        # A face shows its distance and two tilts.
        rows = rng.standard_normal((3, 6)) / np.r_[np.full(3, 3e-4), np.full(3, 2e-4)]
        value = rows @ pose_error(reference.T_cam_model, seen) + rng.standard_normal(3)
        information, vector = rows.T @ rows, rows.T @ value
        faces.append(PoseMeasurement.from_information(reference, information, vector, LEVER_M))
    return kalman, true, faces, seen


def test_faces_of_a_frame_err_in_common(state: NavigationState, observer: ObserverPose) -> None:
    noisy = ObserverPose(observer.T_cam_world, observer.R_hill_world, NOISE)
    rng = np.random.default_rng(0)
    nees, nis, in_camera, by_world, condensed = [], [], [], [], []
    pose = np.r_[0:3, 9:12]
    for _ in range(150):
        kalman, true, faces, seen = draw(state, noisy, rng)
        before, predicted = kalman.snapshot(), predicted_pose(kalman, noisy)
        nis += [kalman.innovation(face)[0] / 3.0 for face in faces]
        result = kalman.update(faces, [face.shared for face in faces if face.shared is not None])
        assert all(result.accepted)
        error = kalman.state.local(true)[pose]
        P = kalman.covariance[np.ix_(pose, pose)]
        nees.append(error @ np.linalg.solve(P, error) / 6.0)
        estimate, covariance = seen_pose(predicted, faces)
        error = pose_error(estimate, seen)
        in_camera.append(error @ np.linalg.solve(covariance, error) / 6.0)
        by_world.append(
            np.linalg.norm(pose_error(predicted_pose(kalman, noisy)[0], seen)[:3])
            / np.linalg.norm(error[:3])
        )
        # One measurement of them all is the same.
        state_after = kalman.state
        kalman.restore(before)
        kalman.update([joined(faces)])
        condensed.append(np.abs(kalman.state.local(state_after)[pose] / np.sqrt(np.diag(P))).max())
    # 900 degrees of freedom: 0.05 is one deviation; of single faces less, as they are correlated.
    assert 0.85 < np.mean(nees) < 1.15
    assert 0.85 < np.mean(in_camera) < 1.15
    assert 0.85 < np.mean(nis) < 1.15
    # The camera knows far better where the target is than the world does.
    assert np.median(by_world) > 10.0
    assert np.max(condensed) < 0.05


def test_an_exact_camera_measures_as_before(state: NavigationState, observer: ObserverPose) -> None:
    _, _, faces, _ = draw(state, observer, np.random.default_rng(1))
    assert all(face.shared is None for face in faces)
    np.testing.assert_array_equal(faces[0].covariance, np.eye(3))
    np.testing.assert_array_equal(faces[0].in_camera.rows, faces[0].rows)
    moved = moved_pose(faces[0].reference.T_cam_model, np.zeros(6))
    np.testing.assert_array_equal(moved, faces[0].reference.T_cam_model)


@pytest.mark.study
@pytest.mark.parametrize("camera", [(0.0, 0.01), (0.001, 0.05), (0.005, 0.2)], ids=str)
def test_a_target_is_followed_through_noisy_camera_poses(
    boxsat: Target, camera: tuple[float, float]
) -> None:
    settings: dict[str, Any] = {
        "seed": 4,
        "scenario": {"frames": 20, "frame_rate_hz": 2.0},
        "orbit": {"r_hill_m": [20.0, 0.3, 0.4], "v_hill_m_s": [0.004, 0.0, 0.003]},
        "body": {
            "attitude_rotvec_deg": [25.0, 40.0, -30.0],
            "omega_body_deg_s": [2.0, -1.4, 2.5],
            "com_model_m": [0.10, 0.12, -0.13],
            "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
        },
        "camera": {
            "horizontal_fov_deg": 20.0,
            "position_sd_m": camera[0],
            "attitude_sd_deg": camera[1],
        },
        "noise": {"range_sigma_m": 0.02},
    }
    pipeline = Pipeline.model_validate(settings)
    scene = Scene.showing(boxsat, pipeline)
    tracker = Tracker(boxsat, scene.info, pipeline.perception, pipeline.filter, 4)
    position, turn = [], []
    for k, frame in enumerate(scene):
        estimate = tracker.step(frame)
        if k < 4:
            continue
        assert estimate.status in FOLLOWED, k
        assert estimate.T_cam_target is not None
        true = scene.truth.poses[k]
        position.append(np.linalg.norm(estimate.T_cam_target[:3, 3] - true[:3, 3]))
        turn.append(float(rotation_angle(estimate.T_cam_target[:3, :3].T @ true[:3, :3])))
    # Whatever the camera's pose errs by: at 0.2 deg that is 70 mm.
    assert np.median(position) < 1.5e-3
    assert np.degrees(np.median(turn)) < 0.05


def test_rectangles_err_by_the_camera_in_common(
    state: NavigationState, observer: ObserverPose
) -> None:
    small = CameraNoise(1e-6, 2e-6)
    T_model_rect = make_transform(exp_rotation(np.array([0.2, -0.4, 0.1])), np.array([0.5, 0.3, 1]))
    T_cam_hill = observer.T_cam_world @ make_transform(observer.R_hill_world.T, np.zeros(3))
    T_world_rect = state.T_cam_model(np.eye(4), observer.R_hill_world) @ T_model_rect
    known = np.array([True, True, True, True, True, False])

    def measured(T_cam_world: FloatArray) -> RectangleMeasurement:
        T_cam_rect = T_cam_world @ T_world_rect
        arguments = (T_model_rect, T_cam_rect, known, 1e-12 * np.eye(6), T_cam_hill)
        return RectangleMeasurement(*arguments, observer.R_hill_world, small)

    exact = measured(observer.T_cam_world)
    np.testing.assert_allclose(exact.residual(state), 0.0, atol=1e-12)
    for k, unit in enumerate(np.eye(6)):
        seen = measured(camera_moved(observer.T_cam_world, unit, small))
        np.testing.assert_allclose(exact.shared[:, k], seen.residual(state), atol=2e-10)
    expected = 1e-12 * np.eye(5) + exact.shared @ exact.shared.T
    np.testing.assert_allclose(exact.covariance, expected)
