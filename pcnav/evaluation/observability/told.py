"""What an estimator's error state is called, and in which errors it is told."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    RotationState,
    printed_ratios_jacobian,
)
from pcnav.estimators.attitude_inertia.rotation_model import SIZE as ROTATION_SIZE
from pcnav.estimators.principal_axes.feature_states import PA_MOTION_SIZE, PrincipalState

S = TypeVar("S")

_AXES = ("x", "y", "z")
_RATIOS_XX = ("Iyy/Ixx", "Izz/Ixx", "Ixy/Ixx", "Ixz/Ixx", "Iyz/Ixx")
_RATIOS_ZZ = ("Jxx/Jzz", "Jyy/Jzz", "Jxy/Jzz", "Jxz/Jzz", "Jyz/Jzz")


@dataclass(frozen=True)
class Group:
    """States of one kind and unit, whose combinations make sense."""

    name: str
    unit: str
    terms: tuple[str, ...]
    """One per state."""
    constant: bool = False
    """Whether they do not change in time, so that their prior is known at all times."""


@dataclass(frozen=True)
class Told(Generic[S]):
    """The states that are told, m of them, of an error state of n."""

    groups: tuple[Group, ...]
    edge: Callable[[S], FloatArray]
    """(m, n) from the errors of a state to those told."""

    def slices(self) -> tuple[slice, ...]:
        """Where each group lies among the m."""
        ends = np.cumsum([len(group.terms) for group in self.groups]).tolist()
        return tuple(
            slice(end - len(group.terms), end) for end, group in zip(ends, self.groups, strict=True)
        )

    @property
    def names(self) -> tuple[str, ...]:
        """m."""
        return tuple(term for group in self.groups for term in group.terms)

    @property
    def units(self) -> tuple[str, ...]:
        """m."""
        return tuple(group.unit for group in self.groups for _ in group.terms)


def _of(kind: str) -> tuple[str, ...]:
    return tuple(f"{kind} {axis}" for axis in _AXES)


_POSITION = Group("position", "m", _of("position"))
_VELOCITY = Group("velocity", "m/s", _of("velocity"))
_ATTITUDE = Group("attitude", "rad", _of("attitude"))
_RATE = Group("rate", "rad/s", _of("rate"))


def _ratios_of_navigation(state: NavigationState) -> FloatArray:
    edge = np.eye(STATE_SIZE)
    edge[INERTIA_RATIOS, INERTIA_RATIOS] = ratios_jacobian(
        parameters_from_ratios(state.inertia_ratios)
    )
    return edge


def _ratios_of_rotation(state: RotationState) -> FloatArray:
    edge = np.eye(ROTATION_SIZE)
    edge[INERTIA, INERTIA] = printed_ratios_jacobian(state.parameters)
    return edge


def _motion_of_principal(state: PrincipalState) -> FloatArray:
    return np.eye(PA_MOTION_SIZE, PA_MOTION_SIZE + 3 * len(state.points))


DEPTH: Told[NavigationState] = Told(
    (
        _POSITION,
        _VELOCITY,
        Group("mass centre", "m", _of("mass centre"), constant=True),
        _ATTITUDE,
        _RATE,
        Group("inertia ratios", "1", _RATIOS_XX, constant=True),
    ),
    _ratios_of_navigation,
)
"""`pcnav.estimators.depth.mass_centre`."""
ROTATION: Told[RotationState] = Told(
    (_ATTITUDE, _RATE, Group("inertia ratios", "1", _RATIOS_ZZ, constant=True)),
    _ratios_of_rotation,
)
"""`pcnav.estimators.attitude_inertia.rotation_model`."""
PRINCIPAL: Told[PrincipalState] = Told(
    (
        _ATTITUDE,
        _RATE,
        Group("inertia ratios", "1", ("p_x", "p_z"), constant=True),
        _POSITION,
        _VELOCITY,
    ),
    _motion_of_principal,
)
"""`pcnav.estimators.principal_axes.feature_states`, without the points."""
BANK_GROUPS = (_POSITION, _VELOCITY, _ATTITUDE, _RATE)
"""`pcnav.estimators.inertia_bank.relative_state` in body errors, without the points."""
