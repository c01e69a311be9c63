"""Attitude, rate and inertia ratios of a free body from its attitudes alone (Deng 2024).

The paper starts an extended Kalman filter at a guess (36). While the inertia is hardly known that
filter drops terms larger than the noise, and becomes overconfident in a wrong inertia. So the
initial arc is fitted as one, again whenever it has grown by a seventh; the filter carries each fit
on to the next, and goes on alone once the inertia is known. States, frames and errors are those of
`pcnav.estimators.attitude_inertia.rotation_model`.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import BoolArray, FloatArray, chosen
from pcnav.core.errors import InputError
from pcnav.estimators.attitude_inertia.rotation_fit import AttitudeArc, RotationPrior, fit_rotations
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    OMEGA,
    SIZE,
    THETA,
    AttitudeSet,
    RotationState,
    TorqueFreeModel,
    parameters_from_printed,
    printed_ratios_jacobian,
)
from pcnav.filtering.batched_filter import BatchedFilter
from pcnav.filtering.least_squares import ArcGrowth

_FIRST_FIT, _GROWTH = 4, 1.15
LONGEST_ARC = 400
"""Attitudes after which the filter goes on alone at the latest: in a spin the inertia stays
unknown for good."""
_KNOWN_SD = 0.002
"""Of every inertia parameter: from there on the filter is linear enough."""


@dataclass(frozen=True)
class RotationEstimate:
    """The estimate after an attitude, of B runs."""

    time_s: float
    state: RotationState
    """(B,)"""
    covariance: FloatArray
    """(B, 11, 11) of its errors; `printed_covariance` turns them into those of (15)."""
    accepted: BoolArray
    """(B,) whether the attitude passed the gate."""
    nis: FloatArray
    """(B,) innovation squared over its covariance, 3 degrees of freedom; nan at the first."""


def initial_belief(table: AttitudeInertiaTable) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rate (3,), inertia parameters (5,) and covariance (11, 11) of a table; no attitude's."""
    rate = np.radians(np.array(table.rate_deg_s))
    parameters = parameters_from_printed(np.array(table.inertia_ratios_zz))
    covariance = np.zeros((SIZE, SIZE))
    covariance[OMEGA, OMEGA] = np.radians(table.rate_sd_deg_s) ** 2 * np.eye(3)
    root = table.inertia_ratio_sd * np.linalg.inv(printed_ratios_jacobian(parameters))
    covariance[INERTIA, INERTIA] = root @ root.T
    return rate, parameters, covariance


class AttitudeInertiaEstimator:
    """Takes in attitudes of B free bodies in order of time: one, or the runs of a study."""

    def __init__(self, table: AttitudeInertiaTable, *, whole_arc_start: bool = True) -> None:
        """``whole_arc_start`` False leaves out the fits and filters from the guess, as printed."""
        self._table, self._fits = table, whole_arc_start
        self._model = TorqueFreeModel(table.angular_acceleration_psd_rad2_s3, table.propagation)
        self._filter: BatchedFilter[RotationState] | None = None
        self._prior: RotationPrior | None = None
        self._fitted: RotationState | None = None
        self._times_s: list[float] = []
        self._seen: list[tuple[FloatArray, FloatArray]] = []
        self._growth = ArcGrowth(_FIRST_FIT, _GROWTH, LONGEST_ARC)

    def step(
        self,
        time_s: float,
        R_world_body: FloatArray,
        covariance: FloatArray | None = None,
        guess: RotationState | None = None,
    ) -> RotationEstimate:
        """Take in one attitude of each run.

        Args:
            time_s: later than the last.
            R_world_body: (3, 3), or (B, 3, 3) with the same B every time.
            covariance: (3, 3) of its error, ``R = R_true exp(error)``, body axes, rad^2; that of
                the table when none is given.
            guess: (B,) rates and inertia to begin from, in place of the table's; first time only.

        Raises `InputError` for a time that is not later or a covariance that is none.
        """
        self._check(time_s, covariance)
        measured = R_world_body.reshape(-1, 3, 3)
        noise = np.radians(self._table.attitude_sd_deg) ** 2 * np.eye(3)
        noise = noise if covariance is None else covariance
        if self._filter is None:
            return self._initialise(time_s, measured, noise, guess)
        before, self._times_s = self._times_s[-1], [*self._times_s, time_s]
        kalman = self._filter
        kalman.predict(self._model, before, time_s - before)
        result = kalman.update(AttitudeSet(measured, noise))
        accepted = result.accepted[:, 0]
        if self._fits:
            self._extend(kalman, measured, noise)
        return RotationEstimate(
            time_s, kalman.states, kalman.covariance, accepted, result.nis[:, 0]
        )

    def _check(self, time_s: float, covariance: FloatArray | None) -> None:
        where = f"attitude at {time_s:g} s"
        if self._times_s and not time_s > self._times_s[-1]:
            raise InputError(where, "time_s", f"expected more than {self._times_s[-1]:g}")
        if covariance is not None and not np.linalg.eigvalsh(covariance)[0] > 0.0:
            raise InputError(where, "covariance", "expected a positive definite matrix")

    def _initialise(
        self, time_s: float, measured: FloatArray, noise: FloatArray, guess: RotationState | None
    ) -> RotationEstimate:
        rate, parameters, covariance = initial_belief(self._table)
        covariance[THETA, THETA] = noise
        runs = len(measured)
        if guess is None:
            guess = RotationState(
                measured, np.tile(rate, (runs, 1)), np.tile(parameters, (runs, 1))
            )
        state = RotationState(measured, guess.omega_body, guess.parameters)
        table = self._table
        self._filter = BatchedFilter(
            state,
            np.tile(covariance, (runs, 1, 1)),
            gate_probability=table.gate_probability,
            max_iterations=table.max_iterations,
        )
        # The first attitude is the mean of the prior, and so no measurement of the arc.
        self._prior, self._fitted = RotationPrior(state, covariance), state
        self._times_s = [time_s]
        nothing = np.full(runs, np.nan)
        accepted = np.ones(runs, dtype=np.bool_)
        return RotationEstimate(time_s, state, self._filter.covariance, accepted, nothing)

    def _extend(
        self, kalman: BatchedFilter[RotationState], measured: FloatArray, noise: FloatArray
    ) -> None:
        """Keep the attitude; fit the whole arc when it is time for it."""
        assert self._prior is not None and self._fitted is not None
        self._seen.append((measured, noise))
        if not self._growth.is_due(len(self._seen)):
            return
        # The first time is the prior's; an attitude that says nothing keeps the arrays in step.
        blank = (self._prior.mean.R_world_body, 1e6 * np.eye(3))
        arc = AttitudeArc(
            np.array(self._times_s),
            np.stack([R for R, _ in (blank, *self._seen)]),
            np.stack([noise for _, noise in (blank, *self._seen)]),
        )
        fit = fit_rotations(self._model, self._prior, arc, self._fitted)
        good = fit.converged
        self._fitted = fit.start
        kalman.states = chosen(good, fit.end, kalman.states)
        kalman.covariance = np.where(good[:, None, None], fit.covariance, kalman.covariance)
        spread = np.sqrt(np.diagonal(kalman.covariance[:, INERTIA, INERTIA], axis1=-2, axis2=-1))
        if self._growth.is_over(len(self._seen)) or np.all(spread < _KNOWN_SD):
            self._fits = False
