"""Lens distortion as OpenCV defines it, and its inverse.

It maps the place (x, y) where a ray meets the plane z = 1 to the place it would meet without a
lens. Polynomials fold back: beyond some radius a point would be imaged where another one is. Up to
there the mapping is the model's own, and beyond it goes on straight outwards, so that it has one
inverse everywhere and nothing from beyond is imaged among what the model describes.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray

_MIN_SLOPE = 0.02
"""Where a step outwards moves the image by less than this share of the most that it does nearer to
the axis, the mapping is taken to end: its inverse would magnify rounding and calibration alike."""
_FARTHEST = float(np.tan(np.deg2rad(89.0)))
"""Directions further off the axis have no place on the plane z = 1 worth the name."""
_RADII = 2000
_DIRECTIONS = 48
_MAX_STEPS = 30
_LAST_STEP = 1e-9
"""What a Newton step of this size (over the radius, or 1) leaves wrong is its square: rounding."""


class DistortionModel(StrEnum):
    """Which of OpenCV's models."""

    OPENCV = "opencv"
    """Radial and tangential (Brown): k1, k2, p1, p2(, k3(, k4, k5, k6)); k4 to k6 divide."""
    FISHEYE = "fisheye"
    """Odd polynomial of the angle off the axis (Kannala and Brandt): k1, k2, k3, k4."""


COEFFICIENTS = {DistortionModel.OPENCV: (4, 5, 8), DistortionModel.FISHEYE: (4,)}
"""How many each may have."""


@dataclass(frozen=True)
class Distortion:
    """A model and its coefficients. Raises `ValueError` for a number of them that it has not."""

    model: DistortionModel
    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        sizes = COEFFICIENTS[self.model]
        if len(self.coefficients) not in sizes or not np.isfinite(self.coefficients).all():
            counts = " or ".join(map(str, sizes))
            raise ValueError(f"expected {counts} finite coefficients for {self.model}")

    @property
    def max_radius(self) -> float:
        """Radius on the plane z = 1 up to which the model holds."""
        return _limits(self)[0]

    def is_within(self, xy: FloatArray) -> BoolArray:
        """(...) whether places (..., 2) on the plane z = 1 are those of the model."""
        return np.asarray(np.hypot(xy[..., 0], xy[..., 1]) <= self.max_radius)

    def distorted(self, xy: FloatArray) -> FloatArray:
        """(..., 2) where places (..., 2) on the plane z = 1 are imaged."""
        return self._mapped(xy)[0]

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """(..., 2, 2) derivative of `distorted`."""
        return self._mapped(xy)[1]

    def undistorted(self, xy: FloatArray) -> FloatArray:
        """(..., 2) the places on the plane z = 1 that are imaged at (..., 2): the inverse.

        Newton's method from the inverse of the radial part, to 1e-12 or better.
        """
        _, radii, imaged = _limits(self)
        length = np.hypot(xy[..., 0], xy[..., 1])
        outside = np.maximum(length - imaged[-1], 0.0)
        radius = np.interp(length, imaged, radii) + outside
        found = xy * (radius / np.where(length > 0.0, length, 1.0))[..., None]
        for _ in range(_MAX_STEPS):
            image, jacobian = self._mapped(found)
            off = xy - image
            (a, b), (c, d) = np.moveaxis(jacobian, (-2, -1), (0, 1))
            determinant = a * d - b * c
            step = np.stack(
                [d * off[..., 0] - b * off[..., 1], a * off[..., 1] - c * off[..., 0]], axis=-1
            )
            step /= np.where(np.abs(determinant) > 1e-12, determinant, 1.0)[..., None]
            found = found + step
            scale = np.maximum(np.hypot(found[..., 0], found[..., 1]), 1.0)
            if not step.size or float(np.max(np.abs(step) / scale[..., None])) < _LAST_STEP:
                break
        return np.asarray(found)

    def _mapped(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`distorted` and `jacobian` of places (..., 2)."""
        limit = _limits(self)[0]
        radius = np.hypot(xy[..., 0], xy[..., 1])
        beyond = radius > limit
        if not beyond.any():
            return self._within(xy)
        # Straight on from where the model ends.
        safe = np.where(beyond, radius, 1.0)[..., None]
        unit = xy / safe
        at_end = np.where(beyond[..., None], limit * unit, xy)
        image, jacobian = self._within(at_end)
        image = np.where(beyond[..., None], image + (radius - limit)[..., None] * unit, image)
        radial = unit[..., :, None] * unit[..., None, :]
        across = (np.eye(2) - radial) / safe[..., None]
        straight = limit * (jacobian @ across) + (radius - limit)[..., None, None] * across
        jacobian = np.where(beyond[..., None, None], straight + radial, jacobian)
        return np.asarray(image), np.asarray(jacobian)

    def _within(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self.model is DistortionModel.FISHEYE:
            return _fisheye(xy, np.array(self.coefficients))
        return _brown(xy, np.array([*self.coefficients, 0.0, 0.0, 0.0, 0.0][:8]))


def _brown(xy: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """OpenCV's radial, rational and tangential distortion of (..., 2), with its Jacobian."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k.tolist()
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    over, under = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    over_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3)
    under_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)
    factor = over / under
    slope = 2.0 * (over_slope - factor * under_slope) / under
    image = np.stack(
        [
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ],
        axis=-1,
    )
    # The tangential part is a gradient, so the whole matrix is symmetric.
    mixed = x * y * slope + 2.0 * (p1 * x + p2 * y)
    jacobian = np.stack(
        [
            factor + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
            mixed,
            factor + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        ],
        axis=-1,
    )
    return image, jacobian.reshape(*xy.shape, 2)


