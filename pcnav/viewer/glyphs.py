"""Geometry of what stands for a number: ellipsoids, cones, arrows. Arrays in, arrays out."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.evaluation.errors import principal_rotation

SIGMAS = 3.0
_MAX_SHARE = 1.0 / 6.0
_CONE_SIDES = 48
_WIDEST_CONE_RAD = np.radians(75.0)
"""A magnified doubt wider than this says no more than that it is wide."""


@dataclass(frozen=True)
class Ellipsoid:
    """A unit sphere stretched and turned: ``R diag(radii)`` maps the sphere onto it."""

    radii: FloatArray
    """(3,) semi-axes."""
    R: FloatArray
    """(3, 3) proper rotation; its columns are the axes."""


def sigma_ellipsoid(covariance: FloatArray, sigmas: float = SIGMAS) -> Ellipsoid:
    """The surface of so many standard deviations of a (3, 3) covariance."""
    variances, R = np.linalg.eigh(covariance)
    if np.linalg.det(R) < 0.0:
        R = R * np.array([-1.0, 1.0, 1.0])
    # Rounding may leave a variance that should be zero slightly below it.
    return Ellipsoid(sigmas * np.sqrt(np.maximum(variances, 0.0)), R)


def seen_magnification(radius_m: float, size_m: float) -> float:
    """The largest of 1, 10, ..., 100000 that keeps a radius below a sixth of the target's size."""
    if radius_m <= 0.0:
        return 1.0
    power = np.floor(np.log10(_MAX_SHARE * size_m / radius_m))
    return float(10.0 ** np.clip(power, 0, 5))


def unit_cone() -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) and triangles (m, 3) of a cone: apex at 0, a unit circle at z = 1."""
    angle = np.linspace(0.0, 2.0 * np.pi, _CONE_SIDES, endpoint=False)
    rim = np.stack([np.cos(angle), np.sin(angle), np.ones(_CONE_SIDES)], axis=1)
    first = np.arange(1, _CONE_SIDES + 1)
    second = np.roll(first, -1)
    return (
        np.vstack([np.zeros((1, 3)), rim]),
        np.stack([np.zeros(_CONE_SIDES, dtype=np.intp), first, second], axis=1),
    )


def attitude_cone_scale(sd_theta: FloatArray, length_m: float, magnified: float) -> FloatArray:
    """(3,) scale of `unit_cone` about the body's z axis that holds it 3 sigma of attitude wide.

    ``sd_theta`` (3,) rad about the body axes: a turn about x moves the tip of z along y.
    """
    half_angle = np.minimum(SIGMAS * magnified * sd_theta[[1, 0]], _WIDEST_CONE_RAD)
    return np.array([*(length_m * np.tan(half_angle)), length_m])


def principal_axes_model(inertia_ratios: FloatArray) -> FloatArray:
    """(3, 3) axes of inertia as columns, model axes, largest moment first; proper."""
    R = principal_rotation(inertia_from_ratios(inertia_ratios))
    # Of the two directions of an axis the one nearer to the model's own, for a picture at rest.
    signs = np.sign(R[np.argmax(np.abs(R), axis=0), np.arange(3)])
    R = R * signs
    return np.asarray(R if np.linalg.det(R) > 0.0 else R * np.array([1.0, 1.0, -1.0]))


def momentum_direction(inertia_ratios: FloatArray, omega_body: FloatArray) -> FloatArray:
    """(3,) unit direction of the angular momentum, body axes; 0 at rest."""
    h = inertia_from_ratios(inertia_ratios) @ omega_body
    length = float(np.linalg.norm(h))
    return np.asarray(h / length if length > 0.0 else h)


def closed(corners: FloatArray) -> FloatArray:
    """(4, 2, 3) the sides of a rectangle with corners (4, 3)."""
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def path_segments(points: FloatArray, most: int = 600) -> FloatArray:
    """(m, 2, 3) the way through points (n, 3), thinned to about so many segments."""
    if len(points) < 2:
        return np.zeros((0, 2, 3))
    step = max(1, -(-(len(points) - 1) // most))
    kept = points[np.unique(np.append(np.arange(0, len(points), step), len(points) - 1))]
    return np.stack([kept[:-1], kept[1:]], axis=1)
