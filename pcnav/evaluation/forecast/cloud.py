"""States drawn from an estimate and carried forward, each by its own motion.

An attitude that is uncertain by more than some degrees bends the spread of what it carries, and a
rate that is uncertain winds it around its axis: an ellipsoid that is propagated to first order is
then beside the truth. Drawn states are moved without any linearisation.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.inertia_parameters import (
    inertia_of,
    parameters_from_ratios,
    ratios_jacobian,
    shares,
)
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.process_noise import hill_process_noise
from pcnav.dynamics.rotation_step import rotate, torque_free
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
)
from pcnav.evaluation.forecast.start import ForecastStart

_MAX_TURN_RAD = 0.05
"""Rotation in one step of the integration: its error, of order turn^5 / 120, stays below 1e-8 rad,
which over many turns is far below what any run knows."""
_MAX_DRAWS = 50
"""Times that states are drawn until enough of them have the inertia of a body."""


@dataclass(frozen=True)
class Cloud:
    """N states at one time."""

    time_s: float
    relative: FloatArray
    """(N, 6) position and velocity of the mass centre in Hill axes, m and m/s."""
    com_model: FloatArray
    """(N, 3) m"""
    R_world_body: FloatArray
    """(N, 3, 3)"""
    omega_body: FloatArray
    """(N, 3) inertial, rad/s."""
    inertia: FloatArray
    """(N, 3, 3) over a third of the trace."""

    @staticmethod
    def drawn(start: ForecastStart, n: int, rng: np.random.Generator) -> "Cloud":
        """About an estimate, as its covariance has them; only bodies have their inertias."""
        state = start.state
        errors = _errors(start, n, rng)
        parameters = parameters_from_ratios(state.inertia_ratios) + errors[:, INERTIA_RATIOS]
        return Cloud(
            time_s=start.time_s,
            relative=np.hstack(
                [state.r_hill + errors[:, R_HILL], state.v_hill + errors[:, V_HILL]]
            ),
            com_model=state.com_model + errors[:, COM_MODEL],
            R_world_body=state.R_world_body @ exp_rotation(errors[:, THETA_BODY]),
            omega_body=state.omega_body + errors[:, OMEGA_BODY],
            inertia=inertia_of(parameters),
        )

    def moved(self, start: ForecastStart, step_s: float, rng: np.random.Generator) -> Self:
        """After a time, as the motion of the start leads each of them, and its accelerations."""
        n, mean_motion = len(self.relative), start.mean_motion_rad_s
        orbit = hill_transition(mean_motion, step_s)
        by_translation, by_rotation = np.sqrt(start.accelerations.drawn(step_s, n, rng)).T
        unit = _root(hill_process_noise(mean_motion, step_s, 1.0))
        kicks = by_translation[:, None] * (rng.standard_normal((n, 6)) @ unit.T)
        if start.torque_free:
            slope = torque_free(self.inertia, np.asarray(np.linalg.inv(self.inertia)))
            done = rotate(slope, self.omega_body, step_s, 0, _MAX_TURN_RAD)
            turn, omega = done.turn, done.omega_body
        else:
            turn, omega = exp_rotation(self.omega_body * step_s), self.omega_body
        by_rate, by_place = rng.standard_normal((2, n, 3))
        density = by_rotation[:, None]
        change = density * np.sqrt(step_s) * by_rate
        # Half of the rate's change, and what is independent of it.
        angle = 0.5 * step_s * change + density * np.sqrt(step_s**3 / 12.0) * by_place
        return replace(
            self,
            time_s=self.time_s + step_s,
            relative=self.relative @ orbit.T + kicks,
            R_world_body=self.R_world_body @ turn @ exp_rotation(angle),
            omega_body=omega + change,
        )


def _errors(start: ForecastStart, n: int, rng: np.random.Generator) -> FloatArray:
    """(n, 20) errors of the state; the inertia's part of its parameters, as the filter errs."""
    parameters = parameters_from_ratios(start.state.inertia_ratios)
    to_errors = np.eye(STATE_SIZE)
    to_errors[INERTIA_RATIOS, INERTIA_RATIOS] = np.linalg.inv(ratios_jacobian(parameters))
    root = to_errors @ _root(start.covariance)
    kept: list[FloatArray] = []
    for _ in range(_MAX_DRAWS):
        errors = rng.standard_normal((n, STATE_SIZE)) @ root.T
        smallest = shares(parameters + errors[:, INERTIA_RATIOS])[0][:, 0]
        kept.append(errors[smallest > 0.0])
        if sum(map(len, kept)) >= n:
            return np.concatenate(kept)[:n]
    # A covariance that hardly holds a body: the inertia as it is estimated.
    errors[:, INERTIA_RATIOS] = 0.0
    return errors


def _root(covariance: FloatArray) -> FloatArray:
    """A square root of a covariance whose units differ by many powers of ten, zeros allowed."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(sd > 0.0, sd, 1.0)
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(variances, 0.0)))
