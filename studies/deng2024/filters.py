"""Figs. 2-6: the printed filter and pcnav's on the printed motions."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable, Propagation
from pcnav.core.arrays import FloatArray, picked
from pcnav.core.spatial import exp_rotation
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    OMEGA,
    SIZE,
    THETA,
    AttitudeSet,
    RotationState,
    TorqueFreeModel,
    printed_covariance,
)
from pcnav.estimators.image_motion.rates import continuous_xyzw
from pcnav.evaluation.consistency import squared_normalised_errors
from pcnav.evaluation.observability.reported import ROTATION
from pcnav.files.text_table import TextTable
from pcnav.filtering.batched_filter import Together
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.report.panels import panels_figure

from ..folder import StudyFigure
from ..panels import component_panels
from ..tables import table, table_of
from . import paper
from .paper import Body, Motion

RATIO_NAMES = ROTATION.names[INERTIA]
GUESS = AttitudeInertiaTable(
    rate_deg_s=paper.GUESS_RATE_DEG_S,
    rate_sd_deg_s=5.0,
    inertia_ratios_zz=paper.GUESS_RATIOS,
    inertia_ratio_sd=0.4,
    attitude_sd_deg=paper.ATTITUDE_SD_DEG,
    angular_acceleration_psd_rad2_s3=0.0,
)
"""The printed first guess; its uncertainty is not printed."""
_TAKE_ALL = 1.0 - 1e-15
"""The paper has no gate."""
_DEGREES = float(np.degrees(1.0))


@dataclass(frozen=True)
class Estimates:
    """Of runs in step along a motion, the first attitude included."""

    name: str
    motion: Motion
    state: RotationState
    """(n, runs)"""
    covariance: FloatArray
    """(n, runs, 11, 11)"""

    @staticmethod
    def of(
        name: str, motion: Motion, found: Sequence[tuple[RotationState, FloatArray]]
    ) -> "Estimates":
        """From states and covariances at every time, of runs or of one without an axis of its."""
        parts = ((s.R_world_body, s.omega_body, s.parameters, P) for s, P in found)
        R, omega, parameters, P = (np.stack(each) for each in zip(*parts, strict=True))
        if omega.ndim == 2:
            R, omega, parameters, P = R[:, None], omega[:, None], parameters[:, None], P[:, None]
        return Estimates(name, motion, RotationState(R, omega, parameters), P)

    @property
    def _truth(self) -> RotationState:
        return picked(self.motion.truth, np.arange(len(self.motion.times_s))[:, None])

    @property
    def errors(self) -> FloatArray:
        """(n, runs, 11) estimate to truth: attitude (rad), rate (rad/s), printed ratios."""
        return self.state.printed_error(self._truth)

    @property
    def sd(self) -> FloatArray:
        """(n, runs, 11) as stated, likewise."""
        spread = printed_covariance(self.state, self.covariance)
        return np.sqrt(np.maximum(np.diagonal(spread, axis1=-2, axis2=-1), 0.0))

    @property
    def nees(self) -> FloatArray:
        """(n, runs) of all eleven states."""
        error = self.state.local(self._truth)
        P = self.covariance.reshape(-1, SIZE, SIZE)
        return squared_normalised_errors(error.reshape(-1, SIZE), P).reshape(error.shape[:2])

    def rms(self, block: slice) -> float:
        """Of the error's components over the second half of the run."""
        late = self.errors[len(self.errors) // 2 :, :, block]
        return float(np.sqrt(np.mean(late**2)))


def measured(motion: Motion, half_angle_sd: float, seed: int) -> FloatArray:
    """(n, 3, 3) attitudes with errors about the body axes."""
    rng = np.random.default_rng(seed)
    errors = 2.0 * half_angle_sd * rng.standard_normal((len(motion.times_s), 3))
    # The first attitude defines the body axes and holds no error.
    errors[0] = 0.0
    return np.asarray(motion.truth.R_world_body @ exp_rotation(errors))


def printed_run(name: str, motion: Motion, attitudes: FloatArray) -> Estimates:
    """The filter of (36): Euler steps, one linearisation, Q and R as printed."""
    noise = 4.0 * paper.PRINTED_VARIANCE * np.eye(3)
    covariance = np.zeros((SIZE, SIZE))
    covariance[THETA, THETA] = noise
    covariance[OMEGA, OMEGA] = np.radians(GUESS.rate_sd_deg_s) ** 2 * np.eye(3)
    covariance[INERTIA, INERTIA] = GUESS.inertia_ratio_sd**2 * np.eye(5)
    state = Body(paper.GUESS_RATIOS, paper.GUESS_RATE_DEG_S).state
    kalman = ErrorStateFilter(state, covariance, gate_probability=_TAKE_ALL, max_iterations=1)
    model = TorqueFreeModel(0.0, Propagation.EULER, paper.PRINTED_VARIANCE)
    found = [(kalman.state, kalman.covariance)]
    for k in range(1, len(motion.times_s)):
        before = float(motion.times_s[k - 1])
        kalman.predict(model, before, float(motion.times_s[k]) - before)
        kalman.update([Together(AttitudeSet(attitudes[k], noise))])
        found.append((kalman.state, kalman.covariance))
    return Estimates.of(name, motion, found)


def fitted_run(name: str, motion: Motion, attitudes: FloatArray) -> Estimates:
    """pcnav's estimator from the printed guess, with the same R."""
    estimator = AttitudeInertiaEstimator(GUESS)
    steps = zip(motion.times_s.tolist(), attitudes, strict=True)
    estimates = [estimator.step(time_s, R) for time_s, R in steps]
    return Estimates.of(name, motion, [(each.state, each.covariance) for each in estimates])


def filter_runs(motion: Motion) -> list[Estimates]:
    """The printed filter on exact attitudes, it and pcnav's on noisy ones."""
    exact = measured(motion, 0.0, seed=1)
    noisy = measured(motion, paper.HALF_ANGLE_SD_RAD, seed=1)
    return [
        printed_run("as printed, exact attitudes", motion, exact),
        printed_run("as printed, noise of R", motion, noisy),
        fitted_run("pcnav, noise of R", motion, noisy),
    ]


def filter_figures(runs: Sequence[Estimates]) -> list[StudyFigure]:
    """Figs. 2-5: attitudes, true and with the noise of R, then estimates of quaternion, rate and
    ratios; of all but the first their first tenth as well, in which they converge."""
    motion, q = runs[0].motion, ("q1", "q2", "q3", "q4")
    true_q = continuous_xyzw(motion.truth.R_world_body)
    noisy = continuous_xyzw(measured(motion, paper.HALF_ANGLE_SD_RAD, seed=1))
    quaternions = {run.name: continuous_xyzw(run.state.R_world_body[:, 0]) for run in runs}
    rates = {run.name: _DEGREES * run.state.omega_body[:, 0] for run in runs}
    rate_names = [f"rate {axis}, deg/s" for axis in "xyz"]
    true_rates = _DEGREES * motion.truth.omega_body
    return [
        *_figures("fig2a", motion, q, true_q, {})[:1],
        *_figures("fig2", motion, q, true_q, {"measured": noisy}),
        *_figures("fig3", motion, q, true_q, quaternions),
        *_figures("fig4", motion, rate_names, true_rates, rates),
        *ratio_figures("fig5", runs),
    ]


def ratio_figures(key: str, runs: Sequence[Estimates]) -> list[StudyFigure]:
    """Inertia ratios over time, and over its first tenth."""
    motion = runs[0].motion
    found = {run.name: run.state.printed_ratios[:, 0] for run in runs}
    return _figures(key, motion, RATIO_NAMES, motion.truth.printed_ratios, found)


def _figures(
    key: str,
    motion: Motion,
    labels: Sequence[str],
    truth: FloatArray,
    found: Mapping[str, FloatArray],
) -> list[StudyFigure]:
    """The whole run, and its first tenth."""
    figures = []
    for name, end in ((key, len(motion.times_s)), (f"{key}_start", len(motion.times_s) // 10 + 1)):
        shown = {what: values[:end] for what, values in found.items()}
        panels = component_panels(labels, truth[:end], shown)
        figures.append(StudyFigure(name, panels_figure(motion.times_s[:end], panels)))
    return figures


def error_table(runs: Sequence[Estimates]) -> TextTable:
    """What the states converge to in nutation."""
    return table_of(
        "fig3to5",
        runs,
        {
            "filter": lambda run: run.name,
            "paper": lambda run: "converge, the ratios last",
            "attitude RMS, deg": lambda run: _DEGREES * run.rms(THETA),
            "rate RMS, deg/s": lambda run: _DEGREES * run.rms(OMEGA),
            "ratios RMS": lambda run: run.rms(INERTIA),
            "largest of a ratio at the end": lambda run: np.abs(run.errors[-1, 0, INERTIA]).max(),
        },
        text_columns=2,
    )


def spin_table(runs: Sequence[Estimates]) -> TextTable:
    """Whether each ratio converges in a spin."""
    rows = []
    for run in runs:
        errors, sd = run.errors[-1, 0, INERTIA], run.sd[:, 0, INERTIA]
        for k, name in enumerate(RATIO_NAMES):
            verdict = "converges" if sd[-1, k] < 0.25 * sd[0, k] else "does not converge"
            rows.append((run.name, name, verdict, errors[k], sd[0, k], sd[-1, k]))
    header = ("filter", "ratio", "by its own sd", "error", "sd at the start", "sd at the end")
    return table("fig6", header, rows, text_columns=3)
