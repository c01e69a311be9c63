"""Axes of a round target: what a turn of them makes of a state is no error of it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.inertia_parameters import ratios_from_parameters
from pcnav.dynamics.state import OMEGA_BODY, STATE_SIZE, THETA_BODY, NavigationState
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.round_axes import InChosenAxes, RoundAxes
from pcnav.target.roundness import Roundness

STAGE = Roundness(np.array([0.1, -0.2, 0.7]), np.array([[0.6, 0.0, 0.8]]))
BALL = Roundness(np.array([0.1, -0.2, 0.7]), np.eye(3))
MODEL = MassCentreModel(1e-3, 0.0, 0.0)


def a_state() -> NavigationState:
    return NavigationState(
        r_hill=np.array([3.0, -12.0, 1.0]),
        v_hill=np.array([0.01, 0.02, -0.01]),
        com_model=np.array([0.15, -0.1, 0.9]),
        R_world_body=Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix(),
        omega_body=np.array([0.05, -0.12, 0.2]),
        inertia_ratios=ratios_from_parameters(np.array([1.1, 0.7, 0.05, -0.08, 0.1])),
    )


def turned(state: NavigationState, roundness: Roundness, vector: np.ndarray) -> NavigationState:
    """The same body, told in axes that are turned about it."""
    R, point = exp_rotation(vector), roundness.point_model
    inertia = R.T @ state.inertia @ R
    ratios = inertia[(1, 2, 0, 0, 1), (1, 2, 1, 2, 2)] / inertia[0, 0]
    return NavigationState(
        r_hill=state.r_hill,
        v_hill=state.v_hill,
        com_model=R.T @ (state.com_model - point) + point,
        R_world_body=state.R_world_body @ R,
        omega_body=R.T @ state.omega_body,
        inertia_ratios=ratios,
    )


@pytest.mark.parametrize("roundness", [STAGE, BALL])
def test_a_turn_of_the_axes_is_no_error(roundness: Roundness) -> None:
    state, small = a_state(), 1e-5
    chosen = RoundAxes(roundness).chosen(state)
    for axis in roundness.axes_model:
        error = state.local(turned(state, roundness, small * axis))
        assert np.linalg.norm(error) > small
        assert np.linalg.norm(chosen @ error) < 0.011 * np.linalg.norm(error)


def test_other_errors_stay() -> None:
    axis, chosen = STAGE.axes_model[0], RoundAxes(STAGE).chosen(a_state())
    without = np.zeros((STATE_SIZE, STATE_SIZE))
    without[THETA_BODY, THETA_BODY] = np.outer(axis, axis)
    others = np.eye(STATE_SIZE) - without
    np.testing.assert_allclose(chosen @ others, others, atol=1e-15)


def test_the_rate_about_the_axis_does_not_blur_what_is_told_in_the_axes() -> None:
    """The rate across the axis is known; after a minute that about it may have led anywhere."""
    state, axis = a_state(), STAGE.axes_model[0]
    covariance = np.zeros((STATE_SIZE, STATE_SIZE))
    covariance[OMEGA_BODY, OMEGA_BODY] = 0.1**2 * np.outer(axis, axis)
    free, chosen = covariance, covariance
    model, at = InChosenAxes(MODEL, RoundAxes(STAGE)), state
    for _ in range(60):
        plain = MODEL.propagate(at, 0.0, 1.0)[1]
        at, transition, noise = model.propagate(at, 0.0, 1.0)
        free = plain @ free @ plain.T
        chosen = transition @ chosen @ transition.T + noise
    about = [float(axis @ P[THETA_BODY, THETA_BODY] @ axis) for P in (free, chosen)]
    assert np.sqrt(about[0]) > 3.0, "the plain filter's angle may be any, in a straight line"
    assert np.sqrt(about[1]) < 0.01


def test_what_is_not_seen_is_reported_as_unknown() -> None:
    reported = RoundAxes(STAGE).reported(np.zeros((STATE_SIZE, STATE_SIZE)))
    axis = STAGE.axes_model[0]
    turn = reported[THETA_BODY, THETA_BODY]
    assert np.sqrt(axis @ turn @ axis) == pytest.approx(np.pi / np.sqrt(3.0))
    across = np.cross(axis, [0.0, 1.0, 0.0])
    assert across @ turn @ across == pytest.approx(0.0, abs=1e-15)
