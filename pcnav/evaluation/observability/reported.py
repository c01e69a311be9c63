"""Which states an estimator reports, and how their errors follow from those of its own state."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    ROTATION_LAYOUT,
    VELOCITY,
    Layout,
)
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    RotationState,
    printed_ratios_jacobian,
)
from pcnav.estimators.inertia_bank.relative_state import (
    IB_MOTION_SIZE,
    RELATIVE_LAYOUT,
    RelativeStates,
)
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PRINCIPAL_LAYOUT,
    PrincipalState,
)

S = TypeVar("S")

_NAMES = {
    POSITION: "position",
    VELOCITY: "velocity",
    CENTRE: "mass centre",
    ATTITUDE: "attitude",
    RATE: "rate",
}
"""Of groups of states that are vectors; the others are inertia ratios."""


@dataclass(frozen=True)
class Group:
    """States of one kind and unit, whose combinations make sense."""

    name: str
    unit: str
    terms: tuple[str, ...]
    """One per state."""
    constant: bool
    """Whether they do not change in time, so that their prior is known at all times."""
    rows: slice
    """Where they lie among the states reported."""


@dataclass(frozen=True)
class ReportedState(Generic[S]):
    """The states that are reported, m of them, of an error state of n."""

    layout: Layout
    ratios: tuple[str, ...]
    """Names of the inertia ratios, where the layout has them."""
    output_jacobian: Callable[[S], FloatArray]
    """(m, n) from the errors of a state to those reported."""

    @property
    def groups(self) -> tuple[Group, ...]:
        """By block of the layout."""
        found = []
        for block, rows in zip(self.layout.blocks, self.layout.slices, strict=True):
            name = _NAMES.get(block, "inertia ratios")
            vector = tuple(f"{name} {axis}" for axis in block.components)
            terms = vector if block in _NAMES else self.ratios
            found.append(Group(name, block.unit, terms, block.constant, rows))
        return tuple(found)

    @property
    def names(self) -> tuple[str, ...]:
        """m."""
        return tuple(term for group in self.groups for term in group.terms)

    @property
    def units(self) -> tuple[str, ...]:
        """m."""
        return tuple(group.unit for group in self.groups for _ in group.terms)


def _ratios_of_navigation(state: NavigationState) -> FloatArray:
    jacobian, rows = np.eye(STATE_SIZE), INERTIA_RATIOS
    jacobian[rows, rows] = ratios_jacobian(parameters_from_ratios(state.inertia_ratios))
    return jacobian


def _ratios_of_rotation(state: RotationState) -> FloatArray:
    jacobian = np.eye(state.size)
    jacobian[INERTIA, INERTIA] = printed_ratios_jacobian(state.parameters)
    return jacobian


def _motion_of_principal(state: PrincipalState) -> FloatArray:
    return np.eye(PA_MOTION_SIZE, state.size)


def _body_errors_of_bank(state: RelativeStates) -> FloatArray:
    return np.asarray(state.to_body_errors()[:IB_MOTION_SIZE])


DEPTH = ReportedState(
    MASS_CENTRE_LAYOUT,
    ("Iyy/Ixx", "Izz/Ixx", "Ixy/Ixx", "Ixz/Ixx", "Iyz/Ixx"),
    _ratios_of_navigation,
)
"""`pcnav.estimators.depth.mass_centre`."""
ROTATION = ReportedState(
    ROTATION_LAYOUT,
    ("Jxx/Jzz", "Jyy/Jzz", "Jxy/Jzz", "Jxz/Jzz", "Jyz/Jzz"),
    _ratios_of_rotation,
)
"""`pcnav.estimators.attitude_inertia.rotation_model`."""
PRINCIPAL = ReportedState(PRINCIPAL_LAYOUT, ("p_x", "p_z"), _motion_of_principal)
"""`pcnav.estimators.principal_axes.feature_states`, without the points."""
BANK = ReportedState(RELATIVE_LAYOUT, (), _body_errors_of_bank)
"""`pcnav.estimators.inertia_bank.relative_state` in body errors, without the points."""
