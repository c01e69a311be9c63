"""How far what a pose predicts may be from what is seen, for all that is known of the pose."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray

GATE_SIGMA = 4.0
"""A return belongs to a predicted surface when it is this near, in standard deviations."""


@dataclass(frozen=True)
class PoseDoubt:
    """A pose, how uncertain it is, and what else makes a surface differ from where it is seen."""

    T_cam_model: FloatArray
    """(4, 4)"""
    covariance: FloatArray
    """(6, 6) of its error: translation of the model origin (m, camera axes), rotation (rad, model
    axes)."""
    sigma_m: float
    """Range noise."""
    without_turns: FloatArray | None = None
    """(6, 6) projection of its error that takes out turns of which a round target shows no trace:
    what its facets seem to say of them is that of the mesh, not of the target."""

    def by_pose(self, gradient: FloatArray, p_cam: FloatArray) -> FloatArray:
        """(n, 6) derivative by the pose of what changes by gradients (n, 3) where points of the
        target (n, 3) move."""
        R = self.T_cam_model[:3, :3]
        p_model = (p_cam - self.T_cam_model[:3, 3]) @ R
        jacobian = np.empty((len(gradient), 6))
        jacobian[:, :3], (a, b, c), (x, y, z) = gradient, p_model.T, (gradient @ R).T
        # The cross product of rows, which NumPy's own takes several times as long for.
        jacobian[:, 3], jacobian[:, 4], jacobian[:, 5] = b * z - c * y, c * x - a * z, a * y - b * x
        return jacobian if self.without_turns is None else jacobian @ self.without_turns

    def variance(self, jacobian: FloatArray) -> FloatArray:
        """(n,) variance that the pose's error makes of quantities with derivatives (n, 6) by it."""
        return np.asarray(np.einsum("ij,ij->i", jacobian @ self.covariance, jacobian))

    def tolerance(self, planes: FloatArray, p_cam: FloatArray) -> FloatArray:
        """(n,) metres within which returns belong to planes (n, 3), near points (n, 3) on them.

        Where a surface moves by dx the depth along a ray changes by ``z m . dx``: on steep faces by
        many times as much.
        """
        variance = self.variance(self.by_pose(planes * p_cam[:, 2:], p_cam))
        return np.asarray(GATE_SIGMA * np.sqrt(self.sigma_m**2 + variance))
