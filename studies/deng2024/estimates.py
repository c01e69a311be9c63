"""What a filter made of a motion: its states and covariances beside the truth."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, picked
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    RotationState,
    printed_covariance,
)
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.evaluation.observability.told import ROTATION

from .paper import Motion

RATIO_NAMES = ROTATION.names[INERTIA]


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
