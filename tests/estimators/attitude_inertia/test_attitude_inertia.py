"""The filter on attitudes: its model against numbers made otherwise, and what it finds."""

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from pcnav.config.attitude_inertia import AttitudeInertiaTable, Propagation
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.inertia_parameters import inertia_of, parameters_of, shares
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator, initial_belief
from pcnav.estimators.attitude_inertia.rotation_fit import AttitudeArc, RotationPrior, fit_rotations
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    OMEGA,
    THETA,
    AttitudeSet,
    RotationState,
    TorqueFreeModel,
    parameters_from_printed,
    printed_covariance,
    printed_from_parameters,
    printed_ratios_jacobian,
)
from pcnav.filtering.batched_filter import BatchedFilter, Together
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.simulation.motion import rotate_torque_free

PRINTED = np.array([0.85, 1.37, 0.13, 0.17, -0.11])
J = np.array([[0.85, 0.13, 0.17], [0.13, 1.37, -0.11], [0.17, -0.11, 1.0]])
RATE = np.radians([5.0, 2.3, 3.5])


def _state(seed: int = 0) -> RotationState:
    rng = np.random.default_rng(seed)
    return RotationState(
        Rotation.random(rng=rng).as_matrix(),
        RATE + 0.01 * rng.standard_normal(3),
        parameters_from_printed(PRINTED + 0.02 * rng.standard_normal(5)),
    )


def test_parameters_are_those_of_the_printed_matrix():
    parameters = parameters_from_printed(PRINTED)
    np.testing.assert_allclose(inertia_of(parameters), 3.0 * J / np.trace(J), atol=1e-14)
    np.testing.assert_allclose(parameters_of(5.0 * J), parameters, atol=1e-14)
    np.testing.assert_allclose(printed_from_parameters(parameters), PRINTED, atol=1e-14)


def test_jacobian_of_the_printed_ratios():
    parameters = parameters_from_printed(PRINTED)
    step = 1e-6
    numerical = [
        (
            printed_from_parameters(parameters + step * e)
            - printed_from_parameters(parameters - step * e)
        )
        / (2.0 * step)
        for e in np.eye(5)
    ]
    np.testing.assert_allclose(
        printed_ratios_jacobian(parameters), np.array(numerical).T, atol=1e-9
    )


@pytest.mark.parametrize("propagation", list(Propagation))
def test_transition_is_the_derivative_of_the_motion(propagation):
    """In a long step of the integrator, and in a short one of Euler's, whose C is of order h."""
    model = TorqueFreeModel(0.0, propagation)
    state, h = _state(), 8.0 if propagation is Propagation.INTEGRATED else 1e-3
    moved, transition, _ = model.propagate(state, 0.0, h)
    step = 1e-6
    numerical = []
    for e in np.eye(11):
        after = [model.propagate(state.retract(s * step * e), 0.0, h)[0] for s in (1.0, -1.0)]
        numerical.append((moved.local(after[0]) - moved.local(after[1])) / (2.0 * step))
    tolerance = 1e-7 if propagation is Propagation.INTEGRATED else 1e-3 * h
    np.testing.assert_allclose(transition, np.array(numerical).T, atol=tolerance)


def test_integration_keeps_momentum_and_energy_and_agrees_with_another():
    state = RotationState(np.eye(3), RATE, parameters_from_printed(PRINTED))
    model = TorqueFreeModel(0.0)
    moved, _, _ = model.propagate(state, 0.0, 120.0)
    N = inertia_of(state.parameters)
    before = state.R_world_body @ N @ state.omega_body
    after = moved.R_world_body @ N @ moved.omega_body
    np.testing.assert_allclose(after, before, atol=1e-6 * float(np.linalg.norm(before)))
    energy = [s.omega_body @ N @ s.omega_body for s in (state, moved)]
    assert energy[1] == pytest.approx(energy[0], rel=1e-6)
    R, omega = rotate_torque_free(np.eye(3), RATE, J, np.array([0.0, 120.0]))
    truth = RotationState(R[1], omega[1], state.parameters)
    assert np.linalg.norm(moved.local(truth)) < 1e-5
    back = model.propagate(moved, 120.0, -120.0)[0]
    assert np.linalg.norm(back.local(state)) < 1e-5


