"""All measurements since the start of a track, fitted as one motion of a free body."""

import logging
from dataclasses import replace

from pcnav.config.depth import FilterTable
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.arc_of_poses import ArcOfPoses
from pcnav.estimators.depth.first_state import start_covariance
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.pose_measurement import PoseMeasurement, joined
from pcnav.estimators.depth.prior_conflict import contradiction
from pcnav.estimators.depth.round_axes import RoundAxes
from pcnav.filtering.error_state import ErrorStateFilter
from pcnav.filtering.least_squares import ArcGrowth
from pcnav.filtering.map_arc_fit import ArcError, ArcFit, TimedMeasurements, fit_arc

Timed = TimedMeasurements[NavigationState]
Fit = ArcFit[NavigationState]

_log = logging.getLogger("pcnav")

_FIRST_ARC, _ARC_GROWTH = 6, 1.25
_BENT_GROWTH, _BENT = 1.1, 0.5
"""... and while the `ArcFit.excess` of the last fit is more than this. A filter that goes on from a
bent arc takes it for straight: the more frames of that, the less it states."""
LONGEST_ARC = 400
"""Frames after which the filter goes on alone: by then the inertia is known well enough."""
_MAX_ARC_CHI_SQUARE = 4.0
"""Per degree of freedom: a motion that fits its frames worse is not accepted."""


class InitialArc:
    """All measurements since the start, fitted as one while they are few."""

    def __init__(
        self,
        model: MassCentreModel,
        guess: NavigationState,
        belief: MassBelief,
        axes: RoundAxes | None = None,
    ) -> None:
        """``guess`` has the mass of the belief, which gives way where the frames contradict it;
        ``axes`` are those of a round target."""
        self._model, self._guess, self.belief, self._axes = model, guess, belief, axes
        self.remark: str | None = None
        """That the frames contradict what was believed at first."""
        self._start: NavigationState | None = None
        self._growth = ArcGrowth(_FIRST_ARC, _ARC_GROWTH, LONGEST_ARC)
        self._bent_growth, self._is_bent = ArcGrowth(_FIRST_ARC, _BENT_GROWTH), False
        self.frames: list[Timed] = []

    def fit(self) -> Fit | None:
        """The state that fits the arc; None where no fit is found or accepted."""
        fit = self._fitted()
        if fit is None:
            return None
        against = contradiction(self.belief, fit.first_error)
        if against is not None:
            told = self.belief
            self.belief = against[0]
            wider = self._fitted()
            if wider is None or not wider.chi_square < _MAX_ARC_CHI_SQUARE * wider.dof:
                # It is not the mass that does not fit.
                self.belief = told
            else:
                fit, self.remark = wider, against[1]
                _log.warning("%s", self.remark)
        return fit if fit.chi_square < _MAX_ARC_CHI_SQUARE * fit.dof else None

    def _fitted(self) -> Fit | None:
        belief = self.belief
        prior = start_covariance(
            self._guess.omega_body, belief.com_covariance_m2, belief.parameter_covariance
        )
        if self._axes is not None:
            prior = self._axes.prior(prior)
        try:
            arc, seen = self.frames, ArcOfPoses.of(self.frames)
            # To second order all that is told in a round target's axes turns with the rate about
            # them, which may be anything: that part is of the axes, not of the motion.
            fit = fit_arc(
                *(self._model, self._guess, prior, arc, self._start, seen),
                bends=self._axes is None,
            )
        except ArcError as error:
            _log.info("%s", error)
            return None
        if not fit.converged:
            return None
        self._start, self._is_bent = fit.first, fit.excess > _BENT
        if self._axes is None:
            return fit
        chosen = self._axes.chosen(fit.last)
        return replace(fit, covariance=chosen @ fit.covariance @ chosen.T)

    def extend(self, timed: Timed) -> Fit | None:
        """Add a frame as `condensed` has it; a fit of the whole when it is time for one."""
        self.frames.append(timed)
        is_due, is_due_if_bent = (
            growth.is_due(len(self.frames)) for growth in (self._growth, self._bent_growth)
        )
        return self.fit() if is_due or (self._is_bent and is_due_if_bent) else None

    @property
    def is_over(self) -> bool:
        """Whether the arc is too long to go on with."""
        return self._growth.is_over(len(self.frames))


def filter_from(fit: Fit, table: FilterTable) -> Kalman:
    """A filter that goes on from the end of a fitted arc."""
    return ErrorStateFilter(
        fit.last,
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
