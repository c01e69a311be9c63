"""Targets that turn by more between frames than one attitude tells: which rate leads through them.

Two attitudes are explained by the smallest turn between them and by every one that a symmetry adds;
a body that tumbles changes its rate within such a turn. So the candidates are told apart by whether
a free body can make all of their frames, and of those that can the slowest is taken, as for slow
ones: faster than half a turn a frame no camera tells.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.mass_centre import MassCentreModel

_MAX_ITERATIONS = 20
_LED_RAD = 1e-3
_SLOWER = 2.0
"""A rate is taken before another one that is so many times faster."""

T = TypeVar("T")


def with_first_rate(
    state: NavigationState, model: MassCentreModel, time_s: float, next_s: float, R_next: FloatArray
) -> NavigationState:
    """The state with the rate that leads a free body to its next attitude (3, 3) R_world_body.

    The rate that it has is where the search begins, and what is returned where none is found.
    """
    duration_s, moved = next_s - time_s, state
    for _ in range(_MAX_ITERATIONS):
        led, _, _ = model.propagate(moved, time_s, duration_s)
        missed = log_rotation(led.R_world_body.T @ R_next)
        if np.linalg.norm(missed) < _LED_RAD:
            return moved
        moved = replace(moved, omega_body=moved.omega_body + missed / duration_s)
    return state


def slowest(found: Sequence[tuple[float, T]]) -> T | None:
    """Of what is possible, each with its rate, the clearly slowest; None where there is none."""
    order = sorted(found, key=lambda pair: pair[0])
    if not order or (len(order) > 1 and order[1][0] < _SLOWER * order[0][0]):
        return None
    return order[0][1]
