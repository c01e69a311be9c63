"""What a rendered view says of the state, against numerical derivatives and information filters."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.state import OMEGA_BODY, R_HILL, STATE_SIZE, NavigationState
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    PoseReference,
    joined,
    moved_pose,
    pose_covariance,
    pose_error,
    pose_jacobian,
    pose_rate,
    pose_rate_jacobian,
    square_root,
)
from pcnav.filtering.error_state import ErrorStateFilter

LEVER_M = 4.0
SIGHT = ObserverPose.of(
    make_transform(exp_rotation(np.array([0.2, -0.5, 0.9])), np.array([0.3, -0.1, 0.4])),
    700.0,
    1e-3,
)


def random_state(rng: np.random.Generator) -> NavigationState:
    return NavigationState(
        r_hill=rng.normal(0.0, 10.0, 3),
        v_hill=rng.normal(0.0, 0.01, 3),
        com_model=rng.normal(0.0, 0.5, 3),
        R_world_body=exp_rotation(rng.normal(size=3)),
        omega_body=rng.normal(0.0, 0.1, 3),
        inertia_ratios=np.array([0.8, 0.9, 0.02, -0.03, 0.01]),
    )


def pose_of(state: NavigationState) -> FloatArray:
    return state.T_cam_model(SIGHT.T_cam_world, SIGHT.R_hill_world)


def random_information(rng: np.random.Generator, rank: int = 6, scale: float = 1e4) -> FloatArray:
    """(6, 6) of shifts and turns, comparable at the lever."""
    rows = rng.normal(size=(rank, 6)) * [1.0, 1.0, 1.0, LEVER_M, LEVER_M, LEVER_M]
    return np.asarray(scale * rows.T @ rows)


def measurement(
    rng: np.random.Generator, T: FloatArray, rank: int, error: FloatArray | None = None
) -> PoseMeasurement:
    """Of a face compared with the view from T, where the pose is off by an error (6,)."""
    information = random_information(rng, rank)
    error = rng.normal(0.0, 0.02, 6) if error is None else error
    reference = PoseReference(T, SIGHT)
    return PoseMeasurement.from_information(reference, information, information @ error, LEVER_M)


# Poses and their errors.

components = st.lists(st.floats(-1.5, 1.5), min_size=6, max_size=6).map(np.array)


@given(components, components)
def test_moving_a_pose_is_the_inverse_of_its_error(start: FloatArray, error: FloatArray) -> None:
    T = make_transform(exp_rotation(start[3:]), start[:3])
    moved = moved_pose(T, error)
    np.testing.assert_allclose(pose_error(T, moved), error, atol=1e-12)
    # By its definition: shifted in camera axes, turned in its own.
    np.testing.assert_allclose(moved[:3, 3] - T[:3, 3], error[:3], atol=1e-14)
    np.testing.assert_allclose(moved[:3, :3], T[:3, :3] @ exp_rotation(error[3:]), atol=1e-14)
    np.testing.assert_allclose(moved_pose(T, pose_error(T, moved)), moved, atol=1e-12)


def test_moving_a_pose_leaves_it_as_it_is() -> None:
    T = make_transform(np.eye(3), np.ones(3))
    moved_pose(T, np.ones(6))
    np.testing.assert_array_equal(T, make_transform(np.eye(3), np.ones(3)))


def numerical(residual, state: NavigationState, size: int) -> FloatArray:
    """(size, 20) derivative of a function of the state by its error."""
    columns = [
        (residual(state.retract(step)) - residual(state.retract(-step))) / 2e-5
        for step in 1e-5 * np.eye(STATE_SIZE)
    ]
    assert len(columns[0]) == size
    return np.column_stack(columns)


@pytest.mark.parametrize("seed", range(4))
def test_pose_jacobian_is_the_numerical_derivative(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    pose = pose_of(state)
    expected = numerical(lambda s: pose_error(pose, pose_of(s)), state, 6)
    np.testing.assert_allclose(pose_jacobian(state, SIGHT), expected, atol=1e-8)
    P = np.diag(rng.uniform(0.1, 1.0, STATE_SIZE) ** 2)
    np.testing.assert_allclose(
        pose_covariance(state, P, SIGHT), expected @ P @ expected.T, atol=1e-6
    )


@pytest.mark.parametrize("off", [1e-6, 0.05, 0.8])
@pytest.mark.parametrize("seed", range(3))
def test_measurement_jacobian_is_the_numerical_derivative(seed: int, off: float) -> None:
    # However far the state has moved from the pose that the frame was compared with.
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    T = moved_pose(pose_of(state), off * rng.normal(size=6))
    measured = measurement(rng, T, 4)
    scale = np.abs(measured.rows).max()
    expected = numerical(measured.residual, state, 4)
    np.testing.assert_allclose(-measured.jacobian(state) / scale, expected / scale, atol=1e-8)
    assert measured.covariance.shape == (4, 4)
    np.testing.assert_array_equal(measured.covariance, np.eye(4))


@pytest.mark.parametrize("seed", range(4))
def test_the_jacobian_of_the_rate_is_the_numerical_derivative(seed: int) -> None:
    state = random_state(np.random.default_rng(seed))
    expected = numerical(lambda s: pose_rate(s, SIGHT), state, 6)
    np.testing.assert_allclose(pose_rate_jacobian(state, SIGHT), expected, atol=1e-9)


def timed_measurement(rng: np.random.Generator, state: NavigationState) -> PoseMeasurement:
    """Of a frame that takes time, compared under another rate than the state's."""
    T = moved_pose(pose_of(state), rng.normal(0.0, 0.02, 6))
    information = random_information(rng)
    by_rate = 0.3 * information @ rng.normal(size=(6, 6))
    rate = pose_rate(state, SIGHT) + rng.normal(0.0, 0.05, 6)
    reference = PoseReference(T, SIGHT, rate)
    vector = information @ rng.normal(0.0, 0.02, 6)
    return PoseMeasurement.from_information(reference, information, vector, LEVER_M, by_rate)


