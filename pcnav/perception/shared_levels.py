"""How large an error is that all pixels of a frame share.

It looks like a shift of the target; that it is none shows in how the distance scatters from frame
to frame, where the other directions do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.modality import Evidence
from pcnav.perception.sensor_noise import SensorNoise

_MEMORY = 0.98
_LOOSE = 0.05
"""A pose found is off by less than this share of the target, or rad."""
_WINDOW = 5
"""Over so many frames a motion is even: quadratic in time."""
_MIN_WINDOWS = 2
_CLEAR_RATIO, _FEW_WINDOWS = 4.0, 40.0
"""So many times must the squares along the line of sight be those across it, and those expected;
and more, by this over the square of their number, while windows are few."""


@dataclass(frozen=True)
class _Place:
    """Where one frame alone sees the target."""

    time_s: float
    p_cam: FloatArray
    """(3,)"""
    covariance: FloatArray
    """(3, 3)"""


@dataclass(frozen=True)
class FrameErrors:
    """What frames tell of an offset along the rays that each shares."""

    recent: tuple[_Place, ...] = ()
    squares: FloatArray = field(default_factory=lambda: np.zeros(4))
    """Sums over windows: along the line of sight, across it, and what of both is expected; m^2."""
    windows: float = 0.0

    def with_frame(
        self,
        time_s: float,
        T_cam_model: FloatArray,
        faces: Sequence[Evidence],
        lever_m: float,
        frame_sd_m: float,
    ) -> "FrameErrors":
        """Take in what the faces of a frame say of the pose (4, 4) that they were compared with."""
        total = Evidence.together((face.of_pose for face in faces), 0)
        loose = _LOOSE * np.array([lever_m] * 3 + [1.0] * 3)
        covariance = np.asarray(np.linalg.inv(total.information + np.diag(loose**-2.0)))
        place = T_cam_model[:3, 3] + (covariance @ total.vector)[:3]
        recent = (*self.recent, _Place(time_s, place, covariance[:3, :3]))[-_WINDOW:]
        if len(recent) < _WINDOW:
            return replace(self, recent=recent)
        sight = place / np.linalg.norm(place)
        times = np.array([each.time_s for each in recent])
        even = np.vander((times - times.mean()) / np.ptp(times), 3)
        uneven = np.linalg.svd(even)[0][:, 3:]
        off = uneven.T @ np.stack([each.p_cam for each in recent])
        along = off @ sight
        variances = np.array([_along_and_across(each.covariance, sight) for each in recent])
        expected = (uneven**2).T @ variances
        across = 0.5 * (np.sum(off**2) - np.sum(along**2))
        # What is known to be there is not expected of the pose: it is what is measured.
        own = np.maximum(expected[:, 0].sum() - 2.0 * frame_sd_m**2, 0.0)
        new = np.array([np.sum(along**2), across, own, expected[:, 1].sum()])
        return FrameErrors(recent, _MEMORY * self.squares + new, _MEMORY * self.windows + 1.0)

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of an offset of a frame."""
        if self.windows < _MIN_WINDOWS:
            return noise
        along, across, expected, expected_across = self.squares / (2.0 * self.windows)
        # A motion that is not even moves the target in all directions.
        moved = max(across - expected_across, 0.0)
        ratio = _CLEAR_RATIO + _FEW_WINDOWS / self.windows**2
        clear = along > ratio * max(expected, moved)
        sd = float(np.sqrt(max(along - expected - moved, 0.0))) if clear else 0.0
        return replace(noise, frame_sd_m=sd)


def _along_and_across(covariance: FloatArray, sight: FloatArray) -> tuple[float, float]:
    along = float(sight @ covariance @ sight)
    return along, 0.5 * (float(np.trace(covariance)) - along)
