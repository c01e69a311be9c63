"""Prior of the target's mass when a track is initialised."""

from dataclasses import dataclass

import numpy as np

from pcnav.config.depth import FilterTable
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.inertia_parameters import (
    parameter_covariance,
    parameters_from_ratios,
    ratios_jacobian,
)
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, NavigationState
from pcnav.recordings.sequence import InitialPrior
from pcnav.target.satellite import Target


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

    @property
    def prior(self) -> PriorMass:
        """The covariances at the edges, of the ratios."""
        to_ratios = ratios_jacobian(parameters_from_ratios(self.inertia_ratios))
        return PriorMass(
            self.com_covariance_m2, to_ratios @ self.parameter_covariance @ to_ratios.T
        )


def prior_belief(
    target: Target, initial: InitialPrior | None, filtering: FilterTable
) -> MassBelief:
    """From the sequence or else the target; spreads from the pipeline file before either."""
    com, ratios = target.com_model, target.inertia_ratios
    com_sd = np.full(3, filtering.com_sd_m or target.com_sd_m)
    ratio_sd = np.full(5, filtering.inertia_ratio_sd or target.inertia_ratio_sd)
    if initial is not None:
        if initial.com_model_m is not None:
            com = np.array(initial.com_model_m)
        if initial.inertia_ratios is not None:
            ratios = np.array(initial.inertia_ratios)
        if initial.com_sd_m is not None and not filtering.com_sd_m:
            com_sd = np.array(initial.com_sd_m)
        if initial.inertia_ratios_sd is not None and not filtering.inertia_ratio_sd:
            ratio_sd = np.array(initial.inertia_ratios_sd)
    return MassBelief(com, np.diag(com_sd**2), ratios, parameter_covariance(ratios, ratio_sd))


def learnt_belief(state: NavigationState, covariance: FloatArray) -> MassBelief:
    """What a filter has learnt: the mass stays as it is when the motion is lost."""
    return MassBelief(
        state.com_model,
        covariance[COM_MODEL, COM_MODEL],
        state.inertia_ratios,
        covariance[INERTIA_RATIOS, INERTIA_RATIOS],
    )