def test_euler_step_is_the_printed_one():
    """(36) on the numbers of the quaternion: ``q + q' dT``, normalised."""
    state, h = _state(3), 0.5
    moved, _, _ = TorqueFreeModel(0.0, Propagation.EULER).propagate(state, 0.0, h)
    q = Rotation.from_matrix(state.R_world_body).as_quat()
    x, y, z = state.omega_body
    omega = np.array([[0, z, -y, x], [-z, 0, x, y], [y, -x, 0, z], [-x, -y, -z, 0]])
    after = q + 0.5 * h * omega @ q
    expected = Rotation.from_quat(after).as_matrix()
    np.testing.assert_allclose(moved.R_world_body, expected, atol=1e-14)
    N = inertia_of(state.parameters)
    acceleration = -np.linalg.solve(N, np.cross(state.omega_body, N @ state.omega_body))
    np.testing.assert_allclose(moved.omega_body, state.omega_body + h * acceleration, atol=1e-14)


def test_attitude_jacobian():
    state = _state(1)
    turned = state.R_world_body @ exp_rotation(np.array([0.3, -0.2, 0.5]))
    measured = Together(AttitudeSet(turned, np.eye(3)))
    step = 1e-6
    numerical = [
        -(measured.residual(state.retract(step * e)) - measured.residual(state.retract(-step * e)))
        / (2.0 * step)
        for e in np.eye(11)
    ]
    np.testing.assert_allclose(measured.jacobian(state), np.array(numerical).T, atol=1e-8)


def test_both_engines_give_the_same_numbers():
    state, model = _state(2), TorqueFreeModel(1e-12)
    P = np.diag([1e-4] * 3 + [1e-4] * 3 + [1e-2] * 5)
    one = ErrorStateFilter(state, P)
    arrays = (state.R_world_body, state.omega_body, state.parameters)
    many = BatchedFilter(RotationState(*(np.stack([a, a]) for a in arrays)), np.stack([P, P]))
    rng = np.random.default_rng(5)
    noise = 1e-4 * np.eye(3)
    for k in range(4):
        one.predict(model, float(k), 1.0)
        many.predict(model, float(k), 1.0)
        R = one.state.R_world_body @ exp_rotation(0.01 * rng.standard_normal(3))
        one.update([Together(AttitudeSet(R, noise))])
        many.update(AttitudeSet(np.stack([R, R]), noise))
    np.testing.assert_allclose(many.states.parameters[1], one.state.parameters, atol=1e-9)
    np.testing.assert_allclose(many.states.R_world_body[1], one.state.R_world_body, atol=1e-9)
    np.testing.assert_allclose(many.covariance[1], one.covariance, atol=1e-9)


def test_admissible_brings_back_what_no_body_has():
    state = _state(4)
    wild = np.zeros(11)
    wild[INERTIA] = [1.5, -0.9, 0.0, 0.0, 0.0]
    P = 0.1 * np.eye(11)
    assert shares(state.parameters + wild[INERTIA])[0][0] < 0.0
    found = state.admissible(wild, P)
    assert shares(state.parameters + found[INERTIA])[0][0] > 0.0
    calm = np.full(11, 1e-3)
    np.testing.assert_array_equal(state.admissible(calm, P), calm)


def _attitudes(n: int, interval_s: float, sd_rad: float, runs: int, seed: int, rate=RATE, body=J):
    rng = np.random.default_rng(seed)
    times_s = interval_s * np.arange(n, dtype=np.float64)
    R, omega = rotate_torque_free(np.eye(3), rate, body, times_s)
    noise = exp_rotation(sd_rad * rng.standard_normal((n, runs, 3)))
    return times_s, R, omega, R[:, None] @ noise


def test_fit_finds_the_minimum_of_its_cost():
    times_s, _, _, seen = _attitudes(30, 2.0, 0.01, 2, seed=6)
    model, runs = TorqueFreeModel(0.0), 2
    mean = RotationState(
        np.broadcast_to(np.eye(3), (runs, 3, 3)),
        np.tile(RATE + 0.02, (runs, 1)),
        np.tile(parameters_from_printed(np.array([0.9, 1.2, 0.0, 0.0, 0.0])), (runs, 1)),
    )
    prior = RotationPrior(mean, np.diag([0.01**2] * 3 + [0.05**2] * 3 + [0.2**2] * 5))
    arc = AttitudeArc(times_s, seen, np.broadcast_to(1e-4 * np.eye(3), (30, 3, 3)))
    fit = fit_rotations(model, prior, arc, mean)
    assert fit.converged.all()

    def cost(start: RotationState) -> np.ndarray:
        away = prior.mean.local(start)
        total = np.einsum("bi,ij,bj->b", away, np.linalg.inv(prior.covariance), away)
        state = start
        for k in range(30):
            if k:
                state = model.propagate(state, 0.0, 2.0)[0]
            error = state.local(RotationState(seen[k], state.omega_body, state.parameters))
            total = total + np.sum(error[:, THETA] ** 2, axis=1) / 1e-4
        return total

    best = cost(fit.start)
    np.testing.assert_allclose(fit.cost, best, rtol=1e-9)
    for e in np.eye(11):
        for sign in (1.0, -1.0):
            moved = fit.start.retract(np.tile(sign * 1e-4 * e, (runs, 1)))
            assert np.all(cost(moved) > best - 1e-3)


