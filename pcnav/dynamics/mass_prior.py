"""What is believed of a target's mass: before the first frame, or as a filter has learnt it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.inertia_parameters import (
    parameter_covariance,
    parameters_from_ratios,
    ratios_jacobian,
)

Deviation = FloatArray | Sequence[float] | float | None


@dataclass(frozen=True)
class PriorMass:
    """Covariances of the mass centre and of the inertia ratios that a filter was started with."""

    com_covariance_m2: FloatArray
    """(3, 3) of the mass centre in the model frame, m^2."""
    ratio_covariance: FloatArray
    """(5, 5) of Iyy, Izz, Ixy, Ixz, Iyz over Ixx."""

    @property
    def sd(self) -> tuple[FloatArray, FloatArray]:
        """Standard deviations (3,), m, and (5,)."""
        return np.sqrt(np.diag(self.com_covariance_m2)), np.sqrt(np.diag(self.ratio_covariance))


@dataclass(frozen=True)
class MassBelief:
    """Mass centre and inertia ratios with their covariances."""

    com_model: FloatArray
    """(3,) m."""
    com_covariance_m2: FloatArray
    """(3, 3) m^2."""
    inertia_ratios: FloatArray
    """(5,)"""
    parameter_covariance: FloatArray
    """(5, 5) of the parameters of `pcnav.dynamics.inertia_parameters`."""
    untold: "MassBelief | None" = None
    """The same without the deviations that somebody stated; None where nobody did."""

    @property
    def prior(self) -> PriorMass:
        """The covariances at the edges, of the ratios."""
        to_ratios = ratios_jacobian(parameters_from_ratios(self.inertia_ratios))
        return PriorMass(
            self.com_covariance_m2, to_ratios @ self.parameter_covariance @ to_ratios.T
        )

    def about(
        self, com_model: FloatArray | None = None, ratios: FloatArray | None = None
    ) -> "MassBelief":
        """The same spread seen from another mass centre (3,) or other ratios (5,).

        Whoever states them without a deviation may err by as much as the two differ. Raises
        `ValueError` for ratios whose trace is not positive.
        """
        com = self.com_model if com_model is None else com_model
        told = self.inertia_ratios if ratios is None else ratios
        shift = com - self.com_model
        change = parameters_from_ratios(told) - parameters_from_ratios(self.inertia_ratios)
        return MassBelief(
            com,
            self.com_covariance_m2 + np.outer(shift, shift),
            told,
            self.parameter_covariance + np.outer(change, change),
            None if self.untold is None else self.untold.about(com_model, ratios),
        )

    def told(self, com_sd_m: Deviation, ratios_sd: Deviation) -> "MassBelief":
        """With standard deviations of the mass centre, m, and of the ratios: one for all or one for
        each; None leaves the spread as it is.

        Raises `ValueError` for deviations of ratios that no body can have.
        """
        com, inertia = self.com_covariance_m2, self.parameter_covariance
        if com_sd_m is not None:
            com = np.eye(3) * np.square(com_sd_m)
        if ratios_sd is not None:
            inertia = parameter_covariance(self.inertia_ratios, np.broadcast_to(ratios_sd, 5))
        if com_sd_m is None and ratios_sd is None:
            return self
        return MassBelief(self.com_model, com, self.inertia_ratios, inertia, self.untold or self)

    def scaled(self, factor: float) -> "MassBelief":
        """Of the same target, larger by a factor about the model's origin."""
        return MassBelief(
            factor * self.com_model,
            factor**2 * self.com_covariance_m2,
            self.inertia_ratios,
            self.parameter_covariance,
            None if self.untold is None else self.untold.scaled(factor),
        )
