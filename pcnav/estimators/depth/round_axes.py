"""Body axes of a target of which no turn about an axis is ever seen.

Where such a target's axes point, about that axis, is a matter of choice: an estimate and the same
one turned say the same of every frame, and the prior of the mass is that of the shape. So the
choice is made anew in each frame, as the estimate has it, and no error is left in that direction.
Left in the covariance, it would grow with the rate about the axis, which may be anything, and a
linear filter cannot follow an angle that may be anything: rate, mass centre and inertia, which are
told in these axes, would seem to turn with it in a straight line.

An error e of a state becomes ``e - g (a . theta)``, with g what a turn of the axes by one radian
about a makes of all that is told in them: in a symmetry's tangent (the gauge of Barfoot 2017, 6.3).
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.inertia_parameters import inertia_of, parameters_from_ratios
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    STATE_SIZE,
    THETA_BODY,
    NavigationState,
)
from pcnav.filtering.error_state import MotionModel
from pcnav.target.roundness import Roundness

_KEPT = 1e-2
"""Share of the error about the axes that stays: a covariance without it could not be inverted."""
_ANY_TURN_VARIANCE = np.pi**2 / 3.0
"""Of an angle that may be anything, rad^2."""


@dataclass(frozen=True)
class RoundAxes:
    """The choice of body axes of a round target."""

    roundness: Roundness

    def chosen(self, state: NavigationState) -> FloatArray:
        """(20, 20) by which errors of a state become those in the axes that it chooses."""
        chosen = np.eye(STATE_SIZE)
        for axis in self.roundness.axes_model:
            chosen[:, THETA_BODY] -= (1.0 - _KEPT) * np.outer(self._turning(state, axis), axis)
        return chosen

    def prior(self, covariance: FloatArray) -> FloatArray:
        """(20, 20) of a first state whose axes are chosen as it has them."""
        kept = np.eye(STATE_SIZE)
        for axis in self.roundness.axes_model:
            kept[THETA_BODY, THETA_BODY] -= (1.0 - _KEPT) * np.outer(axis, axis)
        return np.asarray(kept @ covariance @ kept.T)

    def reported(self, covariance: FloatArray) -> FloatArray:
        """(20, 20) with what nobody knows: where the body is, about its axes."""
        axes = self.roundness.axes_model
        reported = covariance.copy()
        reported[THETA_BODY, THETA_BODY] += _ANY_TURN_VARIANCE * axes.T @ axes
        return reported

    def _turning(self, state: NavigationState, axis: FloatArray) -> FloatArray:
        """(20,) of a state's error when its axes are turned about one of them, per radian."""
        inertia = inertia_of(parameters_from_ratios(state.inertia_ratios))
        turning = np.zeros(STATE_SIZE)
        turning[THETA_BODY] = axis
        turning[OMEGA_BODY] = -np.cross(axis, state.omega_body)
        turning[COM_MODEL] = -np.cross(axis, state.com_model - self.roundness.point_model)
        change = inertia @ skew(axis) - skew(axis) @ inertia
        turning[INERTIA_RATIOS] = change[(1, 2, 0, 0, 1), (1, 2, 1, 2, 2)]
        return turning


@dataclass(frozen=True)
class InChosenAxes(MotionModel[NavigationState]):
    """A motion whose state is told in axes that are chosen anew after each step."""

    motion: MotionModel[NavigationState]
    axes: RoundAxes

    def propagate(
        self, state: NavigationState, time_s: float, step_s: float
    ) -> tuple[NavigationState, FloatArray, FloatArray]:
        """See `MotionModel.propagate`."""
        moved, transition, noise = self.motion.propagate(state, time_s, step_s)
        chosen = self.axes.chosen(moved)
        return moved, chosen @ transition, chosen @ noise @ chosen.T