@pytest.mark.study
def test_nutation_tells_all_ratios_with_the_right_covariance():
    runs, sd = 12, np.radians(0.5)
    table = AttitudeInertiaTable(
        rate_deg_s=(5.5, 2.0, 3.0),
        rate_sd_deg_s=1.0,
        inertia_ratios_zz=(0.9, 1.3, 0.05, 0.1, -0.1),
        inertia_ratio_sd=0.1,
        attitude_sd_deg=0.5,
    )
    times_s, R, omega, seen = _attitudes(90, 1.5, sd, runs, seed=7)
    estimator = AttitudeInertiaEstimator(table)
    for time_s, attitudes in zip(times_s, seen, strict=True):
        estimate = estimator.step(time_s, attitudes)
    truth = RotationState(
        np.broadcast_to(R[-1], (runs, 3, 3)),
        np.broadcast_to(omega[-1], (runs, 3)),
        np.broadcast_to(parameters_from_printed(PRINTED), (runs, 5)),
    )
    error = estimate.state.local(truth)
    nees = np.einsum("bi,bij,bj->b", error, np.linalg.inv(estimate.covariance), error)
    # 95 % of the mean of 12 runs of 11 degrees is 8.5 to 13.8.
    assert 7.5 < nees.mean() < 15.0
    ratios = estimate.state.printed_error(truth)[:, INERTIA]
    assert np.sqrt(np.mean(ratios**2)) < 0.01
    assert np.degrees(np.sqrt(np.mean(error[:, OMEGA] ** 2))) < 0.04


def test_spin_leaves_three_ratios_where_they_were(monkeypatch):
    fitted = []

    def counted(model, prior, arc, start):
        fitted.append(len(arc.times_s))
        return fit_rotations(model, prior, arc, start)

    monkeypatch.setattr("pcnav.estimators.attitude_inertia.estimator.fit_rotations", counted)
    spin = np.radians([0.0, 2.3, 0.0])
    table = AttitudeInertiaTable(
        rate_deg_s=(0.0, 2.0, 0.0), rate_sd_deg_s=1.0, inertia_ratios_zz=(0.9, 1.2, 0.0, 0.0, 0.0)
    )
    times_s, _, _, seen = _attitudes(60, 3.0, np.radians(0.5), 1, 8, spin, np.diag([0.85, 1.37, 1]))
    estimator = AttitudeInertiaEstimator(table)
    for time_s, R in zip(times_s, seen[:, 0], strict=True):
        estimate = estimator.step(time_s, R)
    one = RotationState(np.eye(3), np.zeros(3), estimate.state.parameters[0])
    sd = np.sqrt(np.diag(printed_covariance(one, estimate.covariance[0])))[INERTIA]
    assert np.all(sd[[0, 1, 3]] > 0.2)
    assert np.all(sd[[2, 4]] < 0.05)
    # As long as the inertia is not known, the whole arc is fitted again.
    assert fitted[0] == 5 and fitted[-1] > 50


def test_bad_input_is_told():
    estimator = AttitudeInertiaEstimator(AttitudeInertiaTable())
    estimator.step(0.0, np.eye(3))
    with pytest.raises(InputError, match="time_s"):
        estimator.step(0.0, np.eye(3))
    with pytest.raises(InputError, match="covariance"):
        estimator.step(1.0, np.eye(3), np.zeros((3, 3)))
    with pytest.raises(ValidationError, match="inertia_ratios_zz"):
        AttitudeInertiaTable(inertia_ratios_zz=(0.2, 0.2, 0.0, 0.0, 0.0))


def test_initial_belief_has_the_printed_spread():
    table = AttitudeInertiaTable(inertia_ratios_zz=(0.9, 1.2, 0.05, 0.0, 0.0), inertia_ratio_sd=0.2)
    _, parameters, P = initial_belief(table)
    one = RotationState(np.eye(3), np.zeros(3), parameters)
    spread = printed_covariance(one, P)[INERTIA, INERTIA]
    np.testing.assert_allclose(spread, 0.04 * np.eye(5), atol=1e-12)
