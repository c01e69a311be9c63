"""Whether the filter's covariance tells its errors: many runs in step."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.monte_carlo import run_seed
from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.core.statistics import MeanSquared, mean_squared
from pcnav.dynamics.inertia_parameters import shares
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator, initial_belief
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA, SIZE, RotationState
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Panel, Scale, panels_figure

from ..folder import StudyFigure
from ..panels import curves_of
from ..tables import table_of
from . import paper
from .filters import Estimates
from .observability import SENSOR
from .paper import Motion

_SETTLED_FROM_S = 60.0
"""The printed nutation turns once in some 55 s."""


@dataclass(frozen=True)
class Case:
    """Runs that differ in noise and first guess."""

    name: str
    motion: Motion
    rate_sd_deg_s: float
    ratio_sd: float
    """Of the first guess about the truth, and of the prior."""
    whole_arc_start: bool
    runs: int

    def __str__(self) -> str:
        return self.name

    @property
    def prior(self) -> AttitudeInertiaTable:
        """What is known before the first attitude."""
        return SENSOR.model_copy(
            update={"rate_sd_deg_s": self.rate_sd_deg_s, "inertia_ratio_sd": self.ratio_sd}
        )


def monte_carlo_cases(runs: int, duration_s: float) -> list[Case]:
    """Nutation with a narrow and a wide prior, the filter from the guess, and the spin."""
    nutation, spin = paper.nutation(duration_s, 1.0), paper.spin(duration_s, 1.0)
    return [
        Case("nutation, ratios known to 0.05", nutation, 1.0, 0.05, True, runs),
        Case("nutation, ratios known to 0.3", nutation, 5.0, 0.3, True, runs),
        Case("spin, ratios known to 0.1", spin, 1.0, 0.1, True, runs),
        Case("nutation, known to 0.05, filter alone", nutation, 1.0, 0.05, False, runs),
        Case("nutation, known to 0.3, filter alone", nutation, 5.0, 0.3, False, runs),
    ]


@dataclass(frozen=True)
class CaseResult:
    """What the runs of a case did."""

    case: Case
    found: Estimates
    judged: MeanSquared
    """(n,) NEES over the runs and the states."""

    @property
    def settled_from_s(self) -> float:
        """From when on the runs are judged."""
        return min(_SETTLED_FROM_S, 0.3 * float(self.case.motion.times_s[-1]))

    @property
    def settled(self) -> BoolArray:
        """(n,) the times at which the runs are judged."""
        return np.asarray(self.case.motion.times_s >= self.settled_from_s)

    @property
    def settled_nees(self) -> MeanSquared:
        """Mean over runs, states and settled times: 1 when the covariance is right. Its bounds are
        those of one time, see `mean_bounds`."""
        return replace(self.judged[0], mean=np.array(self.judged.mean[self.settled].mean()))

    @property
    def _half_width(self) -> float:
        """Of the 95 % bounds of the mean over time: from how the runs' own means scatter, since how
        far the errors of successive times are one error is not known."""
        of_run = self.found.nees[self.settled].mean(axis=0) / SIZE
        return float(1.96 * of_run.std(ddof=1) / np.sqrt(len(of_run)))

    @property
    def mean_bounds(self) -> str:
        """95 % of the mean over the settled times if the covariance is right."""
        return f"{1.0 - self._half_width:.3f} to {1.0 + self._half_width:.3f}"

    @property
    def is_inside(self) -> bool:
        """Whether it is inside them."""
        return bool(abs(self.settled_nees.mean - 1.0) <= self._half_width)

    @property
    def bounds(self) -> str:
        """95 % of the mean at one time if the covariance is right."""
        return f"{self.judged.lower[0]:.3f} to {self.judged.upper[0]:.3f}"


def run_case(case: Case) -> CaseResult:
    """All runs of a case in step."""
    motion, rng = case.motion, np.random.default_rng(run_seed(f"deng2024 {case.motion.name}", 0))
    # The truth is what the prior is about; a gate would take away what NEES is to judge.
    about_truth = {
        "rate_deg_s": motion.body.rate_deg_s,
        "inertia_ratios_zz": motion.body.ratios,
        "gate_probability": 1.0 - 1e-12,
    }
    table = case.prior.model_copy(update=about_truth)
    guess = _guesses(table, case.runs, rng)
    estimator = AttitudeInertiaEstimator(table, whole_arc_start=case.whole_arc_start)
    found = []
    for time_s, R in zip(motion.times_s.tolist(), motion.truth.R_world_body, strict=True):
        errors = np.radians(table.attitude_sd_deg) * rng.standard_normal((case.runs, 3))
        estimate = estimator.step(time_s, R @ exp_rotation(errors), guess=guess)
        found.append((estimate.state, estimate.covariance))
    estimates = Estimates.of(case.name, motion, found)
    return CaseResult(case, estimates, mean_squared(estimates.nees, SIZE, axis=1))


def _guesses(table: AttitudeInertiaTable, runs: int, rng: np.random.Generator) -> RotationState:
    """First guesses about the truth, as the prior has it; only bodies are drawn."""
    rate, parameters, covariance = initial_belief(table)
    root = np.linalg.cholesky(covariance[INERTIA, INERTIA])
    drawn: list[FloatArray] = []
    while len(drawn) < runs:
        guess = parameters + root @ rng.standard_normal(5)
        if shares(guess)[0][0] > 0.0:
            drawn.append(guess)
    rates = rate + np.radians(table.rate_sd_deg_s) * rng.standard_normal((runs, 3))
    return RotationState(np.tile(np.eye(3), (runs, 1, 1)), rates, np.array(drawn))


def nees_table(results: Sequence[CaseResult]) -> TextTable:
    """NEES of every case."""

    def inside(result: CaseResult) -> str:
        return f"{100.0 * np.mean(result.judged.inside[result.settled]):.0f} %"

    def start(result: CaseResult) -> str:
        whole = result.case.whole_arc_start
        return "whole arc, then filter" if whole else "filter from the guess"

    settled = f"from {results[0].settled_from_s:g} s on"
    return table_of(
        "nees",
        results,
        {
            "case": lambda r: r.case.name,
            "start": start,
            "mean, all times": lambda r: np.mean(r.judged.mean),
            f"mean {settled}": lambda r: r.settled_nees.mean,
            "95 % bounds of that mean": lambda r: r.mean_bounds,
            "95 % bounds of one time": lambda r: r.bounds,
            f"inside {settled}": inside,
            "largest median": lambda r: f"{np.median(r.found.nees, axis=1).max() / SIZE:.2f}",
        },
        text_columns=2,
    )


def nees_figure(results: Sequence[CaseResult]) -> StudyFigure:
    """NEES over time of the filters that fit."""
    fitted = {r.case.name: r.judged for r in results if r.case.whole_arc_start}
    bounds = results[0].judged
    panel = Panel(
        "NEES per state",
        curves_of({name: judged.mean for name, judged in fitted.items()}),
        Scale.FROM_ZERO,
        bands={"95 % bounds": (bounds.lower, bounds.upper)},
        base=1.0,
    )
    return StudyFigure("nees", panels_figure(results[0].case.motion.times_s, [panel], row_in=2.3))
