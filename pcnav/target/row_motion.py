"""A target that moves while an image is taken, whose pixels are exposed at times of their own."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import exp_rotation


@dataclass(frozen=True)
class Readout:
    """How a target moves in the camera while a frame is taken: to second order in time."""

    twist: FloatArray
    """(6,) rate of its pose in the camera: of the model origin (m/s, camera axes) and rotation
    (rad/s, model axes)."""
    bend: FloatArray | None = None
    """(6,) half of what that changes by, per second; None for not known."""
    own: FloatArray | None = None
    """(6,) what of the twist is the target's own motion, where it is that of an estimated state:
    what a frame shows is then off by as much as the state's rates are."""

    def poses(self, T_cam_model: FloatArray, times_s: FloatArray) -> FloatArray:
        """(k, 4, 4) at times (k,) from that of the frame on, of a target with a pose (4, 4) at the
        time of the frame."""
        moved = np.broadcast_to(T_cam_model, (len(times_s), 4, 4)).copy()
        motion = times_s[:, None] * self.twist
        if self.bend is not None:
            motion = motion + times_s[:, None] ** 2 * self.bend
        moved[:, :3, 3] += motion[:, :3]
        moved[:, :3, :3] = moved[:, :3, :3] @ exp_rotation(motion[:, 3:])
        return moved


def row_times(row_readout_s: float, height: int) -> FloatArray:
    """(height,) from the time of a frame to the exposure of each row, s."""
    return np.asarray(row_readout_s * (np.arange(height) / max(height - 1, 1) - 0.5))


@dataclass(frozen=True)
class Exposure:
    """Where a target is when each pixel of an image is exposed."""

    poses: FloatArray
    """(k, 4, 4) T_cam_model at some times; of an image that is read out by rows, at each row's."""
    index: IntArray
    """(height, width) which of them holds for a pixel."""
    rays: FloatArray | None = None
    """(height, width, 3) that the pixels look along, z = 1; None for those through their centres,
    read out by rows."""
    is_scattered: bool = False
    """Whether they look anywhere, and not about the pixels' own centres."""
    times_s: FloatArray | None = None
    """(k,) of the poses, from the time of the frame on; None where nobody asks."""

    @staticmethod
    def by_rows(row_poses: FloatArray, width: int, times_s: FloatArray | None = None) -> "Exposure":
        """Of rows that are read out one after the other, with a pose (height, 4, 4) each, at times
        (height,)."""
        height = len(row_poses)
        index = np.broadcast_to(np.arange(height)[:, None], (height, width))
        return Exposure(row_poses, index, times_s=times_s)


@dataclass(frozen=True)
class MovingPlanes:
    """A mesh that moves, and the planes of its faces, as the pixels of an image see them."""

    normals: FloatArray
    """(n_faces, 3) model frame."""
    offsets: FloatArray
    """(n_faces,) of the planes from the model origin along them, m."""
    exposure: Exposure

    def at(self, triangle: IntArray, index: IntArray) -> FloatArray:
        """(k, 3) m of faces (k,) at poses (k,), with ``1 / z = m . ray`` for a ray (z = 1)."""
        poses = self.exposure.poses
        R, p = poses[index, :3, :3], poses[index, :3, 3]
        normal = np.einsum("kij,kj->ki", R, self.normals[triangle])
        # n . x = offset in the model frame is n_cam . (x_cam - p) = offset in the camera's.
        distance = self.offsets[triangle] + np.einsum("ki,ki->k", normal, p)
        return np.asarray(normal / np.where(distance == 0.0, np.nan, distance)[:, None])

    def moved(self, p_model: FloatArray, pixels: FloatArray) -> FloatArray:
        """(..., 3) where points (..., 3) of the model are in the camera when pixels (..., 2), also
        between two rows, are exposed, m."""
        if self.exposure.rays is not None:
            last = np.array(self.exposure.index.shape)[::-1] - 1.0
            u, v = np.moveaxis(np.rint(np.clip(pixels, 0.0, last)).astype(np.intp), -1, 0)
            return self._carried(p_model, self.exposure.index[v, u])
        last_row = len(self.exposure.poses) - 1
        at = np.clip(pixels[..., 1], 0.0, last_row)
        below = np.minimum(np.floor(at).astype(np.intp), max(last_row - 1, 0))
        share = (at - below)[..., None]
        first = self._carried(p_model, below)
        second = self._carried(p_model, np.minimum(below + 1, last_row))
        return np.asarray(first + share * (second - first))

    def _carried(self, p_model: FloatArray, index: IntArray) -> FloatArray:
        poses = self.exposure.poses[index]
        return np.asarray(
            np.einsum("...ij,...j->...i", poses[..., :3, :3], p_model) + poses[..., :3, 3]
        )
