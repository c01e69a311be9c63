"""Targets that are turned about an axis, or about a point, without anything to show it."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform


@dataclass(frozen=True)
class Roundness:
    """How a target can be turned by any angle and look as before."""

    point_model: FloatArray
    """(3,) on the axis of a body of revolution, or the middle of a ball; model frame, m."""
    axes_model: FloatArray
    """(k, 3) unit vectors: one, the axis of a body of revolution, or three, of a ball."""
    deviation_m: float = 0.0
    """How far, in root mean square, turns move the facets of its mesh off the surface: so far the
    mesh is from the round body that it stands for."""

    @property
    def is_ball(self) -> bool:
        """Whether it can be turned about any axis."""
        return len(self.axes_model) == 3

    def turns(self, rotation_vectors: FloatArray) -> FloatArray:
        """(..., 4, 4) motions of the model frame by rotation vectors (..., 3) about the point."""
        R = exp_rotation(rotation_vectors)
        return make_transform(R, self.point_model - R @ self.point_model)

    def towards(self, R_relative: FloatArray) -> FloatArray:
        """(..., 4, 4) the turns of which no trace is seen that come nearest to rotations
        (..., 3, 3) of the model frame."""
        if self.is_ball:
            return self.turns(log_rotation(R_relative))
        (axis,) = self.axes_model
        # The trace of exp(-angle axis) R is largest where its derivative by the angle is zero.
        skew_part = R_relative - np.swapaxes(R_relative, -1, -2)
        vee = np.stack([skew_part[..., 2, 1], skew_part[..., 0, 2], skew_part[..., 1, 0]], axis=-1)
        along = np.einsum("i,...ij,j->...", axis, R_relative, axis)
        trace = np.trace(R_relative, axis1=-2, axis2=-1)
        angle = np.arctan2(vee @ axis, trace - along)
        return self.turns(angle[..., None] * axis)

    def without_turns(self, R_cam_model: FloatArray) -> FloatArray:
        """(6, 6) the projection of errors of a pose with this rotation (3, 3) that takes out turns
        about the axes.

        The error is a shift of the model origin, camera axes, and a rotation vector, model axes.
        What is projected moves no other point of the target than the error does, but along itself.
        """
        projection = np.eye(6)
        for axis in self.axes_model:
            moved_origin = np.cross(self.point_model, axis)
            projection[:3, 3:] -= np.outer(R_cam_model @ moved_origin, axis)
            projection[3:, 3:] -= np.outer(axis, axis)
        return projection
