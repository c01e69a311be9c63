"""The paper's idealised sensor: a cloud of one rectangle in every frame, whatever its attitude."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import transform_points
from pcnav.perception.ambiguity import AxesCase, apply_case, resolve_case
from pcnav.perception.rectangles import RectangleObservation, observe_cloud
from pcnav.simulation.scenario import TrueMotion
from pcnav.target.catalogue import Rectangle

from . import paper
from .clouds import Spread, rectangle_cloud


class CloudSensor:
    """Observes the rectangle of a moving target; each frame draws from its own stream.

    The noise is isotropic and the sheet is seen from both sides, so nothing depends on where the
    chaser looks from: that is the paper's simulation, not a depth camera.
    """

    def __init__(self, motion: TrueMotion, noise_m: float, spread: Spread, seed: int) -> None:
        self._motion, self._noise_m, self._spread = motion, noise_m, spread
        self._generator = np.random.default_rng(seed)
        self.rectangle: Rectangle = paper.RECTANGLE
        self._grid = self._cloud() if spread is Spread.EVEN else None

    def _cloud(self) -> FloatArray:
        return rectangle_cloud(
            self.rectangle.width_m,
            self.rectangle.length_m,
            paper.CLOUD_POINTS,
            self._spread,
            self._generator,
        )

    def true_T_cam_rect(self, index: int) -> FloatArray:
        """(4, 4) where the rectangle is in a frame."""
        return np.asarray(self._motion.T_cam_model(index) @ self.rectangle.T_model_rect)

    def observe(self, index: int) -> RectangleObservation:
        """What the moments of the frame's cloud say; frames are drawn in the order asked for."""
        cloud = self._cloud() if self._grid is None else self._grid
        points = transform_points(self.true_T_cam_rect(index), cloud)
        points = points + self._noise_m * self._generator.standard_normal(points.shape)
        return observe_cloud(
            points,
            self._noise_m**2 * np.eye(3),
            evenly_spread=self._spread is Spread.EVEN,
        )


def resolved(
    observation: RectangleObservation, R_cam_rect_predicted: FloatArray, rectangle: Rectangle
) -> tuple[FloatArray, AxesCase]:
    """The observed pose (4, 4) in the case nearest to the prediction, and the case."""
    case, _ = resolve_case(observation.T_cam_rect[:3, :3], R_cam_rect_predicted, rectangle)
    return apply_case(observation.T_cam_rect, case), case
