"""Whether a number is known from the data, from the prior, or not at all."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.blocks import ATTITUDE, RATE
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, R_HILL, V_HILL
from pcnav.evaluation.answer.derived import Values
from pcnav.evaluation.answer.model import Verdict
from pcnav.evaluation.information_gain import MAX_PRIOR_SHARE, StateGain, part_of_prior

MAX_ANGLE_SD_RAD = np.deg2rad(30.0)
"""A direction that uncertain says hardly more than none: one drawn at random has 57 deg."""
MAX_RATIO_SD = 0.3
"""The same of an inertia ratio, whose whole range is about one."""
_NO_PART = 1e-9
"""Of the prior's deviation: what moves a quantity by less is rounding."""


@dataclass(frozen=True)
class Sources:
    """Of the numbers of one estimate."""

    is_claimed: bool
    covariance: FloatArray | None
    """(n, n) of the state's error; None of an estimator that states none."""
    prior: PriorMass | None
    """Of the mass, before the first frame; None of an estimator without."""
    prior_sd: FloatArray | None = None
    """(n,) of one without: deviations that it was told; infinite where it was told nothing."""
    R_hill_body: FloatArray | None = None
    """(3, 3), of one with a prior."""
    omega_body: FloatArray | None = None
    """(3,), of one with a prior."""

    @staticmethod
    def of(
        values: Values,
        covariance: FloatArray | None,
        prior: PriorMass | None,
        R_hill_world: FloatArray | None,
        is_claimed: bool,
        prior_sd: FloatArray | None = None,
    ) -> "Sources":
        """Of the values of an estimate, at whose time the Hill frame stands so."""
        if prior is None or R_hill_world is None:
            return Sources(is_claimed, covariance, None, prior_sd)
        R_hill_body = R_hill_world @ values[ATTITUDE.name]
        return Sources(is_claimed, covariance, prior, None, R_hill_body, values[RATE.name])

    def verdict(self, weights: FloatArray, max_sd: float = np.inf) -> Verdict:
        """Of the combination of the state's errors with weights (n,).

        A deviation above ``max_sd`` says nothing.
        """
        if not self.is_claimed:
            return Verdict.NOT
        if self.covariance is None:
            return Verdict.DATA
        variance = float(weights @ self.covariance @ weights)
        if variance > max_sd**2:
            return Verdict.NOT
        return Verdict.PRIOR if self._is_from_prior(weights, variance) else Verdict.DATA

    def _is_from_prior(self, weights: FloatArray, variance: float) -> bool:
        if self.prior is None or self.covariance is None:
            # What such an estimator holds fixed it was given.
            return variance == 0.0 or variance > MAX_PRIOR_SHARE * self._told_variance(weights)
        share = float(weights @ part_of_prior(self.prior, self.covariance) @ weights)
        share = min(share / max(variance, np.finfo(np.float64).tiny), 1.0)
        prior_sd = self._prior_sd(weights, self.prior)
        return not StateGain("", "", prior_sd, np.sqrt(variance), share).known

    def _told_variance(self, weights: FloatArray) -> float:
        if self.prior_sd is None:
            return np.inf
        told = weights != 0.0
        return float(np.sum((weights[told] * self.prior_sd[told]) ** 2))

    def _prior_sd(self, weights: FloatArray, prior: PriorMass) -> float:
        """What the prior leaves when the motion of the model's origin is seen.

        At a given motion of the origin, an error of the mass centre is one of position and
        velocity as well: ``r = p + R com``, ``v = p' + R (omega x com)``.
        """
        assert self.R_hill_body is not None and self.omega_body is not None
        R = self.R_hill_body
        by_com = weights[COM_MODEL] + R.T @ weights[R_HILL]
        by_com = by_com + (R @ skew(self.omega_body)).T @ weights[V_HILL]
        by_ratios = weights[INERTIA_RATIOS]
        parts = ((by_com, prior.com_covariance_m2), (by_ratios, prior.ratio_covariance))
        # What does not depend on the mass at all is seen as it is, without any prior.
        if all(np.abs(by).max() < _NO_PART for by, _ in parts):
            return np.inf
        return float(np.sqrt(sum(by @ P @ by for by, P in parts)))
