"""Considered errors beside a filter that takes them for white: against its error written out."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.lasting_errors import Considered, matrix_root

FRAMES, STEP_S, WHITE, LASTING = 30, 0.5, 0.3, 0.4
F = np.array([[1.0, STEP_S], [0.0, 1.0]])
Q = 0.01 * np.array([[STEP_S**3 / 3.0, STEP_S**2 / 2.0], [STEP_S**2 / 2.0, STEP_S]])
H = np.array([[1.0, 0.0]])
PRIOR = np.diag([1.0, 0.2])


def gains(counted: float = LASTING) -> tuple[list[FloatArray], FloatArray]:
    """Of a filter of place and speed that takes both noises for white, and its covariance; or that
    counts less of the one that lasts."""
    P, found = PRIOR, []
    R = np.array([[WHITE**2 + counted**2]])
    for _ in range(FRAMES):
        P = F @ P @ F.T + Q
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        P = (np.eye(2) - K @ H) @ P
        found.append(K)
    return found, P


def written_out(correlation: float, counted: float = LASTING) -> FloatArray:
    """(2, 2) covariance of its error: linear in the start, the forces and the noise of all frames,
    each with its own covariance."""
    found, _ = gains(counted)
    by_start, by_force, by_noise = np.eye(2), np.zeros((2, 2 * FRAMES)), np.zeros((2, FRAMES))
    for k, K in enumerate(found):
        A = np.eye(2) - K @ H
        by_start, by_force, by_noise = A @ F @ by_start, A @ F @ by_force, A @ F @ by_noise
        by_force[:, 2 * k : 2 * k + 2] += A
        by_noise[:, k] += K[:, 0]
    lag = np.abs(np.subtract.outer(np.arange(FRAMES), np.arange(FRAMES)))
    noise = WHITE**2 * np.eye(FRAMES) + LASTING**2 * correlation**lag
    forces = np.kron(np.eye(FRAMES), Q)
    total = by_start @ PRIOR @ by_start.T + by_force @ forces @ by_force.T
    return np.asarray(total + by_noise @ noise @ by_noise.T)


@pytest.mark.parametrize("correlation", [0.0, 0.7, 1.0])
def test_the_covariance_is_that_of_the_error_written_out(correlation: float) -> None:
    found, own = gains()
    beside = Considered(np.zeros((2, 2)), np.zeros((2, 1)))
    for K in found:
        beside = beside.predicted(F).updated(np.eye(2) - K @ H, LASTING * K, correlation)
    assert own + beside.added == pytest.approx(written_out(correlation), rel=1e-9)
    if correlation == 1.0:
        # The filter alone would claim two thirds of it.
        assert np.sqrt(own[0, 0] + beside.added[0, 0]) > 1.5 * np.sqrt(own[0, 0])


@pytest.mark.parametrize("correlation", [0.0, 0.7, 1.0])
def test_errors_that_a_filter_does_not_count_are_added_in_full(correlation: float) -> None:
    found, own = gains(counted=0.0)
    beside = Considered(np.zeros((2, 2)), np.zeros((2, 1)))
    for K in found:
        beside = beside.predicted(F).updated(np.eye(2) - K @ H, LASTING * K, correlation)
        beside = beside.with_own(LASTING * K)
    assert own + beside.added == pytest.approx(written_out(correlation, counted=0.0), rel=1e-9)


def test_the_root_of_a_covariance() -> None:
    rng = np.random.default_rng(0)
    part = rng.normal(size=(6, 4))
    root = matrix_root(part @ part.T, 0.3)
    assert root @ root.T == pytest.approx(part @ part.T, abs=1e-9)
