"""Likelihoods, mixtures and points of the bank against scipy, sampling and a change of errors."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from pcnav.config.inertia_bank import InertiaBankTable, Likelihood
from pcnav.core.arrays import is_finite, picked
from pcnav.estimators.inertia_bank.bank import InertiaBank, add_points, keep_points, start_motion
from pcnav.estimators.inertia_bank.hypotheses import log_likelihood, moment_matched, normalised
from pcnav.estimators.inertia_bank.relative_state import PixelMeasurements, RelativeStates
from pcnav.filtering.batched_filter import BatchedFilter
from tests.filtering.test_batched_filter import BATCH, ORBIT, R_RIG_HILL, RIG, N, random_states


def test_likelihoods_are_normal_densities_of_the_innovation():
    rng = np.random.default_rng(0)
    states = random_states(rng, True)
    covariance = np.broadcast_to(1e-4 * np.eye(N), (BATCH, N, N)).copy()
    offset = 0.2 * rng.normal(size=(BATCH, 3, 3))
    empty = PixelMeasurements(RIG, R_RIG_HILL, np.arange(3), np.zeros((BATCH, 3, 3)))
    seen = replace(empty, pixels=offset - empty.residual(states))
    H = seen.jacobian(states).reshape(BATCH, 9, N)
    R = np.kron(np.eye(3), seen.noise[0])
    update = BatchedFilter(states, covariance, gate_probability=1.0 - 1e-12).update(seen)
    left = offset.reshape(BATCH, 9)
    for kind, S in (
        (Likelihood.INNOVATION, H @ covariance @ np.swapaxes(H, -1, -2) + R),
        (Likelihood.PRINTED, np.broadcast_to(R, (BATCH, 9, 9))),
    ):
        expected = [multivariate_normal.logpdf(left[b], cov=S[b]) for b in range(BATCH)]
        np.testing.assert_allclose(log_likelihood(update, kind, seen.noise), expected, rtol=1e-9)


def test_weights_survive_any_logarithm():
    logs = np.array([[-1e6, -1e6 + np.log(3.0)], [-2e5, 0.0]])
    np.testing.assert_allclose(normalised(logs), [[0.25, 0.75], [0.0, 1.0]], atol=1e-9)


@pytest.mark.parametrize("coupled", [True, False])
def test_mixture_matches_the_moments_of_samples(coupled):
    rng = np.random.default_rng(1)
    centre = random_states(rng, coupled)
    h = 3
    apart = 0.02 * rng.normal(size=(2 * h, N))
    states = picked(centre, np.array([0, 0, 0, 1, 1, 1])).retract(apart)
    root = 0.02 * rng.normal(size=(2 * h, N, N)) / np.sqrt(N)
    covariance = root @ np.swapaxes(root, -1, -2)
    weights = np.array([[0.2, 0.5, 0.3], [0.6, 0.1, 0.3]])
    parameters = rng.normal(size=(2, h, 5))
    mixture = moment_matched(states, covariance, weights, parameters)
    count = 40000
    for run in range(2):
        which = rng.choice(h, size=count, p=weights[run])
        drawn = (root[run * h + which] @ rng.normal(size=(count, N, 1)))[..., 0]
        samples = picked(states, run * h + which).retract(drawn)
        one: RelativeStates = picked(mixture.states, np.full(count, run))
        errors = np.hstack([one.local(samples), parameters[run, which] - mixture.parameters[run]])
        expected = np.cov(errors.T)
        sd = np.sqrt(np.diag(expected))
        np.testing.assert_array_less(np.abs(errors.mean(axis=0)), 0.04 * sd)
        scaled = (mixture.covariance[run] - expected) / np.outer(sd, sd)
        np.testing.assert_allclose(scaled, 0.0, atol=0.04)


def test_points_added_to_either_kind_of_error_mean_the_same():
    rng = np.random.default_rng(2)
    coupled = random_states(rng, True)
    plain = replace(coupled, coupled=False)
    root = 0.01 * rng.normal(size=(BATCH, N, N))
    covariance = root @ np.swapaxes(root, -1, -2)
    T = coupled.to_body_errors()
    body = T @ covariance @ np.swapaxes(T, -1, -2)
    positions = coupled.positions()[:, :2] + 1.0
    noise = np.broadcast_to(np.diag([1e-4, 2e-4, 3e-4]), (BATCH, 2, 3, 3))
    more, P = add_points(coupled, covariance, positions, noise)
    other, P_body = add_points(plain, body, positions, noise)
    np.testing.assert_allclose(more.positions()[:, -2:], positions)
    np.testing.assert_allclose(other.points_body, more.points_body)
    T = more.to_body_errors()
    np.testing.assert_allclose(T @ P @ np.swapaxes(T, -1, -2), P_body, atol=1e-12)
    fewer, P_back = keep_points(more, P, np.arange(3))
    np.testing.assert_allclose(fewer.points_body, coupled.points_body)
    np.testing.assert_allclose(P_back, covariance)


@pytest.mark.parametrize("coupled", [True, False])
def test_start_has_the_priors_of_the_table(coupled):
    table = InertiaBankTable(kinematic_coupling=coupled, rate_deg_s=(1.0, -2.0, 0.5))
    points = np.random.default_rng(3).normal(size=(2, 7, 3)) + np.array([20.0, 0.0, 0.0])
    states, P = start_motion(table, points, np.broadcast_to(np.eye(3), (2, 3, 3)))
    T = states.motion_to_body_errors()
    sd = np.sqrt(np.diagonal(T @ P @ np.swapaxes(T, -1, -2), axis1=1, axis2=2))
    angles = np.radians([5.0] * 3 + [0.5] * 3)
    np.testing.assert_allclose(sd, np.tile([1.0] * 3 + [0.1] * 3 + list(angles), (2, 1)))
    np.testing.assert_allclose(states.r_hill, np.median(points, axis=1))


def test_all_filters_of_a_run_use_the_same_points():
    """A wrong match goes everywhere, a point that one plausible hypothesis explains stays."""
    rng = np.random.default_rng(4)
    states = picked(random_states(rng, True), np.array([0]))
    start = (states, 1e-8 * np.eye(N)[None])
    inertia = np.broadcast_to(np.eye(3), (1, 2, 3, 3))
    bank = InertiaBank(InertiaBankTable(), ORBIT, inertia, start, 0.0)
    moved = bank.states.positions().copy()
    moved[1, 1, 1] += 1.0
    bank._filter.states = bank.states.with_points(
        (moved - bank.states.r_hill[:, None]) @ bank.states.R_hill_body
    )
    empty = PixelMeasurements(RIG, R_RIG_HILL, np.arange(3), np.zeros((1, 3, 3)))
    pixels = -empty.residual(states)
    pixels[0, 2] += 100.0
    assert bank.step(0.0, replace(empty, pixels=pixels)) is not None
    result = bank.step(0.0, replace(empty, pixels=pixels))
    assert result is not None
    np.testing.assert_array_equal(result.accepted, [[True, True, False]] * 2)
    assert bank.weights()[0, 0] > 0.999


def test_a_filter_whose_numbers_break_down_is_out_of_the_bank_and_stays_finite():
    """A moment of next to nothing makes accelerations that overflow."""
    rng = np.random.default_rng(5)
    states = picked(random_states(rng, True), np.array([0]))
    states = replace(states, omega_body=np.array([[0.5, 0.6, 0.7]]))
    inertia = np.stack([np.diag([1.0, 2.0, 2.5]), np.diag([1e-250, 1.0, 3.0])])[None]
    bank = InertiaBank(InertiaBankTable(), ORBIT, inertia, (states, 1e-6 * np.eye(N)[None]), 0.0)
    for k in range(1, 40):
        bank.predict(5.0 * k)
    np.testing.assert_array_equal(bank.broken, [False, True])
    np.testing.assert_array_equal(bank.weights(), [[1.0, 0.0]])
    assert is_finite(bank.states).all() and np.isfinite(bank.covariance).all()
    alone = InertiaBank(
        InertiaBankTable(), ORBIT, inertia[:, :1], (states, 1e-6 * np.eye(N)[None]), 0.0
    )
    for k in range(1, 40):
        alone.predict(5.0 * k)
    np.testing.assert_allclose(bank.states.omega_body[0], alone.states.omega_body[0], rtol=1e-5)
