"""Figs. 8-16 as a whole: the plane by RANSAC, the rectangle recognised, then its moments.

The paper draws the points of the rectangle alone and takes their moments. Here the rectangle stands
among another face and outliers; nobody says which points are its own.
"""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform, transform_points
from pcnav.perception.planes import ransac_plane, trial_count
from pcnav.perception.recognition import recognise
from pcnav.perception.rectangles import RectangleObservation, observe_cloud
from pcnav.target.catalogue import Rectangle

from . import paper
from .clouds import CloudSensor, Spacing, rectangle_cloud

OTHER = Rectangle(
    name="other face",
    T_model_rect=make_transform(np.eye(3), np.array([0.0, 0.0, -3.0])),
    length_m=6.0,
    width_m=4.0,
    two_sided=True,
)
OTHER_POINTS = 240
"""As many to a square metre as on the rectangle."""
OUTLIERS = 100
"""Of Table 1's the fewest."""
THRESHOLD_SD = 4.0
"""A point of the plane is farther from it once in 16,000 times. At three deviations five of 1800
would be left out, and which they are would move the centroid by more than all the noise does."""
_SUCCESS, _GATE_SD = 0.9999, 4.0
_PLANES = 3
"""So many are looked at in a frame."""
_STREAM = 2


class ExtractedSensor:
    """A sensor of moments that must first find the points of its rectangle."""

    def __init__(self, clouds: CloudSensor, outliers: int, seed: int) -> None:
        """``outliers`` are uniform in the box over the rectangle, as in Table 1."""
        self._clouds, self._outliers = clouds, outliers
        self._generator = np.random.default_rng([seed, _STREAM])
        self._face = rectangle_cloud(
            *(OTHER.width_m, OTHER.length_m, OTHER_POINTS, Spacing.EVEN, self._generator)
        )
        self.rectangle = clouds.rectangle

    def true_T_cam_rect(self, index: int) -> FloatArray:
        """(4, 4) where the rectangle is in a frame."""
        return self._clouds.true_T_cam_rect(index)

    def observe(self, index: int) -> RectangleObservation | None:
        """The rectangle, recognised on one of the frame's planes; None where it is on none."""
        noise_m, left = self._clouds.noise_m, self._cloud(index)
        wanted = paper.CLOUD_POINTS / len(left)
        trials = trial_count(1.0 - wanted, _SUCCESS)
        for _ in range(_PLANES):
            m = ransac_plane(left, THRESHOLD_SD * noise_m, trials, index)
            if m is None:
                return None
            near = np.abs(left @ m - 1.0) <= THRESHOLD_SD * noise_m * np.linalg.norm(m)
            found = observe_cloud(left[near], noise_m**2 * np.eye(3), evenly_spread=True)
            known = recognise(found, (self.rectangle, OTHER), _GATE_SD)
            if known and known[0].rectangle is self.rectangle:
                return found
            left = left[~near]
        return None

    def _cloud(self, index: int) -> FloatArray:
        """(n, 3) all points of a frame, in no order that tells one from another."""
        T_cam_rect, generator = self.true_T_cam_rect(index), self._generator
        T_rect_other = np.linalg.inv(self.rectangle.T_model_rect) @ OTHER.T_model_rect
        face = transform_points(T_cam_rect @ T_rect_other, self._face)
        face = face + self._clouds.noise_m * generator.standard_normal(face.shape)
        sides = [self.rectangle.width_m, self.rectangle.length_m, paper.BOX_DEPTH_M]
        strays = generator.uniform(-0.5, 0.5, (self._outliers, 3)) * sides
        strays = transform_points(T_cam_rect, strays)
        cloud = np.concatenate([self._clouds.points(index), face, strays])
        return np.asarray(generator.permutation(cloud))
