"""Which catalogue rectangles a segment can be, and in which of the four cases of its axes.

Both sides and the area must agree (`recognise`). Eigenvectors have no sign, so a rectangle looks
the same after any of the four proper rotations {I, 180 degrees about x, y, z} of its own frame (Yu
2019, section 2.3, Figure 2). (The paper lists three case quaternions out of order with their axes;
enumerating the group needs no list.)
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.chi_square import exceeds, upper_quantile
from pcnav.perception.rectangles import AREA, LENGTH, WIDTH, RectangleObservation
from pcnav.target.satellite import Rectangle

_MODEL_TOLERANCE = 0.01
"""A catalogue entry is a rectangle to 1 %, so its sides and area are known to 1 %."""


@dataclass(frozen=True)
class Recognition:
    """One catalogue entry that agrees with an observation."""

    rectangle: Rectangle
    chi_square: float
    """Of the differences in sides and area; small is good."""


def recognise(
    observation: RectangleObservation, catalogue: tuple[Rectangle, ...], gate_sigma: float
) -> tuple[Recognition, ...]:
    """Catalogue entries whose size agrees with the observation, best first.

    The gate is the chi-square quantile that ``gate_sigma`` standard deviations have in one
    dimension. Besides the observation's own errors the sides may differ by the 1 % to which an
    entry is a rectangle, and by a rim, as of a panel's thickness, too thin to be distinguished.
    """
    rows = [LENGTH, WIDTH] if np.isnan(observation.area_m2) else [LENGTH, WIDTH, AREA]
    gate = size_gate(gate_sigma, len(rows))
    found = []
    for rectangle in catalogue:
        size = np.array([rectangle.length_m, rectangle.width_m, rectangle.area_m2])[: len(rows)]
        seen = np.array([observation.length_m, observation.width_m, observation.area_m2])[
            : len(rows)
        ]
        rim_effect = observation.rim_m * np.array(
            [1.0, 1.0, rectangle.length_m + rectangle.width_m]
        )
        tolerance = np.diag((_MODEL_TOLERANCE * size) ** 2 + rim_effect[: len(rows)] ** 2)
        covariance = observation.covariance[np.ix_(rows, rows)] + tolerance
        difference = seen - size
        chi_square = float(difference @ np.linalg.solve(covariance, difference))
        if chi_square < gate:
            found.append(Recognition(rectangle, chi_square))
    return tuple(sorted(found, key=lambda recognition: recognition.chi_square))


@lru_cache(maxsize=16)
def size_gate(gate_sigma: float, dof: int) -> float:
    """Chi-square of ``dof`` differences that is as rare as one of ``gate_sigma`` deviations."""
    return float(upper_quantile(exceeds(gate_sigma**2, 1), dof))


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
