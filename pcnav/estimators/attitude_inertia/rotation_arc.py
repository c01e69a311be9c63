"""Torque-free rotation fitted to the attitudes of an arc: rate and inertia without differentiation.

What the linear identification of Hu 2024 (11)-(14) asks of rates, this asks of the motion: the
attitude at the start, the rate there and the inertia whose torque-free rotation passes through the
measured attitudes. Nothing that is measured is a regressor, so noise does not bias the result, and
an attitude weighs by its own covariance. Many arcs of the same times are fitted at once.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.dynamics.inertia_parameters import inertia_of
from pcnav.dynamics.rotation_step import at_rest, torque_free_by_inertia

SIZE = 11
"""Attitude error and rate at the start (3 each), inertia parameters (5)."""
_BALL = np.array([1.0, 1.0, 0.0, 0.0, 0.0])
_PRIOR_SD = 0.5
"""Of each inertia parameter about a ball's: what the arc does not show stays a ball's."""
_MIN_MOMENT = 0.05
"""Over the mean moment."""
_SETTLED = 1e-3
_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-3, 1e-9, 1e9


@dataclass(frozen=True)
class RotationArc:
    """Rotations that pass through arcs of attitudes, over a leading dimension."""

    R_world_g: FloatArray
    """(B, 3, 3) at the first time."""
    omega_g: FloatArray
    """(B, 3) there, rad/s."""
    parameters: FloatArray
    """(B, 5) N_yy, N_zz, N_xy, N_xz, N_yz with N = 3 I / tr(I), axes of g."""
    covariance: FloatArray
    """(B, 11, 11) of the errors of all that."""
    cost: FloatArray
    """(B,) weighted squared residual, prior included."""
    converged: BoolArray
    """(B,)"""

    def inertia(self) -> FloatArray:
        """(B, 3, 3) N."""
        return inertia_of(self.parameters)


def positive(parameters: FloatArray) -> FloatArray:
    """(..., 5) moved towards a ball's until all moments are positive.

    The triangle inequality is left alone: a fit that errs past it is no worse for that, and one
    that is held at it would not know how far it errs.
    """
    least = np.linalg.eigvalsh(inertia_of(parameters))[..., 0]
    # The ball's moments are all 1; the smallest moment is concave along the way to it.
    part = np.where(least < _MIN_MOMENT, (1.0 - _MIN_MOMENT) / (1.0 - np.minimum(least, 0.5)), 1.0)
    return np.asarray(_BALL + part[..., None] * (parameters - _BALL), dtype=np.float64)


def fit_rotation_arc(
    times_s: FloatArray,
    R_world_g: FloatArray,
    noise: FloatArray,
    omega_g: FloatArray,
    parameters: FloatArray,
    max_steps: int = 25,
) -> RotationArc:
    """Least squares over arcs by Levenberg and Marquardt, all arcs at once.

    Args:
        times_s: (n,) increasing.
        R_world_g: (B, n, 3, 3) measured attitudes.
        noise: (B, n, 3, 3) their covariances, axes of g, rad^2.
        omega_g: (B, 3) rates at the first time to start from.
        parameters: (B, 5) inertia to start from.
        max_steps: of the iteration; arcs that converge early wait for the others.
    """
    weight = _array(np.linalg.inv(noise))
    state = (R_world_g[:, 0], omega_g, positive(parameters))
    normal, gradient, cost = _normal_equations(times_s, R_world_g, weight, state)
    damping = np.full(len(cost), _FIRST_DAMPING)
    converged = np.zeros(len(cost), dtype=np.bool_)
    for _ in range(max_steps):
        damped = normal + damping[:, None, None] * _diagonal(normal)
        step = _array(np.linalg.solve(damped, gradient[..., None])[..., 0])
        tried = _moved(state, step)
        after = _normal_equations(times_s, R_world_g, weight, tried)
        better = (after[2] <= cost * (1.0 + 1e-12)) & ~converged
        sd = 1.0 / np.sqrt(np.diagonal(normal, axis1=-2, axis2=-1))
        settled = np.all(np.abs(step) < _SETTLED * sd, axis=-1)
        state = _chosen(better, tried, state)
        normal, gradient, cost = _chosen(better, after, (normal, gradient, cost))
        damping = np.clip(damping * np.where(better, 0.1, 10.0), _MIN_DAMPING, _MAX_DAMPING)
        converged |= settled & better
        if np.all(converged | (damping >= _MAX_DAMPING)):
            break
    return RotationArc(*state, _array(np.linalg.inv(normal)), cost, converged)


_State = tuple[FloatArray, FloatArray, FloatArray]


def _array(values: npt.ArrayLike) -> FloatArray:
    return np.asarray(values, dtype=np.float64)


def _diagonal(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix * np.eye(matrix.shape[-1]))


def _chosen(which: BoolArray, new: _State, old: _State) -> _State:
    picked = [
        np.where(which.reshape(-1, *([1] * (a.ndim - 1))), a, b)
        for a, b in zip(new, old, strict=True)
    ]
    return picked[0], picked[1], picked[2]


def _moved(state: _State, step: FloatArray) -> _State:
    R, omega, parameters = state
    return (
        R @ exp_rotation(step[:, :3]),
        omega + step[:, 3:6],
        positive(parameters + step[:, 6:]),
    )


def _normal_equations(
    times_s: FloatArray, measured: FloatArray, weight: FloatArray, state: _State
) -> _State:
    """Normal matrix (B, 11, 11), right-hand side (B, 11) and cost (B,) about a state."""
    R, omega, parameters = state
    inertia = inertia_of(parameters)
    slope = torque_free_by_inertia(inertia, _array(np.linalg.inv(inertia)))
    batch = len(R)
    done = at_rest(omega, SIZE - 3)
    away = (parameters - _BALL) / _PRIOR_SD**2
    normal = np.zeros((batch, SIZE, SIZE))
    normal[:, 6:, 6:] = np.eye(5) / _PRIOR_SD**2
    gradient = np.concatenate([np.zeros((batch, 6)), -away], axis=1)
    cost = np.sum((parameters - _BALL) * away, axis=1)
    for k in range(len(times_s)):
        if k > 0:
            done = done.then(slope, float(times_s[k] - times_s[k - 1]))
        transition = np.concatenate([np.swapaxes(done.turn, -1, -2), done.by_start], axis=-1)
        error = log_rotation(np.swapaxes(R @ done.turn, -1, -2) @ measured[:, k])
        # log(exp(-theta) exp(e)) = e - theta to first order in small e.
        weighted = np.swapaxes(transition, -1, -2) @ weight[:, k]
        normal += weighted @ transition
        gradient += (weighted @ error[..., None])[..., 0]
        cost += (error[:, None] @ weight[:, k] @ error[..., None])[:, 0, 0]
    return normal, gradient, cost