@pytest.mark.parametrize("seed", range(3))
def test_a_frame_that_takes_time_depends_on_the_rate(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    measured = timed_measurement(rng, state)
    scale = np.abs(measured.rows).max()
    expected = numerical(measured.residual, state, 6)
    np.testing.assert_allclose(-measured.jacobian(state) / scale, expected / scale, atol=1e-8)
    # Any part of the rate counts.
    assert np.abs(measured.jacobian(state)[:, OMEGA_BODY]).max() > 0.01 * scale


def test_joined_faces_of_a_frame_that_takes_time_say_the_same() -> None:
    rng = np.random.default_rng(5)
    state = random_state(rng)
    first = timed_measurement(rng, state)
    faces = [first]
    for _ in range(3):
        other = timed_measurement(rng, state)
        faces.append(replace(other, reference=first.reference, value=rng.normal(size=6)))
    one = joined(faces)
    assert one.by_rate is not None and one.rows.shape == one.by_rate.shape == (12, 6)
    # The same normal equations, about any state.
    elsewhere = state.retract(rng.normal(0.0, 0.01, STATE_SIZE))
    H = np.vstack([face.jacobian(elsewhere) for face in faces])
    r = np.concatenate([face.residual(elsewhere) for face in faces])
    scale = np.abs(H).max()
    np.testing.assert_allclose(
        one.jacobian(elsewhere).T @ one.jacobian(elsewhere) / scale**2,
        H.T @ H / scale**2,
        atol=1e-12,
    )
    np.testing.assert_allclose(
        one.jacobian(elsewhere).T @ one.residual(elsewhere) / scale**2,
        H.T @ r / scale**2,
        atol=1e-10,
    )


def test_residual_is_that_of_the_pose_in_standard_deviations() -> None:
    rng = np.random.default_rng(0)
    state = random_state(rng)
    truth = pose_of(state)
    error = rng.normal(0.0, 0.1, 6)
    measured = measurement(
        rng, moved_pose(truth, error), 6, pose_error(moved_pose(truth, error), truth)
    )
    # Each is a difference of numbers of the size of the rows.
    np.testing.assert_allclose(
        measured.residual(state), 0.0, atol=1e-9 * np.abs(measured.value).max()
    )
    other = random_state(rng)
    expected = measured.value - measured.rows @ pose_error(
        measured.reference.T_cam_model, pose_of(other)
    )
    np.testing.assert_allclose(measured.residual(other), expected)
    # What was computed for one state is not taken for another.
    np.testing.assert_allclose(
        measured.residual(state), 0.0, atol=1e-9 * np.abs(measured.value).max()
    )


# Square roots of information.


@pytest.mark.parametrize("rank", range(7))
@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e10])
def test_square_root_holds_all_the_information(rank: int, scale: float) -> None:
    rng = np.random.default_rng(rank)
    information = random_information(rng, rank, scale)
    error = rng.normal(size=6)
    rows, value = square_root(information, information @ error, LEVER_M)
    assert rows.shape == (rank, 6)
    assert value.shape == (rank,)
    np.testing.assert_allclose(rows.T @ rows, information, atol=1e-12 * scale * 1e3)
    np.testing.assert_allclose(rows.T @ value, information @ error, atol=1e-12 * scale * 1e4)
    # Whitened: the value is that of the error, row by row.
    np.testing.assert_allclose(value, rows @ error, atol=1e-9 * np.sqrt(scale) * 1e2)


def test_square_root_leaves_out_what_is_rounding() -> None:
    rng = np.random.default_rng(0)
    information = random_information(rng, 3)
    rough = information + 1e-8 * random_information(rng, 6, 1.0)
    rows, value = square_root(rough, rough @ np.ones(6), LEVER_M)
    assert rows.shape == (3, 6)
    np.testing.assert_allclose(rows.T @ rows, information, rtol=1e-9, atol=1e-3)
    np.testing.assert_allclose(value, rows @ np.ones(6), rtol=1e-6)


# Through the filter.


def filter_of(state: NavigationState, covariance: FloatArray) -> ErrorStateFilter[NavigationState]:
    return ErrorStateFilter(state, covariance, gate_probability=1.0 - 1e-12, max_iterations=20)


