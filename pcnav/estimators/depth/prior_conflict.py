"""Whether the frames contradict what was stated of the mass.

A fit pulls the mass towards its prior and away from where the frames have it. How far it still is
from the prior's mean, in the prior's own deviations, is then a chi-square at most, of as many
degrees of freedom as the prior has components. One that is next to impossible says that whoever
stated the deviations knew less than that: what is left is what the shape says, which holds any
body. Where nobody stated any, it is not the mass that the frames contradict.
"""

from dataclasses import replace

import numpy as np

from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS

_POSSIBLE = 0.9999
"""A chi-square beyond this share of its distribution is a contradiction."""


def contradiction(belief: MassBelief, error: FloatArray) -> tuple[MassBelief, str] | None:
    """The belief widened where an arc contradicts it, and a sentence that says so; None for none.

    ``error`` (20,) takes the belief's mass to the one that fits the arc.
    """
    untold = belief.untold
    if untold is None:
        return None
    wider, said = belief, list[str]()
    com, open_com = belief.com_covariance_m2, untold.com_covariance_m2
    squared = _squared(error[COM_MODEL], com)
    if com is not open_com and squared > chi_square.quantile(_POSSIBLE, 3):
        wider = replace(wider, com_covariance_m2=open_com)
        said.append(f"mass centre (chi-square {squared:.0f} of 3)")
    inertia, open_inertia = belief.parameter_covariance, untold.parameter_covariance
    squared = _squared(error[INERTIA_RATIOS], inertia)
    if inertia is not open_inertia and squared > chi_square.quantile(_POSSIBLE, 5):
        wider = replace(wider, parameter_covariance=open_inertia)
        said.append(f"inertia (chi-square {squared:.0f} of 5)")
    if not said:
        return None
    what = " and the ".join(said)
    return wider, f"the frames contradict the stated {what}: any that the shape can have is taken"


def _squared(error: FloatArray, covariance: FloatArray) -> float:
    return float(error @ np.linalg.solve(covariance, error))
