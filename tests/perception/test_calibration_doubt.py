"""The error of a calibration that explains frames best, against least squares of drawn ones."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.perception.calibration_doubt import N_OFFSETS, calibration_doubt
from pcnav.perception.calibration_fields import FIELD_NAMES

STATED = np.array([0.001, 0.0004, 0.0004, 0.0025, 0.001, 0.001])


def drawn(error: FloatArray, n: int = 400) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information and vector of unit-variance residuals that an error (6,) makes, and their
    derivatives by it."""
    rng = np.random.default_rng(1)
    by = rng.normal(size=(n, N_OFFSETS + len(error))) * np.r_[np.ones(N_OFFSETS), 0.2 / STATED]
    residual = by[:, N_OFFSETS:] @ error + rng.normal(size=n)
    return by.T @ by, by.T @ residual, by


@pytest.mark.parametrize("k", [0, 1, 3, 4])
def test_the_error_that_is_there_is_named_and_sized(k: int) -> None:
    error = np.zeros(6)
    error[k] = 20.0 * STATED[k]
    information, vector, by = drawn(error)
    found = calibration_doubt(information, vector, 1, STATED)
    assert found.name == FIELD_NAMES[k]
    assert found.is_clear
    # By the offsets, which have unit variance, and this error alone.
    columns = by[:, [0, 1, 2, 3, N_OFFSETS + k]]
    prior = np.diag([1.0, 1.0, 1.0, 1.0, 0.0])
    covariance = np.linalg.inv(columns.T @ columns + prior)
    own = (covariance @ vector[[0, 1, 2, 3, N_OFFSETS + k]])[-1]
    assert found.value == pytest.approx(own)
    expected = abs(own) / np.hypot(np.sqrt(covariance[-1, -1]), STATED[k])
    assert found.deviations == pytest.approx(expected)


def test_errors_as_large_as_stated_are_no_contradiction() -> None:
    information, vector, _ = drawn(STATED)
    found = calibration_doubt(information, vector, 1, STATED)
    assert not found.is_clear
    assert calibration_doubt(information, vector, 1, 0.01 * STATED).is_clear


def test_frames_that_err_alike_are_no_surer_for_being_many() -> None:
    error = np.array([0.003, 0.0, 0.0, 0.0, 0.0, 0.0])
    information, vector, _ = drawn(error)
    once = calibration_doubt(information, vector, 1, 0.0 * STATED)
    many = calibration_doubt(20.0 * information, 20.0 * vector, 20, 0.0 * STATED)
    assert many.deviations == pytest.approx(once.deviations, rel=0.05)
    assert 0.9 * 0.003 < many.value < 1.1 * 0.003


def test_the_size_of_the_target_is_told_elsewhere() -> None:
    information, vector, _ = drawn(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.1]))
    assert calibration_doubt(information, vector, 1, STATED).name != "mesh scale"
