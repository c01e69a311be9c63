"""The 4-fold attitude ambiguity of a rectangle (Yu 2019, section 2.3, Figure 2).

Eigenvectors have no sign, so a rectangle looks the same after any of the four proper rotations
{I, 180 degrees about x, y, z} of its own frame. (The paper lists three case quaternions out of
order with their axes; enumerating the group needs no list.)
"""

from enum import StrEnum

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.target.satellite import Rectangle


class AxesCase(StrEnum):
    """The proper rotation that takes the measured rectangle frame to the catalogue's."""

    I = "I"  # noqa: E741 - the group's own name for the identity
    X = "X"
    Y = "Y"
    Z = "Z"


_ROTATIONS = {
    AxesCase.I: np.diag([1.0, 1.0, 1.0]),
    AxesCase.X: np.diag([1.0, -1.0, -1.0]),
    AxesCase.Y: np.diag([-1.0, 1.0, -1.0]),
    AxesCase.Z: np.diag([-1.0, -1.0, 1.0]),
}


def possible_cases(rectangle: Rectangle) -> tuple[AxesCase, ...]:
    """The cases a rectangle can be seen in.

    The measured normal faces the sensor. A face of a solid shows only its outside, which leaves
    I and Z; a sheet is seen from both sides, which leaves all four.
    """
    return tuple(AxesCase) if rectangle.two_sided else (AxesCase.I, AxesCase.Z)


def apply_case(T_cam_rect: FloatArray, case: AxesCase) -> FloatArray:
    """``T_cam_rect`` with its axes renamed by a case: (24) of Yu 2019."""
    turned = T_cam_rect.copy()
    turned[:3, :3] = T_cam_rect[:3, :3] @ _ROTATIONS[case]
    return turned


def resolve_case(
    R_cam_rect: FloatArray, R_cam_rect_predicted: FloatArray, rectangle: Rectangle
) -> tuple[AxesCase, float]:
    """The case nearest to the predicted attitude, and the scalar part of what then remains.

    Yu 2019 (22)-(25): the scalar part of the quaternion between prediction and measurement is
    near 1 for the right case and near 0 for the others.
    """
    scalars = {}
    for case in possible_cases(rectangle):
        difference = R_cam_rect_predicted.T @ R_cam_rect @ _ROTATIONS[case]
        # trace = 4 q0^2 - 1, good at any angle.
        scalars[case] = float(np.sqrt(max(0.0, 0.25 * (1.0 + np.trace(difference)))))
    best = max(scalars, key=lambda case: scalars[case])
    return best, scalars[best]
