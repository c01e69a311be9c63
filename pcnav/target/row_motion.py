"""A target that moves while the rows of an image are read out one after the other."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import exp_rotation


@dataclass(frozen=True)
class Readout:
    """How a target moves before a sensor that reads its rows out one after the other."""

    twist: FloatArray
    """(6,) rate of its pose in the camera: of the model origin (m/s, camera axes) and rotation
    (rad/s, model axes)."""
    row_readout_s: float
    """From the exposure of the first row to that of the last."""

    def poses(self, T_cam_model: FloatArray, height: int, stride: int = 1) -> FloatArray:
        """(rows, 4, 4) when each of so many rows is exposed, or every so many of them, of a target
        with a pose (4, 4) at the time of the frame, which is that of the middle row."""
        times_s = row_times(self.row_readout_s, height)[::stride]
        moved = np.broadcast_to(T_cam_model, (len(times_s), 4, 4)).copy()
        motion = times_s[:, None] * self.twist
        moved[:, :3, 3] += motion[:, :3]
        moved[:, :3, :3] = moved[:, :3, :3] @ exp_rotation(motion[:, 3:])
        return moved


def row_times(row_readout_s: float, height: int) -> FloatArray:
    """(height,) from the time of a frame to the exposure of each row, s."""
    return np.asarray(row_readout_s * (np.arange(height) / max(height - 1, 1) - 0.5))


@dataclass(frozen=True)
class RowPlanes:
    """A mesh that moves, and the planes of its faces, as each row of an image sees them."""

    normals: FloatArray
    """(n_faces, 3) model frame."""
    offsets: FloatArray
    """(n_faces,) of the planes from the model origin along them, m."""
    row_poses: FloatArray
    """(height, 4, 4) T_cam_model when each row is exposed."""

    def at(self, triangle: IntArray, row: IntArray) -> FloatArray:
        """(k, 3) m of faces (k,) at rows (k,), with ``1 / z = m . ray`` for a ray (z = 1)."""
        R, p = self.row_poses[row, :3, :3], self.row_poses[row, :3, 3]
        normal = np.einsum("kij,kj->ki", R, self.normals[triangle])
        # n . x = offset in the model frame is n_cam . (x_cam - p) = offset in the camera's.
        distance = self.offsets[triangle] + np.einsum("ki,ki->k", normal, p)
        return np.asarray(normal / np.where(distance == 0.0, np.nan, distance)[:, None])

    def moved(self, p_model: FloatArray, row: FloatArray) -> FloatArray:
        """(..., 3) where points (..., 3) of the model are in the camera when rows (...), also
        between two, are exposed, m."""
        last = len(self.row_poses) - 1
        at = np.clip(row, 0.0, last)
        below = np.minimum(np.floor(at).astype(np.intp), max(last - 1, 0))
        share = (at - below)[..., None]
        first, second = (
            np.einsum("...ij,...j->...i", self.row_poses[k, :3, :3], p_model)
            + self.row_poses[k, :3, 3]
            for k in (below, np.minimum(below + 1, last))
        )
        return np.asarray(first + share * (second - first))
