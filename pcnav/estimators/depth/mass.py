"""Prior of the target's mass when a track is initialised."""

import numpy as np

from pcnav.config.depth import FilterTable
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, NavigationState
from pcnav.recordings.sequence import InitialPrior
from pcnav.target.satellite import Target


def prior_belief(
    target: Target, initial: InitialPrior | None, filtering: FilterTable
) -> MassBelief:
    """From the sequence or else the target; spreads from the pipeline file before either.

    Raises `ValueError` for ratios that no body can have.
    """
    stated = initial or InitialPrior()
    com, ratios = (
        None if value is None else np.array(value)
        for value in (stated.com_model_m, stated.inertia_ratios)
    )
    ratios_sd = filtering.inertia_ratio_sd or stated.inertia_ratios_sd
    return target.mass.about(com, ratios).told(filtering.com_sd_m or stated.com_sd_m, ratios_sd)


def learnt_belief(state: NavigationState, covariance: FloatArray) -> MassBelief:
    """What a filter has learnt: the mass stays as it is when the motion is lost."""
    return MassBelief(
        state.com_model,
        covariance[COM_MODEL, COM_MODEL],
        state.inertia_ratios,
        covariance[INERTIA_RATIOS, INERTIA_RATIOS],
    )
