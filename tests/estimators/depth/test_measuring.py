"""Updates of the filter with rendered frames, against the state they were rendered at."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY, NavigationState
from pcnav.estimators.depth.initial_arc import condensed
from pcnav.estimators.depth.measuring import FrameUpdate, Kalman, pose_of
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    moved_pose,
    pose_covariance,
    pose_error,
)
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.filtering.map_arc_fit import TimedMeasurements
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Target

Shoot = Callable[..., Frame]


@pytest.fixture(scope="module")
def reader(boxsat: Target) -> FrameReader:
    return FrameReader(boxsat, PerceptionTable(), 0.02, 0)


def covariance(shift_m: float, turn_rad: float) -> FloatArray:
    """(20, 20) with a pose that is so uncertain and the rest nearly known."""
    P = np.diag(np.full(STATE_SIZE, 1e-12))
    P[R_HILL, R_HILL] = shift_m**2 * np.eye(3)
    P[THETA_BODY, THETA_BODY] = turn_rad**2 * np.eye(3)
    return P


def predicted(state: NavigationState, P: FloatArray, rng: np.random.Generator) -> Kalman:
    """A filter whose error is drawn from its covariance."""
    return ErrorStateFilter(state.retract(np.sqrt(np.diag(P)) * rng.normal(size=STATE_SIZE)), P)


def squared_pose_error(kalman: Kalman, truth: FloatArray, observer: ObserverPose) -> float:
    error = pose_error(pose_of(kalman, observer), truth)
    P = pose_covariance(kalman.state, kalman.covariance, observer)
    return float(error @ np.linalg.solve(P, error))


@pytest.mark.parametrize(
    ("shift_m", "turn_rad"), [(0.003, 5e-4), (0.1, 0.02)], ids=["sharp", "blurred"]
)
def test_updates_are_as_good_as_they_say(
    state: NavigationState,
    observer: ObserverPose,
    shoot: Shoot,
    reader: FrameReader,
    shift_m: float,
    turn_rad: float,
) -> None:
    truth = pose_of(ErrorStateFilter(state, np.eye(STATE_SIZE)), observer)
    P = covariance(shift_m, turn_rad)
    rng = np.random.default_rng(0)
    errors = []
    for k in range(8):
        kalman = predicted(state, P, rng)
        updated = FrameUpdate(reader, shoot(truth, k), kalman, observer).by_comparison()
        assert updated.is_good
        assert updated.view.inlier_ratio > 0.9
        errors.append(squared_pose_error(kalman, truth, observer))
    assert chi2.ppf(1e-4, 6 * 8) < sum(errors) < chi2.isf(1e-4, 6 * 8), errors


def test_a_frame_that_is_not_explained_leaves_the_prediction(
    state: NavigationState, observer: ObserverPose, shoot: Shoot, reader: FrameReader
) -> None:
    kalman = ErrorStateFilter(state, covariance(0.003, 5e-4))
    before = kalman.snapshot()
    turned = pose_of(kalman, observer)
    turned[:3, :3] = turned[:3, :3] @ exp_rotation(np.array([0.9, 1.2, -0.7]))
    frame = shoot(turned)
    empty = replace(frame, depth_m=np.zeros_like(frame.depth_m))
    for strange in (frame, empty):
        updated = FrameUpdate(reader, strange, kalman, observer).by_comparison()
        assert not updated.is_good
        assert updated.result is None
        assert [*updated.view.measurements, *updated.view.records] == []
        assert {record.outcome for record in updated.view.unused} <= {"frame not explained"}
        assert kalman.state is before.state
        np.testing.assert_array_equal(kalman.covariance, before.covariance)


def test_a_pose_to_start_from_helps_a_prediction_that_is_far_off(
    state: NavigationState, observer: ObserverPose, shoot: Shoot, reader: FrameReader
) -> None:
    P = covariance(2.0, 0.3)
    truth = pose_of(ErrorStateFilter(state, P), observer)
    error = np.zeros(STATE_SIZE)
    error[R_HILL], error[THETA_BODY] = [1.5, -1.0, 2.0], [0.3, -0.2, 0.25]
    kalman = ErrorStateFilter(state.retract(error), P)
    off = moved_pose(truth, np.array([0.02, -0.01, 0.02, 0.003, 0.002, -0.003]))
    start = (off, np.diag(np.repeat([0.02, 3e-3], 3) ** 2))
    updated = FrameUpdate(reader, shoot(truth), kalman, observer, start).by_comparison()
    assert updated.is_good
    assert squared_pose_error(kalman, truth, observer) < chi2.isf(1e-4, 6)


def test_faces_of_an_arc_are_condensed_into_one_measurement(
    state: NavigationState, observer: ObserverPose, shoot: Shoot, reader: FrameReader
) -> None:
    kalman = ErrorStateFilter(state, covariance(0.003, 5e-4))
    view = (
        FrameUpdate(reader, shoot(pose_of(kalman, observer)), kalman, observer).by_comparison().view
    )
    assert len(view.measurements) >= 3
    timed = condensed(TimedMeasurements(600.0, view.measurements))
    (one,) = timed.measurements
    assert timed.time_s == 600.0
    assert isinstance(one, PoseMeasurement)
    faces = [m for m in view.measurements if isinstance(m, PoseMeasurement)]
    information = sum(face.rows.T @ face.rows for face in faces)
    scale = np.abs(information).max()
    np.testing.assert_allclose(one.rows.T @ one.rows / scale, information / scale, atol=1e-12)
    nothing: TimedMeasurements[NavigationState] = TimedMeasurements(1.0, ())
    assert condensed(nothing) is nothing
