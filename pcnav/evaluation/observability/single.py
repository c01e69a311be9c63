"""One state of a batch as the engine for one state sees it.

The bank's filters run as a batch (`pcnav.filtering.batched_filter`); the information of an arc is
asked of one of them, through the protocols of `pcnav.filtering.error_state`.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.inertia_bank.relative_state import (
    PixelMeasurements,
    RelativeMotion,
    RelativeStates,
)
from pcnav.filtering.error_state import Measurement, MotionModel


@dataclass(frozen=True)
class OneState:
    """A batch of one."""

    batch: RelativeStates
    """(1,)"""

    def retract(self, error: FloatArray) -> "OneState":
        """The state moved by an error (n,)."""
        return OneState(self.batch.retract(error[None]))

    def retraction_jacobian(self, error: FloatArray) -> FloatArray:
        """(n, n)"""
        jacobian = np.eye(len(error))
        curved = self.batch.curved
        jacobian[curved, curved] = self.batch.retraction_block(error[None])[0]
        return jacobian

    def admissible(self, error: FloatArray, covariance: FloatArray) -> FloatArray:
        """The error as it is."""
        return np.asarray(self.batch.admissible(error[None], covariance[None])[0])


@dataclass(frozen=True)
class OneMotion(MotionModel[OneState]):
    """The motion of a batch of one."""

    batch: RelativeMotion

    def propagate(
        self, state: OneState, time_s: float, step_s: float
    ) -> tuple[OneState, FloatArray, FloatArray]:
        """See `MotionModel.propagate`."""
        moved, transition, noise = self.batch.propagate(state.batch, time_s, step_s)
        return OneState(moved), transition[0], noise[0]


@dataclass(frozen=True)
class OneSight(Measurement[OneState]):
    """All points that one state saw at one time."""

    batch: PixelMeasurements

    @property
    def name(self) -> str:
        """What it is."""
        return "points"

    @property
    def covariance(self) -> FloatArray:
        """(3m, 3m) px^2."""
        variances = np.diagonal(self.batch.noise, axis1=1, axis2=2)
        return np.diag(variances.ravel())

    def residual(self, state: OneState) -> FloatArray:
        """(3m,) px."""
        return np.asarray(self.batch.residual(state.batch)[0].ravel())

    def jacobian(self, state: OneState) -> FloatArray:
        """(3m, n)"""
        jacobian = self.batch.jacobian(state.batch)[0]
        return np.asarray(jacobian.reshape(-1, jacobian.shape[-1]))
