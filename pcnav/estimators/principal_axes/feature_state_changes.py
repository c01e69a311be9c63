"""Changes of a filter's state in form only: other principal axes, more points, fewer points."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.principal_inertia import (
    moments_from_ratios,
    moments_jacobian,
    ratios_from_moments,
    ratios_jacobian,
)
from pcnav.estimators.principal_axes.feature_states import (
    PA_MOTION_SIZE,
    PA_OMEGA,
    PA_R_HILL,
    PA_RATIOS,
    PA_THETA,
    PrincipalState,
    point_slice,
)


def relabelled(
    state: PrincipalState, covariance: FloatArray, R_body_new: FloatArray
) -> tuple[PrincipalState, FloatArray]:
    """The same motion in other principal axes, one of the 24 sets.

    ``R_body_new`` (3, 3) is a signed permutation with determinant 1. The covariance (n, n) follows,
    that of the ratios by the derivative of the new ones by the old.
    """
    order = np.abs(R_body_new).argmax(axis=0)
    moments = moments_from_ratios(state.ratios)[order]
    by_moments = ratios_jacobian(moments)
    change = np.zeros_like(covariance)
    for block in (PA_THETA, PA_OMEGA, *(point_slice(k) for k in range(len(state.points)))):
        change[block, block] = R_body_new.T
    change[PA_RATIOS, PA_RATIOS] = by_moments @ moments_jacobian(state.ratios)[order]
    change[8:14, 8:14] = np.eye(6)
    moved = replace(
        state,
        R_world_body=state.R_world_body @ R_body_new,
        omega_body=R_body_new.T @ state.omega_body,
        ratios=ratios_from_moments(moments),
        points=state.points @ R_body_new,
    )
    return moved, change @ covariance @ change.T


def without_points(
    state: PrincipalState, covariance: FloatArray, slots: Sequence[int]
) -> tuple[PrincipalState, FloatArray]:
    """State and covariance without the points at some places."""
    kept = np.setdiff1d(np.arange(len(state.points)), slots)
    rows = np.concatenate(
        [np.arange(PA_MOTION_SIZE), (PA_MOTION_SIZE + 3 * kept[:, None] + np.arange(3)).ravel()]
    )
    return replace(state, points=state.points[kept]), covariance[np.ix_(rows, rows)]


def with_point(
    state: PrincipalState,
    covariance: FloatArray,
    p_body: FloatArray,
    noise: FloatArray,
    R_body_hill: FloatArray,
) -> tuple[PrincipalState, FloatArray]:
    """State and covariance with one more point, seen at ``p_body`` (3,) from the present state.

    ``noise`` (3, 3) is that of the observation alone, body axes. ``f = R^T (p - r)`` errs with the
    position by ``-R_body_hill``, and with the attitude just as all points do by definition.
    """
    size = len(covariance)
    by = np.zeros((3, size))
    by[:, PA_R_HILL] = -R_body_hill
    grown = np.zeros((size + 3, size + 3))
    grown[:size, :size] = covariance
    grown[size:, :size] = by @ covariance
    grown[:size, size:] = grown[size:, :size].T
    grown[size:, size:] = by @ covariance @ by.T + noise
    return replace(state, points=np.vstack([state.points, p_body])), grown
