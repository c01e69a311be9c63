"""The columns truth.csv and states.csv share, and the state they stand for."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.state import NavigationState

STATE_COLUMNS = ("time_s", *MASS_CENTRE_LAYOUT.columns)
"""Names of the 22 columns in file order; q is R_world_body, scalar last."""


def state_row(time_s: float, state: NavigationState) -> FloatArray:
    """(22,) numbers of a row, in the order of `STATE_COLUMNS`."""
    quaternion_xyzw = xyzw_from_rotation(state.R_world_body)
    parts = (state.r_hill, state.v_hill, quaternion_xyzw, state.omega_body)
    return np.concatenate([[time_s], *parts, state.com_model, state.inertia_ratios])