def _fisheye(xy: FloatArray, k: FloatArray) -> tuple[FloatArray, FloatArray]:
    """OpenCV's fisheye distortion of (..., 2), with its Jacobian."""
    k1, k2, k3, k4 = k.tolist()
    radius = np.hypot(xy[..., 0], xy[..., 1])
    angle = np.arctan(radius)
    t2 = angle * angle
    imaged = angle * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
    by_angle = 1.0 + t2 * (3.0 * k1 + t2 * (5.0 * k2 + t2 * (7.0 * k3 + t2 * 9.0 * k4)))
    safe = np.where(radius > 0.0, radius, 1.0)
    factor = np.where(radius > 0.0, imaged / safe, 1.0)
    by_radius = by_angle / (1.0 + radius * radius)
    unit = xy / safe[..., None]
    radial = unit[..., :, None] * unit[..., None, :]
    jacobian = factor[..., None, None] * np.eye(2)
    jacobian = jacobian + (by_radius - factor)[..., None, None] * radial
    return np.asarray(xy * factor[..., None]), np.asarray(jacobian)


@lru_cache(maxsize=32)
def _limits(distortion: Distortion) -> tuple[float, FloatArray, FloatArray]:
    """How far the model holds, and radii (m,) up to there with the radii (m,) they are imaged at.

    To the first radius at which the mapping folds, or nearly does, in any direction.
    """
    # Even in the angle: fine at the axis and out to directions that are nearly across.
    radii = np.tan(np.linspace(0.0, np.arctan(_FARTHEST), _RADII))
    turn = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    around = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    with np.errstate(all="ignore"):
        image, jacobian = distortion._within(radii[:, None, None] * around)
    outwards = np.einsum("di,rdij,dj->rd", around, jacobian, around)
    determinant = np.linalg.det(jacobian)
    # By angle, as a fisheye lens keeps its scale there and not on the plane.
    by_angle = outwards * (1.0 + radii**2)[:, None]
    usual = np.maximum.accumulate(by_angle.max(axis=1))
    sound = (by_angle.min(axis=1) > _MIN_SLOPE * usual) & (determinant > 0.0).all(axis=1)
    sound &= np.isfinite(image).all(axis=(1, 2))
    last = len(radii) - 1 if sound.all() else max(int(np.argmin(sound)) - 1, 1)
    imaged = np.hypot(image[..., 0], image[..., 1]).mean(axis=1)[: last + 1]
    return float(radii[last]), radii[: last + 1], np.maximum.accumulate(imaged)
