"""The arc fit against simulated measurements, the filter and its own covariance."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.core.arrays import FloatArray, picked
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.inertia_parameters import parameter_covariance
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.depth.first_state import start_covariance
from pcnav.estimators.depth.mass_centre import MassCentreModel, RectangleMeasurement
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.filtering.map_arc_fit import TimedMeasurements, fit_arc

Timed = TimedMeasurements[NavigationState]

N = 1.1e-3
MODEL = MassCentreModel(N, 0.0, 0.0)
SD = np.array([0.004, 0.004, 0.001, 0.002, 0.002, 0.003])
T_CAM_HILL = make_transform(exp_rotation(np.array([0.4, 1.2, -0.3])), np.zeros(3))
RECTANGLES = (
    make_transform(exp_rotation(np.array([0.3, 0.1, 0.0])), np.array([0.5, 2.0, 0.3])),
    make_transform(exp_rotation(np.array([0.0, 1.5, 0.4])), np.array([-0.6, -1.0, 1.0])),
)
COM_SD, RATIO_SD = np.full(3, 0.1), np.full(5, 0.05)
TRUTH = NavigationState(
    r_hill=np.array([20.0, 0.5, -0.4]),
    v_hill=np.array([0.01, -0.005, 0.004]),
    com_model=np.array([0.05, -0.03, 0.08]),
    R_world_body=exp_rotation(np.array([0.5, -1.0, 0.7])),
    omega_body=np.array([0.05, -0.08, 0.1]),
    inertia_ratios=np.array([0.8, 1.1, 0.02, -0.03, 0.01]),
)


def measured(state: NavigationState, time_s: float, rng: np.random.Generator | None) -> Timed:
    """Both rectangles at a state, with errors of SD in rectangle axes."""
    R = R_hill_world(time_s, N)
    T_cam_world = T_CAM_HILL @ make_transform(R, np.zeros(3))
    parts: list[RectangleMeasurement] = []
    for T_model_rect in RECTANGLES:
        error = np.zeros(6) if rng is None else rng.normal(size=6) * SD
        off = make_transform(exp_rotation(error[3:]), error[:3])
        T_cam_rect = state.T_cam_model(T_cam_world, R) @ T_model_rect @ off
        known = np.ones(6, dtype=bool)
        parts.append(
            RectangleMeasurement(T_model_rect, T_cam_rect, known, np.diag(SD**2), T_CAM_HILL, R)
        )
    return TimedMeasurements(time_s, tuple(parts))


def arc_of(start: NavigationState, frames: int, seed: int | None) -> list[Timed]:
    rng = None if seed is None else np.random.default_rng(seed)
    state, arc = start, []
    for k in range(frames):
        arc.append(measured(state, 0.5 * k, rng))
        state, _, _ = MODEL.propagate(state, 0.5 * k, 0.5)
    return arc


def rough(seed: int) -> NavigationState:
    """A guess like that of the first sightings: rates and pose off, mass as in the prior."""
    error = np.random.default_rng(1000 + seed).normal(size=STATE_SIZE)
    sd = np.concatenate(
        [np.full(3, 0.2), np.full(3, 0.1), COM_SD, np.full(3, 0.1), np.full(3, 0.03), np.ones(5)]
    )
    error[INERTIA_RATIOS] = np.linalg.cholesky(INERTIA_PRIOR) @ error[INERTIA_RATIOS]
    return TRUTH.retract(error * sd)


INERTIA_PRIOR = parameter_covariance(TRUTH.inertia_ratios, RATIO_SD)
PRIOR = start_covariance(TRUTH.omega_body, np.diag(COM_SD**2), INERTIA_PRIOR)


def test_a_noiseless_arc_gives_the_truth_back() -> None:
    arc = arc_of(TRUTH, 24, None)
    off = np.zeros(STATE_SIZE)
    off[[0, 1, 2, 9, 10, 11, 12, 13, 14]] = [0.3, -0.2, 0.4, 0.1, -0.15, 0.1, 0.03, 0.02, -0.04]
    # The mass properties of the guess are right, and what is wrong hardly pulls in this prior.
    fit = fit_arc(MODEL, TRUTH.retract(off), 100.0 * PRIOR, arc)
    assert fit.converged
    assert fit.dof == 24 * 12
    assert fit.chi_square < 0.01
    state = TRUTH
    for k in range(24):
        fitted = picked(fit.path, k)
        assert np.max(np.abs(state.local(fitted)) / np.sqrt(np.diag(fit.covariance))) < 0.05
        state, _, _ = MODEL.propagate(state, 0.5 * k, 0.5)


def test_errors_are_those_the_covariance_states() -> None:
    runs = 24
    last, chi_square = np.empty(runs), np.empty(runs)
    end = TRUTH
    for k in range(11):
        end, _, _ = MODEL.propagate(end, 0.5 * k, 0.5)
    # Truth varies about the guess as the prior says where the prior decides (mass properties).
    for run in range(runs):
        guess = rough(run)
        fit = fit_arc(MODEL, guess, PRIOR, arc_of(TRUTH, 12, run))
        assert fit.converged
        error = fit.last.local(end)
        last[run] = error @ np.linalg.solve(fit.covariance, error)
        chi_square[run] = fit.chi_square
    # Guesses scatter less than the loose parts of the prior; those carry no weight anyway.
    low, high = (float(chi2.ppf(p, runs * STATE_SIZE)) / runs for p in (1e-4, 1 - 1e-4))
    assert 0.9 * low < last.mean() < 1.05 * high
    # Of the residuals; the 8 terms of the mass properties' prior come on top.
    expected = 12 * 12 - STATE_SIZE + 8
    tolerance = 4.0 * np.sqrt(2.0 * expected / runs) + 4.0
    assert chi_square.mean() == pytest.approx(expected, abs=tolerance)


def test_fit_is_the_filter_where_everything_is_linear() -> None:
    # Small errors, so that nothing bends: batch and recursive least squares are one.
    sd = np.concatenate([np.full(3, 1e-3), np.full(3, 1e-4), np.full(3, 1e-3), np.full(3, 1e-4)])
    sd = np.concatenate([sd, np.full(3, 1e-5), np.full(5, 1e-3)])
    P = np.diag(sd**2)
    guess = TRUTH.retract(0.5 * sd * np.random.default_rng(7).normal(size=STATE_SIZE))
    arc = arc_of(TRUTH, 8, 3)
    fit = fit_arc(MODEL, guess, P, arc)
    kalman = ErrorStateFilter(guess, P, gate_probability=1.0 - 1e-12)
    for k, timed in enumerate(arc):
        if k:
            kalman.predict(MODEL, arc[k - 1].time_s, 0.5)
        assert all(kalman.update(timed.measurements).accepted)
    deviation = kalman.state.local(fit.last) / np.sqrt(np.diag(fit.covariance))
    assert np.max(np.abs(deviation)) < 0.02
    np.testing.assert_allclose(
        np.diag(kalman.covariance), np.diag(fit.covariance), rtol=5e-3, atol=0.0
    )


def test_covariance_does_not_depend_on_where_the_fit_began() -> None:
    # An attitude error is one at the fitted state, however far that was from the guess.
    arc = arc_of(TRUTH, 10, 2)
    off = np.zeros(STATE_SIZE)
    off[9:12] = [0.3, -0.3, 0.3]
    near, far = (
        fit_arc(MODEL, TRUTH.retract(share * off), PRIOR, arc).covariance for share in (0.0, 1.0)
    )
    scale = np.sqrt(np.outer(np.diag(near), np.diag(near)))
    np.testing.assert_allclose(far / scale, near / scale, atol=0.02)


@dataclass(frozen=True)
class Position:
    """r_hill itself."""

    z: FloatArray

    @property
    def covariance(self) -> FloatArray:
        return 0.01**2 * np.eye(3)

    def residual(self, state: NavigationState) -> FloatArray:
        return np.asarray(self.z - state.r_hill)

    def jacobian(self, state: NavigationState) -> FloatArray:
        return np.eye(3, STATE_SIZE)


def test_any_measurement_will_do_and_what_it_does_not_see_keeps_its_prior() -> None:
    arc = [TimedMeasurements(2.0, (Position(TRUTH.r_hill),))]
    fit = fit_arc(MODEL, TRUTH.retract(np.full(STATE_SIZE, 0.01)), PRIOR, arc)
    gain = 1.0 / (1.0 + 0.01**2 / 1.0**2)
    np.testing.assert_allclose(fit.first.r_hill, TRUTH.r_hill + 0.01 * (1 - gain), atol=1e-9)
    expected = np.diag(PRIOR).copy()
    expected[:3] = 1.0 / (1.0 / PRIOR[0, 0] + 1.0 / 0.01**2)
    np.testing.assert_allclose(np.diag(fit.covariance), expected, rtol=1e-8)
    assert len(fit.path.r_hill) == 1
