"""All measurements since the start of a track, fitted as one motion of a free body."""

import logging

from pcnav.config.depth import FilterTable
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.first_state import start_covariance
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.pose_measurement import PoseMeasurement, joined
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.filtering.least_squares import ArcGrowth
from pcnav.filtering.map_arc_fit import ArcError, ArcFit, TimedMeasurements, fit_arc

Timed = TimedMeasurements[NavigationState]
Fit = ArcFit[NavigationState]

_log = logging.getLogger("pcnav")

_FIRST_ARC, _ARC_GROWTH = 6, 1.12
LONGEST_ARC = 400
"""Frames after which the filter goes on alone: by then the inertia is known well enough."""
_MAX_ARC_CHI_SQUARE = 4.0
"""Per degree of freedom: a motion that fits its frames worse is not accepted."""


class InitialArc:
    """All measurements since the start, fitted as one while they are few."""

    def __init__(self, model: MassCentreModel, guess: NavigationState, belief: MassBelief) -> None:
        self._model, self._guess = model, guess
        self._prior = start_covariance(
            guess.omega_body, belief.com_covariance_m2, belief.parameter_covariance
        )
        self._start: NavigationState | None = None
        self._growth = ArcGrowth(_FIRST_ARC, _ARC_GROWTH, LONGEST_ARC)
        self.frames: list[Timed] = []

    def fit(self) -> Fit | None:
        """The state that fits the arc; None where no fit is found or accepted."""
        try:
            fit = fit_arc(self._model, self._guess, self._prior, self.frames, self._start)
        except ArcError as error:
            _log.info("%s", error)
            return None
        if not fit.converged:
            return None
        self._start = fit.states[0]
        return fit if fit.chi_square < _MAX_ARC_CHI_SQUARE * fit.dof else None

    def extend(self, timed: Timed) -> Fit | None:
        """Add a frame as `condensed` has it; a fit of the whole when it is time for one."""
        self.frames.append(timed)
        return self.fit() if self._growth.is_due(len(self.frames)) else None

    @property
    def is_over(self) -> bool:
        """Whether the arc is too long to go on with."""
        return self._growth.is_over(len(self.frames))


def filter_from(fit: Fit, table: FilterTable) -> Kalman:
    """A filter that goes on from the end of a fitted arc."""
    return ErrorStateFilter(
        fit.states[-1],
        fit.covariance,
        gate_probability=table.gate_probability,
        max_iterations=table.iterations,
    )


def condensed(timed: Timed) -> Timed:
    """The same in as few measurements as possible: an arc is gone through many times."""
    faces = [m for m in timed.measurements if isinstance(m, PoseMeasurement)]
    if not faces or len(faces) < len(timed.measurements):
        return timed
    return TimedMeasurements(timed.time_s, (joined(faces),))
