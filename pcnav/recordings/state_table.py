"""The columns truth.csv and states.csv share, and the state they stand for."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import rotation_from_xyzw, xyzw_from_rotation
from pcnav.dynamics.state import NavigationState

STATE_COLUMNS = (
    *("time_s", "r_x_m", "r_y_m", "r_z_m", "v_x_m_s", "v_y_m_s", "v_z_m_s"),
    *("q_x", "q_y", "q_z", "q_w", "w_x_rad_s", "w_y_rad_s", "w_z_rad_s"),
    *("com_x_m", "com_y_m", "com_z_m", "i_yy", "i_zz", "i_xy", "i_xz", "i_yz"),
)
"""Names of the 22 columns in file order; q is R_world_body, scalar last."""


def state_row(time_s: float, state: NavigationState) -> FloatArray:
    """(22,) numbers of a row, in the order of `STATE_COLUMNS`."""
    quaternion_xyzw = xyzw_from_rotation(state.R_world_body)
    parts = (state.r_hill, state.v_hill, quaternion_xyzw, state.omega_body)
    return np.concatenate([[time_s], *parts, state.com_model, state.inertia_ratios])


def states_from_rows(rows: FloatArray) -> tuple[FloatArray, NavigationState]:
    """(n,) times and a state whose fields are batched over n, from (n, 22) rows."""
    state = NavigationState(
        r_hill=rows[:, 1:4],
        v_hill=rows[:, 4:7],
        com_model=rows[:, 14:17],
        R_world_body=rotation_from_xyzw(rows[:, 7:11]),
        omega_body=rows[:, 11:14],
        inertia_ratios=rows[:, 17:22],
    )
    return rows[:, 0], state
