"""Poses at the times at which the rows of a frame are exposed."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.target.row_motion import Exposure, row_times


class Exposures(Protocol):
    """When the pixels of a sensor's frames are exposed."""

    def of_frame(
        self, number: int, T_cam_body: FloatArray, k: int, camera: PinholeCamera
    ) -> Exposure | None:
        """Of the pixels of frame k to one of the bodies, with poses (n, 4, 4) in all frames; None
        where these do not tell how it moves."""


@dataclass(frozen=True)
class RowTimes:
    """When the rows of the frames of a sensor are exposed that reads one after the other."""

    times_s: FloatArray
    """(n,) true times of the frames, those of their middle rows."""
    row_readout_s: float
    """From the exposure of the first row to that of the last."""

    def of_frame(
        self, number: int, T_cam_body: FloatArray, k: int, camera: PinholeCamera
    ) -> Exposure | None:
        """See `Exposures.of_frame`."""
        poses = self.poses(T_cam_body, k, camera.height)
        return None if poses is None else Exposure.by_rows(poses, camera.width)

    def poses(self, T_cam_body: FloatArray, k: int, height: int) -> FloatArray | None:
        """(height, 4, 4) poses of a body when the rows of frame k are exposed.

        The motion is taken through the poses T_cam_body (n, 4, 4) in the frame and in those beside
        it, quadratic in time: over a readout, which is short against the time between frames, what
        is left out is far below what any sensor resolves. None where the frames beside it do not
        tell how the body moves.
        """
        return self.at_times(T_cam_body, k, row_times(self.row_readout_s, height))

    def at_times(self, T_cam_body: FloatArray, k: int, times_s: FloatArray) -> FloatArray | None:
        """(m, 4, 4) likewise at times (m,) from that of frame k on."""
        beside = [j for j in (k - 1, k + 1) if 0 <= j < len(self.times_s)]
        beside = [j for j in beside if np.isfinite(T_cam_body[j]).all()]
        if not beside:
            return None
        motion = np.stack([_between(T_cam_body[k], T_cam_body[j]) for j in beside])
        powers = np.arange(1, len(beside) + 1)
        steps = self.times_s[beside] - self.times_s[k]
        rates = np.linalg.solve(steps[:, None] ** powers, motion)
        moved = (times_s[:, None] ** powers) @ rates
        R, p = T_cam_body[k, :3, :3], T_cam_body[k, :3, 3]
        return make_transform(R @ exp_rotation(moved[:, 3:]), p + moved[:, :3])


def _between(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """(6,) shift (camera axes) and turn (body axes) from one pose (4, 4) to another."""
    turn = log_rotation(T_from[:3, :3].T @ T_to[:3, :3])
    return np.concatenate([T_to[:3, 3] - T_from[:3, 3], turn])
