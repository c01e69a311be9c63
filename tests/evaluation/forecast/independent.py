"""Motions of many bodies at once by SciPy, written from the equations and from nothing of pcnav."""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray


@dataclass(frozen=True)
class Bodies:
    """M bodies at one time; Hill axes and world axes are the same at time 0."""

    r: FloatArray
    v: FloatArray
    R_world_body: FloatArray
    omega: FloatArray
    inertia: FloatArray
    """(M, 3, 3) of any scale."""


def moved(bodies: Bodies, mean_motion: float, duration_s: float) -> Bodies:
    """After a time, without disturbances."""
    m, n = len(bodies.r), mean_motion
    inverse = np.linalg.inv(bodies.inertia)
    hill = np.array([[0.0, 0, 0], [0, -(n**2), 0], [0, 0, 3 * n**2]])
    coriolis = np.array([[0.0, 0, 2 * n], [0, 0, 0], [-2 * n, 0, 0]])

    def derivative(_: float, flat: FloatArray) -> FloatArray:
        r, v, q, w = np.split(flat.reshape(m, 13), [3, 6, 10], axis=1)
        momentum = np.einsum("mij,mj->mi", bodies.inertia, w)
        change = np.einsum("mij,mj->mi", inverse, -np.cross(w, momentum))
        vector, scalar = q[:, :3], q[:, 3:]
        turned = 0.5 * (scalar * w + np.cross(vector, w))
        lost = -0.5 * np.sum(vector * w, axis=1, keepdims=True)
        return np.hstack([v, r @ hill.T + v @ coriolis.T, turned, lost, change]).ravel()

    q = Rotation.from_matrix(bodies.R_world_body).as_quat()
    start = np.hstack([bodies.r, bodies.v, q, bodies.omega]).ravel()
    found = solve_ivp(derivative, (0.0, duration_s), start, "DOP853", rtol=1e-9, atol=1e-11)
    r, v, q, w = np.split(found.y[:, -1].reshape(m, 13), [3, 6, 10], axis=1)
    return Bodies(r, v, Rotation.from_quat(q).as_matrix(), w, bodies.inertia)


def point_in_hill(bodies: Bodies, arm_body: FloatArray, angle: float) -> FloatArray:
    """(M, 3) where points at arms (M, 3) from the mass centres are, the Hill frame being turned."""
    R_hill_world = Rotation.from_euler("y", angle).as_matrix()
    return bodies.r + np.einsum("ij,mjk,mk->mi", R_hill_world, bodies.R_world_body, arm_body)
