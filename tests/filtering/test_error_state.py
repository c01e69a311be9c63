"""The filter engine against closed-form Kalman equations and the optimum of the posterior."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, left_jacobian, log_rotation, skew
from pcnav.filtering.error_state import ErrorStateFilter, MotionModel


@dataclass(frozen=True)
class Vector:
    """A state that is its own error."""

    x: FloatArray

    def retract(self, error: FloatArray, /) -> "Vector":
        return Vector(self.x + error)

    curved = slice(0, 0)

    def retraction_block(self, error: FloatArray, /) -> FloatArray:
        return np.empty((0, 0))

    def admissible(self, error: FloatArray, covariance: FloatArray, /) -> FloatArray:
        return error


@dataclass(frozen=True)
class Attitude:
    """A rotation with body-axes error."""

    R: FloatArray

    def retract(self, error: FloatArray, /) -> "Attitude":
        return Attitude(self.R @ exp_rotation(error))

    curved = slice(0, 3)

    def retraction_block(self, error: FloatArray, /) -> FloatArray:
        return left_jacobian(-error)

    def admissible(self, error: FloatArray, covariance: FloatArray, /) -> FloatArray:
        return error


@dataclass(frozen=True)
class Linear:
    """z = H x + noise."""

    H: FloatArray
    z: FloatArray
    R: FloatArray

    @property
    def covariance(self) -> FloatArray:
        return self.R

    def residual(self, state: Vector) -> FloatArray:
        return np.asarray(self.z - self.H @ state.x)

    def jacobian(self, state: Vector) -> FloatArray:
        return self.H


@dataclass(frozen=True)
class ConsideredLinear(Linear):
    """One that errs by more than it is weighed by."""

    considered: FloatArray


@dataclass(frozen=True)
class Ranges:
    """Distances to beacons: strongly curved near them."""

    beacons: FloatArray
    z: FloatArray
    sigma: float

    @property
    def covariance(self) -> FloatArray:
        return self.sigma**2 * np.eye(len(self.z))

    def residual(self, state: Vector) -> FloatArray:
        return np.asarray(self.z - np.linalg.norm(state.x - self.beacons, axis=1))

    def jacobian(self, state: Vector) -> FloatArray:
        offset = state.x - self.beacons
        return np.asarray(offset / np.linalg.norm(offset, axis=1, keepdims=True))


@dataclass(frozen=True)
class Direction:
    """A known world direction seen in body axes."""

    world: FloatArray
    z: FloatArray
    sigma: float

    @property
    def covariance(self) -> FloatArray:
        return self.sigma**2 * np.eye(3)

    def residual(self, state: Attitude) -> FloatArray:
        return np.asarray(self.z - state.R.T @ self.world)

    def jacobian(self, state: Attitude) -> FloatArray:
        return skew(state.R.T @ self.world)


@dataclass(frozen=True)
class LinearMotion(MotionModel[Vector]):
    F: FloatArray
    Q: FloatArray

    def propagate(
        self, state: Vector, time_s: float, step_s: float
    ) -> tuple[Vector, FloatArray, FloatArray]:
        return Vector(self.F @ state.x), self.F, self.Q * step_s


def random_spd(rng: np.random.Generator, n: int) -> FloatArray:
    root = rng.normal(size=(n, n))
    return np.asarray(root @ root.T + 0.1 * np.eye(n))


def test_linear_gaussian_case_is_the_kalman_filter() -> None:
    rng = np.random.default_rng(0)
    n = 4
    x, P = rng.normal(size=n), random_spd(rng, n)
    kalman = ErrorStateFilter(Vector(x), P, gate_probability=1.0 - 1e-15)
    for k in range(10):
        F, Q = np.eye(n) + 0.1 * rng.normal(size=(n, n)), random_spd(rng, n)
        kalman.predict(LinearMotion(F, Q), 0.5 * k, 0.5)
        x, P = F @ x, F @ P @ F.T + 0.5 * Q
        np.testing.assert_allclose(kalman.covariance, P, rtol=1e-9)
        parts = []
        for size in (1, 3):
            H, R = rng.normal(size=(size, n)), random_spd(rng, size)
            parts.append(Linear(H, H @ x + rng.normal(size=size), R))
        result = kalman.update(parts)
        H = np.vstack([part.H for part in parts])
        z = np.concatenate([part.z for part in parts])
        information = np.linalg.inv(P) + sum(
            p.H.T @ np.linalg.solve(p.covariance, p.H) for p in parts
        )
        R_joint = np.zeros((4, 4))
        R_joint[:1, :1], R_joint[1:, 1:] = parts[0].covariance, parts[1].covariance
        nis = (z - H @ x) @ np.linalg.solve(H @ P @ H.T + R_joint, z - H @ x)
        gain = np.linalg.solve(information, H.T @ np.linalg.inv(R_joint))
        x, P = x + gain @ (z - H @ x), np.linalg.inv(information)
        np.testing.assert_allclose(kalman.state.x, x, atol=1e-8)
        np.testing.assert_allclose(kalman.covariance, P, atol=1e-8)
        assert result.accepted == (True, True)
        assert result.dof == (1, 3) and result.joint_dof == 4
        assert result.joint_nis == pytest.approx(nis)
        assert result.converged and result.iterations == 2  # the second finds nothing to change


S = TypeVar("S")


def map_estimate(
    retract: Callable[[FloatArray], S],
    residuals: Callable[[S], FloatArray],
    P: FloatArray,
    n: int,
) -> FloatArray:
    """The error that maximises the posterior, by scipy without any Jacobian."""
    root = np.linalg.inv(np.linalg.cholesky(P))

    def cost(error: FloatArray) -> FloatArray:
        return np.concatenate([root @ error, residuals(retract(error))])

    return np.asarray(
        least_squares(cost, np.zeros(n), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
    )


@pytest.mark.parametrize("seed", range(5))
def test_iterated_update_is_the_optimum_of_the_posterior(seed: int) -> None:
    rng = np.random.default_rng(seed)
    beacons = np.array([[2.0, 0.0], [0.0, 2.5]])
    truth = rng.normal(0.0, 0.3, 2)
    z = np.linalg.norm(truth - beacons, axis=1) + rng.normal(0.0, 0.02, 2)
    prior, P = Vector(truth + rng.normal(0.0, 0.5, 2)), 0.25 * np.eye(2)
    measurement = Ranges(beacons, z, 0.02)
    optimum = map_estimate(
        prior.retract,
        lambda state: measurement.residual(state) / 0.02,
        P,
        2,
    )
    kalman = ErrorStateFilter(prior, P, gate_probability=1.0 - 1e-15, max_iterations=30)
    result = kalman.update([measurement])
    assert result.converged and result.iterations > 2
    np.testing.assert_allclose(kalman.state.x, prior.x + optimum, atol=1e-4)
    plain = ErrorStateFilter(prior, P, gate_probability=1.0 - 1e-15, max_iterations=1)
    assert plain.update([measurement]).iterations == 1
    assert np.linalg.norm(plain.state.x - (prior.x + optimum)) > 5e-3
    H = measurement.jacobian(kalman.state)
    information = np.linalg.inv(P) + H.T @ H / 0.02**2
    np.testing.assert_allclose(kalman.covariance, np.linalg.inv(information), rtol=1e-2)


@pytest.mark.parametrize("seed", range(5))
def test_iterated_update_of_an_attitude_resets_its_error(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R_true = exp_rotation(rng.normal(size=3))
    P = np.diag([0.5, 0.6, 0.4]) ** 2
    prior = Attitude(R_true @ exp_rotation(rng.normal(0.0, 0.25, 3)))
    world = [np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])]
    seen = [Direction(w, R_true.T @ w + rng.normal(0.0, 0.03, 3), 0.03) for w in world]
    optimum = map_estimate(
        prior.retract,
        lambda s: np.concatenate([m.residual(s) / 0.03 for m in seen]),
        P,
        3,
    )
    kalman = ErrorStateFilter(prior, P, gate_probability=1.0 - 1e-15, max_iterations=30)
    assert kalman.update(seen).converged
    reached = log_rotation(prior.R.T @ kalman.state.R)
    np.testing.assert_allclose(reached, optimum, atol=2e-5)
    # The covariance is that of the error at the new state: the numerical Hessian of the same
    # posterior, written about that state.
    mean = kalman.state

    def cost(error: FloatArray) -> FloatArray:
        state = mean.retract(error)
        at_prior = Rotation.from_matrix(prior.R.T @ state.R).as_rotvec()
        return np.concatenate(
            [np.linalg.solve(np.sqrt(P), at_prior), *(m.residual(state) / 0.03 for m in seen)]
        )

    step = 1e-5
    J = np.column_stack([(cost(step * e) - cost(-step * e)) / (2 * step) for e in np.eye(3)])
    np.testing.assert_allclose(kalman.covariance, np.linalg.inv(J.T @ J), rtol=1e-3, atol=1e-8)


def test_gate_rejects_an_outlier_and_keeps_the_rest() -> None:
    P = np.diag([1.0, 4.0])
    good = Linear(np.array([[1.0, 0.0]]), np.array([0.5]), np.array([[0.25]]))
    bad = Linear(np.array([[0.0, 1.0]]), np.array([10.0]), np.array([[0.25]]))
    kalman = ErrorStateFilter(Vector(np.zeros(2)), P, gate_probability=0.999)
    result = kalman.update([bad, good])
    assert result.accepted == (False, True)
    assert result.nis == pytest.approx((100.0 / 4.25, 0.25 / 1.25))
    assert result.joint_nis == pytest.approx(0.2) and result.joint_dof == 1
    np.testing.assert_allclose(kalman.state.x, [0.5 * 1.0 / 1.25, 0.0])
    np.testing.assert_allclose(kalman.covariance, np.diag([0.2, 4.0]), atol=1e-12)


def test_errors_considered_beside_widen_the_gate_and_not_the_gain() -> None:
    """Ten deviations off by its own noise, less than two with what else it may err by."""
    z, by_error = np.array([10.0]), np.array([[6.0]])
    alone = Linear(np.eye(1), z, np.eye(1))
    beside = ConsideredLinear(np.eye(1), z, np.eye(1), by_error)
    kalman = ErrorStateFilter(Vector(np.zeros(1)), np.eye(1), gate_probability=0.999)
    assert not kalman.would_accept(alone)
    assert kalman.innovation(beside)[0] == pytest.approx(100.0 / (1.0 + 1.0 + 36.0))
    assert kalman.update([beside]).accepted == (True,)
    np.testing.assert_allclose(kalman.state.x, 5.0)
    np.testing.assert_allclose(kalman.covariance, 0.5)


def test_gate_is_the_chi_square_quantile() -> None:
    for probability in (0.5, 0.99):
        limit = np.sqrt(2.0 * chi2.ppf(probability, 1))
        for share, accepted in ((0.999, True), (1.001, False)):
            kalman = ErrorStateFilter(Vector(np.zeros(1)), np.eye(1), gate_probability=probability)
            z = np.array([share * limit])
            assert kalman.update([Linear(np.eye(1), z, np.eye(1))]).accepted == (accepted,)


def test_nothing_measured_changes_nothing() -> None:
    P = np.array([[2.0, 0.3], [0.3, 1.0]])
    kalman = ErrorStateFilter(Vector(np.ones(2)), P)
    result = kalman.update([])
    assert result.accepted == () and result.joint_dof == 0 and np.isnan(result.joint_nis)
    np.testing.assert_array_equal(kalman.state.x, np.ones(2))
    np.testing.assert_array_equal(kalman.covariance, P)


def test_snapshot_and_restore() -> None:
    rng = np.random.default_rng(3)
    P = random_spd(rng, 3)
    kalman = ErrorStateFilter(Vector(rng.normal(size=3)), P)
    before = kalman.snapshot()
    x, covariance = before.state.x.copy(), before.covariance.copy()
    measurement = Linear(np.eye(3), x + 0.1, 0.1 * np.eye(3))
    first = kalman.update([measurement])
    after = kalman.state.x.copy(), kalman.covariance.copy()
    kalman.predict(LinearMotion(2.0 * np.eye(3), np.eye(3)), 0.0, 1.0)
    kalman.restore(before)
    np.testing.assert_array_equal(kalman.state.x, x)
    np.testing.assert_array_equal(kalman.covariance, covariance)
    assert kalman.update([measurement]) == first
    np.testing.assert_array_equal(kalman.state.x, after[0])
    np.testing.assert_array_equal(kalman.covariance, after[1])


def test_covariance_stays_symmetric_and_positive_under_extreme_measurements() -> None:
    rng = np.random.default_rng(4)
    n = 6
    start = np.diag(10.0 ** rng.uniform(-2, 4, n))
    kalman = ErrorStateFilter(Vector(np.zeros(n)), start, gate_probability=1.0 - 1e-15)
    for k in range(200):
        F = np.eye(n) + 0.1 * rng.normal(size=(n, n))
        kalman.predict(LinearMotion(F, 1e-12 * np.eye(n)), float(k), 1.0)
        H = rng.normal(size=(2, n))
        z = H @ kalman.state.x + 1e-5 * rng.normal(size=2)
        kalman.update([Linear(H, z, 1e-10 * np.eye(2))])
        np.testing.assert_array_equal(kalman.covariance, kalman.covariance.T)
        eigenvalues = np.linalg.eigvalsh(kalman.covariance)
        assert eigenvalues[0] > -1e-12 * eigenvalues[-1]


def test_given_covariance_is_not_changed_in_place() -> None:
    P = np.eye(2)
    kalman = ErrorStateFilter(Vector(np.zeros(2)), P)
    kalman.update([Linear(np.eye(2), np.ones(2), np.eye(2))])
    np.testing.assert_array_equal(P, np.eye(2))
    assert kalman.covariance[0, 0] == pytest.approx(0.5)
