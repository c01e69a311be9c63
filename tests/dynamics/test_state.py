"""The navigation state: its error space and the pose it stands for."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.inertia_parameters import parameters_from_ratios
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
    ratio_covariance,
)
from pcnav.filtering.error_state import retraction_jacobian


def random_state(rng: np.random.Generator) -> NavigationState:
    return NavigationState(
        r_hill=rng.normal(0.0, 20.0, 3),
        v_hill=rng.normal(0.0, 0.1, 3),
        com_model=rng.normal(0.0, 0.3, 3),
        R_world_body=exp_rotation(rng.normal(0.0, 1.5, 3)),
        omega_body=rng.normal(0.0, 0.1, 3),
        inertia_ratios=np.array([0.9, 1.2, 0.05, -0.03, 0.04]) + rng.normal(0.0, 0.05, 5),
    )


def test_slices_tile_the_error_state_in_the_order_of_the_design() -> None:
    slices = (R_HILL, V_HILL, COM_MODEL, THETA_BODY, OMEGA_BODY, INERTIA_RATIOS)
    tiles = np.concatenate([np.arange(STATE_SIZE)[part] for part in slices])
    np.testing.assert_array_equal(tiles, np.arange(20))


@pytest.mark.parametrize("seed", range(10))
def test_local_and_retract_undo_one_another(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, other = random_state(rng), random_state(rng)
    error = rng.normal(0.0, 0.5, STATE_SIZE)
    error[INERTIA_RATIOS] *= 0.2
    np.testing.assert_allclose(state.local(state.retract(error)), error, atol=1e-12)
    reached = state.retract(state.local(other))
    np.testing.assert_allclose(reached.R_world_body, other.R_world_body, atol=1e-13)
    np.testing.assert_allclose(other.local(reached), 0.0, atol=1e-12)


def test_errors_are_additive_but_for_the_attitude_which_turns_in_body_axes() -> None:
    rng = np.random.default_rng(1)
    state = random_state(rng)
    error = np.arange(1.0, 21.0) * 1e-3
    moved = state.retract(error)
    np.testing.assert_allclose(moved.r_hill - state.r_hill, error[0:3], atol=1e-14)
    np.testing.assert_allclose(moved.v_hill - state.v_hill, error[3:6], atol=1e-14)
    np.testing.assert_allclose(moved.com_model - state.com_model, error[6:9], atol=1e-14)
    np.testing.assert_allclose(moved.omega_body - state.omega_body, error[12:15], atol=1e-14)
    before, after = (parameters_from_ratios(s.inertia_ratios) for s in (state, moved))
    np.testing.assert_allclose(after - before, error[15:20], atol=1e-12)
    body = state.R_world_body.T @ moved.R_world_body
    np.testing.assert_allclose(body, exp_rotation(error[9:12]), atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.3, 2.0])
def test_retraction_jacobian_is_the_numerical_derivative(size: float) -> None:
    rng = np.random.default_rng(2)
    state, error = random_state(rng), size * rng.normal(0.0, 1.0, STATE_SIZE)
    error[INERTIA_RATIOS] *= 0.1
    moved = state.retract(error)
    numerical = np.empty((STATE_SIZE, STATE_SIZE))
    for k in range(STATE_SIZE):
        step = np.zeros(STATE_SIZE)
        step[k] = 1e-5
        ahead, behind = state.retract(error + step), state.retract(error - step)
        numerical[:, k] = (moved.local(ahead) - moved.local(behind)) / 2e-5
    np.testing.assert_allclose(retraction_jacobian(state, error), numerical, atol=1e-8)


@pytest.mark.parametrize("size", [0.03, 0.3, 3.0, 300.0])
def test_no_admissible_error_leads_to_an_inertia_that_no_body_has(size: float) -> None:
    rng = np.random.default_rng(4)
    for _ in range(30):
        state, error = random_state(rng), rng.normal(size=STATE_SIZE)
        root = rng.normal(size=(STATE_SIZE, STATE_SIZE))
        error[INERTIA_RATIOS] *= size
        changed = state.admissible(error, root @ root.T)
        assert is_physical_inertia(inertia_from_ratios(state.retract(changed).inertia_ratios))


def test_what_is_correlated_moves_with_the_inertia_that_is_made_a_body() -> None:
    rng = np.random.default_rng(5)
    state, error = random_state(rng), np.zeros(STATE_SIZE)
    root = 0.1 * rng.normal(size=(STATE_SIZE, STATE_SIZE))
    P = root @ root.T
    assert not state.admissible(error, P).any()
    error[INERTIA_RATIOS] = [0.5, 0.6, 0.0, 0.1, 0.0]
    change = state.admissible(error, P) - error
    assert np.linalg.norm(change[INERTIA_RATIOS]) > 0.1
    # The conditional mean of the others given the inertia's part.
    inertia = P[INERTIA_RATIOS, INERTIA_RATIOS]
    expected = P[:, INERTIA_RATIOS] @ np.linalg.solve(inertia, change[INERTIA_RATIOS])
    np.testing.assert_allclose(change, expected, atol=1e-9)


def test_thinness_follows_the_error() -> None:
    rng = np.random.default_rng(8)
    error = np.zeros(STATE_SIZE)
    error[INERTIA_RATIOS] = [0.1, 0.5, 0.0, 0.1, 0.0]
    state = random_state(rng).retract(error)
    residual, jacobian = state.thinness()
    assert residual.max() > 5.0
    step = 1e-6 * rng.normal(size=STATE_SIZE)
    change = state.retract(step).thinness()[0] - state.retract(-step).thinness()[0]
    np.testing.assert_allclose(jacobian @ step, 0.5 * change, atol=1e-8)


def test_results_are_in_the_ratios_themselves() -> None:
    rng = np.random.default_rng(5)
    state, other = random_state(rng), random_state(rng)
    error, in_ratios = state.local(other), state.ratio_error(other)
    others = np.arange(STATE_SIZE) < INERTIA_RATIOS.start
    np.testing.assert_array_equal(in_ratios[others], error[others])
    np.testing.assert_array_equal(
        in_ratios[INERTIA_RATIOS], other.inertia_ratios - state.inertia_ratios
    )


def test_covariance_of_the_ratios_is_that_of_states_drawn() -> None:
    rng = np.random.default_rng(6)
    state, root = random_state(rng), 1e-4 * rng.normal(size=(STATE_SIZE, STATE_SIZE))
    drawn = [state.retract(root @ rng.standard_normal(STATE_SIZE)) for _ in range(2000)]
    sampled = np.cov([state.ratio_error(each) for each in drawn], rowvar=False)
    stated = ratio_covariance(state, root @ root.T)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sampled / scale, stated / scale, atol=0.12)
    np.testing.assert_array_equal(stated, stated.T)


def test_pose_takes_a_model_point_along_the_chain_of_frames() -> None:
    rng = np.random.default_rng(3)
    state = random_state(rng)
    R_hill_world = exp_rotation(rng.normal(size=3))
    T_cam_world = make_transform(exp_rotation(rng.normal(size=3)), rng.normal(size=3))
    p_model = rng.normal(size=3)

    # DESIGN: p_hill = r_hill + R_hill_body (p_model - com_model), then hill -> world -> cam.
    R_hill_body = R_hill_world @ state.R_world_body
    p_hill = state.r_hill + R_hill_body @ (p_model - state.com_model)
    p_world = np.linalg.solve(R_hill_world, p_hill)
    p_cam: FloatArray = (T_cam_world @ [*p_world, 1.0])[:3]

    pose = state.T_cam_model(T_cam_world, R_hill_world)
    np.testing.assert_allclose((pose @ [*p_model, 1.0])[:3], p_cam, atol=1e-12)