def prior_covariance(rng: np.random.Generator) -> FloatArray:
    sd = np.repeat([0.03, 0.01, 0.05, 0.02, 0.01, 0.02], [3, 3, 3, 3, 3, 5])
    mixing = np.eye(STATE_SIZE) + 0.1 * rng.normal(size=(STATE_SIZE, STATE_SIZE))
    root = mixing * sd[:, None]
    return np.asarray(root @ root.T)


@pytest.mark.parametrize("ranks", [(3,), (3, 3, 6, 5), (2, 1, 2), (6,) * 9])
def test_joined_faces_give_the_same_posterior(ranks: tuple[int, ...]) -> None:
    rng = np.random.default_rng(len(ranks))
    state = random_state(rng)
    T = moved_pose(pose_of(state), rng.normal(0.0, 0.02, 6))
    faces = [measurement(rng, T, rank) for rank in ranks]
    faces = [PoseMeasurement(faces[0].reference, f.rows, f.value, f.shared) for f in faces]
    # Values that contradict each other a little, as real ones do.
    faces = [
        PoseMeasurement(
            f.reference, f.rows, 0.2 * f.value + rng.normal(size=len(f.value)), f.shared
        )
        for f in faces
    ]
    P = prior_covariance(rng)
    separate, together = filter_of(state, P), filter_of(state, P)
    result = separate.update(faces)
    one = joined(faces)
    assert len(one.value) == min(sum(ranks), 6)
    joint = together.update([one])
    assert all(result.accepted)
    assert all(joint.accepted)
    sd = np.sqrt(np.diag(separate.covariance))
    difference = separate.state.local(together.state)
    assert np.all(np.abs(difference) < 1e-6 * sd)
    np.testing.assert_allclose(
        together.covariance / np.outer(sd, sd), separate.covariance / np.outer(sd, sd), atol=1e-8
    )


def test_update_is_that_of_the_information_filter() -> None:
    rng = np.random.default_rng(2)
    state = random_state(rng)
    P, error = prior_covariance(rng), rng.normal(0.0, 1e-6, 6)
    information = random_information(rng, 5)
    measured = PoseMeasurement.from_information(
        PoseReference(pose_of(state), SIGHT), information, information @ error, LEVER_M
    )
    kalman = filter_of(state, P)
    kalman.update([measured])
    J = pose_jacobian(state, SIGHT)
    posterior = np.linalg.inv(np.linalg.inv(P) + J.T @ information @ J)
    sd = np.sqrt(np.diag(posterior))
    np.testing.assert_allclose(
        kalman.covariance / np.outer(sd, sd), posterior / np.outer(sd, sd), atol=1e-5
    )
    moved = state.local(kalman.state)
    expected = posterior @ J.T @ information @ error
    np.testing.assert_allclose(moved, expected, atol=1e-3 * np.abs(expected).max())


def test_sight_is_of_the_turning_hill_frame() -> None:
    # Hill turns at -n about y: after a quarter of an orbit world z is hill x.
    observer = ObserverPose.of(np.eye(4), 0.5 * np.pi / 1e-3, 1e-3)
    np.testing.assert_allclose(observer.R_hill_world @ [0.0, 0.0, 1.0], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(observer.R_cam_hill @ [1.0, 0.0, 0.0], [0.0, 0.0, 1.0], atol=1e-12)


def test_errors_that_a_frame_shares_are_those_of_the_dense_covariance(
    state: NavigationState, observer: ObserverPose
) -> None:
    """An update with two faces, and with both joined, against the update by their covariance."""
    rng = np.random.default_rng(4)
    reference = PoseReference(
        state.T_cam_model(observer.T_cam_world, observer.R_hill_world), observer
    )
    faces = [
        PoseMeasurement(
            reference,
            rng.normal(size=(4, 6)) * 100.0,
            rng.normal(size=4) * 0.3,
            rng.normal(size=(4, 2)) * [5.0, 2.0],
        )
        for _ in range(2)
    ]
    P = np.diag(rng.uniform(0.01, 0.02, STATE_SIZE) ** 2)
    H = np.vstack([face.jacobian(state) for face in faces])
    common = [face.shared for face in faces if face.shared is not None]
    shared = np.vstack(common)
    S = H @ P @ H.T + np.eye(8) + shared @ shared.T
    gain = np.linalg.solve(S, H @ P).T
    expected = P - gain @ H @ P
    value = gain @ np.concatenate([face.residual(state) for face in faces])
    for measurements, entering in ((faces, common), ([joined(faces)], [])):
        kalman = ErrorStateFilter(state, P, gate_probability=1.0 - 1e-12, max_iterations=1)
        kalman.update(measurements, entering)
        shift = kalman.state.r_hill - state.r_hill
        np.testing.assert_allclose(shift, value[R_HILL], rtol=1e-6, atol=1e-9)
        block = kalman.covariance[R_HILL, R_HILL]
        np.testing.assert_allclose(block, expected[R_HILL, R_HILL], rtol=1e-6, atol=1e-12)
