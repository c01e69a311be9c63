"""The batched engine against the one for a single state, on the states of the inertia bank."""

import numpy as np
import pytest

from pcnav.core.arrays import picked
from pcnav.core.spatial import exp_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.inertia_bank.relative_state import (
    PixelMeasurements,
    RelativeMotion,
    RelativeStates,
)
from pcnav.filtering.batched_filter import BatchedFilter, Member
from pcnav.filtering.error_state import ErrorStateFilter

BATCH, POINTS = 4, 3
N = 12 + 3 * POINTS
RIG = StereoRig(1.0, 1000.0, (500.0, 500.0), (1000, 1000), 0.2)
R_RIG_HILL = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
ORBIT = KeplerOrbit(1e-3, 0.05, 0.3)


def random_states(rng: np.random.Generator, coupled: bool) -> RelativeStates:
    return RelativeStates(
        r_hill=np.array([20.0, 1.0, -1.0]) + rng.normal(size=(BATCH, 3)),
        v_hill=0.05 * rng.normal(size=(BATCH, 3)),
        R_hill_body=exp_rotation(rng.normal(size=(BATCH, 3))),
        # One Runge-Kutta step for all, so that a batch and its members are the same numbers.
        omega_body=0.01 * rng.normal(size=(BATCH, 3)),
        points_body=rng.normal(size=(BATCH, POINTS, 3)),
        coupled=coupled,
    )


def random_model(rng: np.random.Generator) -> RelativeMotion:
    root = rng.normal(size=(BATCH, 3, 3))
    inertia = 3.0 * np.eye(3) + 0.2 * root @ np.swapaxes(root, -1, -2)
    inverse = np.asarray(np.linalg.inv(inertia), dtype=np.float64)
    return RelativeMotion(ORBIT, inertia, inverse, 1e-6, 1e-8)


@pytest.mark.parametrize("coupled", [True, False])
@pytest.mark.parametrize("seed", range(4))
def test_equals_the_single_filter(coupled, seed):
    rng = np.random.default_rng(seed)
    truth, model = random_states(rng, coupled), random_model(rng)
    root = 0.02 * rng.normal(size=(BATCH, N, N)) / np.sqrt(N)
    covariance = root @ np.swapaxes(root, -1, -2) + 1e-6 * np.eye(N)
    error = (np.linalg.cholesky(covariance) @ rng.normal(size=(BATCH, N, 1)))[..., 0]
    start = truth.retract(error)
    batched = BatchedFilter(start, covariance.copy(), gate_probability=0.99)
    single = [
        ErrorStateFilter(picked(start, b), covariance[b], gate_probability=0.99)
        for b in range(BATCH)
    ]
    rejected = 0
    for k in range(3):
        batched.predict(model, float(k), 1.0)
        truth, _, _ = model.propagate(truth, float(k), 1.0)
        which = np.array([0, 2, 1])
        clean = PixelMeasurements(RIG, R_RIG_HILL, which, np.zeros((BATCH, 3, 3)))
        pixels = -clean.residual(truth) + 0.2 * rng.normal(size=(BATCH, 3, 3))
        pixels[1, 1] += 300.0 * (k == 1)  # a wrong match
        seen = PixelMeasurements(RIG, R_RIG_HILL, which, pixels)
        many = batched.update(seen)
        for b, one in enumerate(single):
            one.predict(picked(model, b), float(k), 1.0)
            alone = PixelMeasurements(RIG, R_RIG_HILL, which, pixels[b])
            result = one.update([Member(alone, j) for j in range(3)])
            assert result.accepted == tuple(many.accepted[b])
            np.testing.assert_allclose(result.nis, many.nis[b], rtol=1e-9, atol=1e-9)
            assert result.joint_dof == many.joint_dof[b]
            if result.joint_dof:
                assert result.joint_nis == pytest.approx(many.joint_nis[b], rel=1e-9, abs=1e-9)
                assert result.iterations == many.iterations[b]
                assert result.converged == many.converged[b]
            ours = picked(batched.states, b)
            np.testing.assert_allclose(one.state.local(ours), 0.0, atol=1e-9)
            np.testing.assert_allclose(batched.covariance[b], one.covariance, rtol=0, atol=1e-9)
            rejected += result.accepted.count(False)
    assert rejected > 0


def test_choice_overrules_the_gate_and_terms_of_the_likelihood_agree():
    rng = np.random.default_rng(7)
    states = random_states(rng, True)
    covariance = np.broadcast_to(1e-4 * np.eye(N), (BATCH, N, N)).copy()
    which = np.arange(POINTS)
    clean = PixelMeasurements(RIG, R_RIG_HILL, which, np.zeros((BATCH, 3, 3)))
    offset = rng.normal(size=(BATCH, 3, 3))
    seen = PixelMeasurements(RIG, R_RIG_HILL, which, offset - clean.residual(states))
    engine = BatchedFilter(states, covariance)
    H = seen.jacobian(states).reshape(BATCH, 9, N)[:, :6]
    S = H @ covariance @ np.swapaxes(H, -1, -2) + np.kron(np.eye(2), seen.noise[0])

    def first_two(accepted):
        assert not np.all(accepted)
        return np.broadcast_to(np.array([True, True, False]), accepted.shape)

    update = engine.update(seen, first_two)
    left = offset[:, :2].reshape(BATCH, 6)
    np.testing.assert_array_equal(update.joint_dof, 6)
    np.testing.assert_allclose(update.log_determinant, np.linalg.slogdet(S)[1], rtol=1e-9)
    np.testing.assert_allclose(
        update.joint_nis, np.einsum("bi,bij,bj->b", left, np.linalg.inv(S), left), rtol=1e-9
    )
    expected = np.sum(left**2 / np.tile([0.04, 0.04, 0.02], 2), axis=1)
    np.testing.assert_allclose(update.noise_squares, expected, rtol=1e-9)
