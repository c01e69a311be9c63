"""A filter pass about a trajectory that is already known well: the engine on deviations from it.

A filter that starts from nothing linearises where its first frames happen to put it. Where a
least-squares fit of all frames is at hand, deviations from the fitted trajectory are small and
linear from the first frame on, however wide the prior, and the pass adds what the fit leaves out:
process noise and gates.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.principal_axes.feature_measurements import FeatureView
from pcnav.estimators.principal_axes.feature_states import PrincipalState
from pcnav.filtering.error_state import ErrorStateFilter


@dataclass(frozen=True)
class Deviation:
    """An error of the trajectory, as a state of its own."""

    error: FloatArray
    """(n,)"""

    def retract(self, error: FloatArray) -> "Deviation":
        """Errors add: to first order about the trajectory."""
        return Deviation(self.error + error)

    @property
    def curved(self) -> slice:
        """See `ManifoldState`: nothing."""
        return slice(0, 0)

    def retraction_block(self, error: FloatArray) -> FloatArray:
        """See `ManifoldState`."""
        return np.empty((0, 0))

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """Any; the trajectory's own state sees to it in the end."""
        return error


@dataclass(frozen=True)
class Leg:
    """A part of the trajectory, and how deviations move along it: a `MotionModel`."""

    transition: FloatArray
    """(n, n)"""
    noise: FloatArray
    """(n, n)"""

    def propagate(
        self, state: Deviation, time_s: float, step_s: float
    ) -> tuple[Deviation, FloatArray, FloatArray]:
        """See `MotionModel.propagate`; whatever the times."""
        return Deviation(self.transition @ state.error), self.transition, self.noise


@dataclass(frozen=True)
class _LinearMeasurement:
    offset: FloatArray
    H: FloatArray
    covariance: FloatArray

    def residual(self, state: Deviation) -> FloatArray:
        return np.asarray(self.offset - self.H @ state.error)

    def jacobian(self, state: Deviation) -> FloatArray:
        return self.H


def filter_about(
    trajectory: Sequence[PrincipalState],
    legs: Sequence[Sequence[Leg]],
    views: Sequence[FeatureView],
    covariance: FloatArray,
    gate_probability: float,
) -> tuple[FloatArray, FloatArray]:
    """Deviation (n,) from the last state and its covariance (n, n), after all views.

    ``legs[k]`` lead from the state of view k to that of view k + 1. ``covariance`` is that of the
    first state's deviation, whose mean is zero.
    """
    start = Deviation(np.zeros(len(covariance)))
    kalman = ErrorStateFilter(
        start, covariance, gate_probability=gate_probability, max_iterations=1
    )
    for k, (state, view) in enumerate(zip(trajectory, views, strict=True)):
        if k > 0:
            for leg in legs[k - 1]:
                kalman.predict(leg, 0.0, 0.0)
        residual, jacobian = view.at(state)
        kalman.update(
            [
                _LinearMeasurement(r, H, view.covariance)
                for r, H in zip(residual, jacobian, strict=True)
            ]
        )
    return kalman.state.error, kalman.covariance
