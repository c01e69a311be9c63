"""Idealised clouds of one rectangle, how well their moments give its pose, and the paper's sensor.

The paper says that points are "uniform" on the rectangle. That can mean independent draws or an
even spread, and for the centroid the difference is a factor of 30 to 50, so all readings are here.
"""

from enum import StrEnum
from typing import Protocol

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import transform_points
from pcnav.perception.recognition import apply_case, resolve_case
from pcnav.perception.rectangles import RectangleObservation, observe_cloud
from pcnav.simulation.motion import TrueMotion
from pcnav.target.catalogue import Rectangle

from . import paper


class Spacing(StrEnum):
    """How points lie on the rectangle."""

    EVEN = "even grid"
    JITTERED = "one draw per grid cell"
    INDEPENDENT = "independent draws"


def rectangle_cloud(
    width: float, length: float, n: int, spacing: Spacing, generator: np.random.Generator
) -> FloatArray:
    """(n, 3) points without noise in the rectangle's frame, x along the width, z = 0."""
    cloud = np.zeros((n, 3))
    if spacing is Spacing.INDEPENDENT:
        cloud[:, :2] = generator.uniform(-0.5, 0.5, (n, 2))
    else:
        across, along = grid_shape(width, length, n)
        i, j = np.divmod(np.arange(n), along)
        in_cell = generator.random((n, 2)) if spacing is Spacing.JITTERED else np.full((n, 2), 0.5)
        cloud[:, :2] = (np.column_stack([i, j]) + in_cell) / [across, along] - 0.5
    cloud[:, :2] *= [width, length]
    return cloud


def grid_shape(width: float, length: float, n: int) -> tuple[int, int]:
    """Cells along the width and the length, n in all, as near to square as whole numbers allow."""
    divisors = [k for k in range(1, n + 1) if n % k == 0]
    across = min(divisors, key=lambda k: abs(np.log(k * k * length / (n * width))))
    return across, n // across


def centroid_sd(
    width: float, length: float, n: int, sigma: float, spacing: Spacing
) -> tuple[float, float, float]:
    """Standard deviation of the centroid along the short side, the long side and the normal."""
    across, along = grid_shape(width, length, n)
    scatter = {
        Spacing.EVEN: (0.0, 0.0),
        Spacing.JITTERED: (width / across, length / along),
        Spacing.INDEPENDENT: (width, length),
    }[spacing]
    x, y = (np.sqrt((side**2 / 12.0 + sigma**2) / n) for side in scatter)
    return float(x), float(y), float(sigma / np.sqrt(n))


def rotation_sd(
    width: float, length: float, n: int, sigma: float, spacing: Spacing
) -> tuple[float, float, float]:
    """Standard deviation, rad, of the rotation about the short side, the long side and the normal.

    First-order perturbation of the eigenvectors: the standard deviation of a cross moment over the
    difference of its two eigenvalues, in which the noise cancels. Cross moments err by
    ``sigma^2 (lambda_i + lambda_j) + sigma^4`` over n by noise alone (lambda without noise), and
    independent draws add ``lambda_i lambda_j`` over n; jitter adds what is left of that within the
    cells.
    """
    square = np.array([width, length, 0.0]) ** 2 / 12.0
    across, along = grid_shape(width, length, n)
    cell = np.array([width / across, length / along, 0.0]) ** 2 / 12.0

    def about(i: int, j: int) -> float:
        noise = sigma**2 * (square[i] + square[j]) + sigma**4
        drawn = 0.0
        if spacing is Spacing.INDEPENDENT:
            drawn = square[i] * square[j]
        elif spacing is Spacing.JITTERED:
            drawn = square[i] * cell[j] + square[j] * cell[i]
        return float(np.sqrt((noise + drawn) / n) / abs(square[i] - square[j]))

    return about(1, 2), about(0, 2), about(0, 1)


class Sensor(Protocol):
    """What sees the rectangle of a moving target."""

    rectangle: Rectangle

    def true_T_cam_rect(self, index: int) -> FloatArray:
        """(4, 4) where the rectangle is in a frame."""

    def observe(self, index: int) -> RectangleObservation | None:
        """The rectangle in a frame; None where it is not found."""


class CloudSensor:
    """Observes the rectangle of a moving target; each frame draws from its own stream.

    The noise is isotropic and the sheet is seen from both sides, so nothing depends on where the
    chaser looks from: that is the paper's simulation, not a depth camera.
    """

    def __init__(self, motion: TrueMotion, noise_m: float, spacing: Spacing, seed: int) -> None:
        self._motion, self.noise_m, self._spacing = motion, noise_m, spacing
        self._generator = np.random.default_rng(seed)
        self.rectangle: Rectangle = paper.RECTANGLE
        self._grid = self._cloud() if spacing is Spacing.EVEN else None

    def _cloud(self) -> FloatArray:
        return rectangle_cloud(
            self.rectangle.width_m,
            self.rectangle.length_m,
            paper.CLOUD_POINTS,
            self._spacing,
            self._generator,
        )

    def true_T_cam_rect(self, index: int) -> FloatArray:
        """(4, 4) where the rectangle is in a frame."""
        return np.asarray(self._motion.truth.poses[index] @ self.rectangle.T_model_rect)

    def points(self, index: int) -> FloatArray:
        """(n, 3) the frame's cloud, camera axes; frames are drawn in the order asked for."""
        cloud = self._cloud() if self._grid is None else self._grid
        points = transform_points(self.true_T_cam_rect(index), cloud)
        return points + self.noise_m * self._generator.standard_normal(points.shape)

    def observe(self, index: int) -> RectangleObservation:
        """What the moments of the frame's cloud say."""
        return observe_cloud(
            self.points(index),
            self.noise_m**2 * np.eye(3),
            evenly_spread=self._spacing is Spacing.EVEN,
        )


def resolved(
    observation: RectangleObservation, R_cam_rect_predicted: FloatArray, rectangle: Rectangle
) -> FloatArray:
    """(4, 4) the observed pose in the case of the ambiguity nearest to the prediction."""
    case, _ = resolve_case(observation.T_cam_rect[:3, :3], R_cam_rect_predicted, rectangle)
    return apply_case(observation.T_cam_rect, case)
