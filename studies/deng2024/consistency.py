"""Whether the filter's covariance tells its errors: many runs in step."""

from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import run_seed
from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.inertia_parameters import shares
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator, initial_belief
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    RotationState,
    printed_covariance,
)

from .paper import Motion

_SETTLED_FROM_S = 60.0
"""The printed nutation turns once in some 55 s."""
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Case:
    """Runs that differ in noise and first guess."""

    name: str
    motion: Motion
    rate_sd_deg_s: float
    ratio_sd: float
    """Of the first guess about the truth, and of the prior."""
    attitude_sd_deg: float
    whole_arc_start: bool
    runs: int

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True)
class CaseResult:
    """What the runs of a case did."""

    case: Case
    nees: FloatArray
    """(n, runs) of all eleven states."""
    errors: FloatArray
    """(n, runs, 11) in printed terms."""
    sd: FloatArray
    """(n, runs, 11)"""

    @property
    def settled_from_s(self) -> float:
        """From when on the runs are judged."""
        return min(_SETTLED_FROM_S, 0.3 * float(self.case.motion.times_s[-1]))

    @property
    def mean_nees(self) -> FloatArray:
        """(n,) over the runs and the states: 1 when the covariance is right."""
        return np.asarray(np.mean(self.nees, axis=1) / SIZE)

    @property
    def bounds(self) -> tuple[float, float]:
        """95 % of `mean_nees` if the covariance is right."""
        runs = self.nees.shape[1]
        tail = 0.5 * (1.0 - CONFIDENCE)
        low, high = chi_square.quantile([tail, 1.0 - tail], SIZE * runs) / (SIZE * runs)
        return float(low), float(high)

    def share_inside(self, from_s: float) -> float:
        """Share of the times from one on at which the mean is inside its bounds."""
        low, high = self.bounds
        late = self.mean_nees[self.case.motion.times_s >= from_s]
        return float(np.mean((late >= low) & (late <= high)))

    def over(self, from_s: float) -> float:
        """Mean over runs and times from one on."""
        return float(np.mean(self.mean_nees[self.case.motion.times_s >= from_s]))


def run_case(case: Case) -> CaseResult:
    """All runs of a case in step."""
    motion, rng = case.motion, np.random.default_rng(run_seed(f"deng2024 {case.motion.name}", 0))
    table = AttitudeInertiaTable(
        rate_deg_s=_triple(np.degrees(motion.omega_body[0])),
        rate_sd_deg_s=case.rate_sd_deg_s,
        inertia_ratios_zz=_quintuple(motion.ratios),
        inertia_ratio_sd=case.ratio_sd,
        attitude_sd_deg=case.attitude_sd_deg,
        angular_acceleration_psd_rad2_s3=0.0,
        # A gate would take away what NEES is to judge.
        gate_probability=1.0 - 1e-12,
    )
    guess = _guesses(table, case.runs, rng)
    estimator = AttitudeInertiaEstimator(table, whole_arc_start=case.whole_arc_start)
    sd_rad = np.radians(case.attitude_sd_deg)
    nees, errors, sd = [], [], []
    for k, time_s in enumerate(motion.times_s.tolist()):
        noise = exp_rotation(sd_rad * rng.standard_normal((case.runs, 3)))
        estimate = estimator.step(time_s, motion.R_world_body[k] @ noise, guess=guess)
        truth = _repeated(motion.truth(k), case.runs)
        error = estimate.state.local(truth)
        weighed = np.linalg.solve(estimate.covariance, error[..., None])[..., 0]
        nees.append(np.sum(error * weighed, axis=1))
        errors.append(estimate.state.printed_error(truth))
        spread = printed_covariance(estimate.state, estimate.covariance)
        sd.append(np.sqrt(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 0.0)))
    return CaseResult(case, np.array(nees), np.array(errors), np.array(sd))


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


def _repeated(state: RotationState, runs: int) -> RotationState:
    return RotationState(
        np.broadcast_to(state.R_world_body, (runs, 3, 3)),
        np.broadcast_to(state.omega_body, (runs, 3)),
        np.broadcast_to(state.parameters, (runs, 5)),
    )


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return (x, y, z)


def _quintuple(values: tuple[float, ...]) -> tuple[float, float, float, float, float]:
    a, b, c, d, e = values
    return (a, b, c, d, e)
