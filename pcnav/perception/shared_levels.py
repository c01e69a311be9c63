"""How large an error is that all pixels of a frame share.

It looks like a shift of the target; that it is none shows in how the distance scatters from frame
to frame, where the other directions do not. A target that accelerates does so in any direction, and
its places hang together in time. Levels of both on a grid are weighed by how well they predict the
places of a few successive frames (a marginal likelihood, exact for any number of frames).
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.special import logsumexp

from pcnav.core.arrays import FloatArray
from pcnav.filtering.predictive import log_densities
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.range_against_outline import RangeAgainstOutline
from pcnav.perception.sensor_noise import SensorNoise

_LOOSE = 0.05
"""A pose found is off by less than this share of the target, or rad."""
_WINDOW = 8
"""Frames whose places are taken together; older ones tell what they told of the levels."""
_MIN_FRAMES = 3
_MEMORY = 0.9
"""What a window says is worth this much when the next one is over."""
_LEVELS = np.geomspace(1e-5, 0.1, 17)
"""Offsets of frames, over half the diameter."""
_ACCELERATIONS = np.geomspace(1e-5, 1.0, 16)
"""Shifts that accelerations add over one frame, over half the diameter."""
_PRIOR_ODDS = np.log(1.0 / 30.0)
"""Most sensors have no offset that is new in every frame."""


@dataclass(frozen=True)
class _Place:
    """Where one frame alone sees the target."""

    time_s: float
    p_cam: FloatArray
    """(3,)"""
    covariance: FloatArray
    """(3, 3) but for an offset that the frame shares."""


@dataclass(frozen=True)
class FrameErrors:
    """What frames tell of an offset along the rays that each shares."""

    lever_m: float
    """Half the target's diameter."""
    against_outline: RangeAgainstOutline
    recent: tuple[_Place, ...] = ()
    log_likelihood: FloatArray = field(default_factory=lambda: np.zeros(1 + len(_LEVELS)))
    """Of no offset and of each level, by the windows before."""

    @staticmethod
    def before_any_frame(lever_m: float) -> "FrameErrors":
        """Of a target of half the diameter ``lever_m``."""
        levels = np.concatenate([[0.0], _LEVELS]) * lever_m
        loose = _LOOSE * np.array([lever_m] * 3 + [1.0] * 3)
        return FrameErrors(lever_m, RangeAgainstOutline.before_any_frame(levels, loose))

    def with_frame(
        self, time_s: float, T_cam_model: FloatArray, together: Evidence, noise: SensorNoise
    ) -> "FrameErrors":
        """Take in what a frame alone says.

        Args:
            time_s: when.
            T_cam_model: (4, 4) pose that it was compared with.
            together: (6 + k) what its faces say together, under
            noise: that they were measured under.
        """
        recent, before = self.recent, self.log_likelihood
        if len(recent) == _WINDOW:
            recent, before = (), _MEMORY * (before + self._of_recent())
        alone = _without_offset(together)
        loose = np.diag(self.against_outline.loose**-2.0)
        covariance = np.asarray(np.linalg.inv(alone.information + loose))
        place = T_cam_model[:3, 3] + (covariance @ alone.vector)[:3]
        seen = _Place(time_s, place, covariance[:3, :3])
        return FrameErrors(
            self.lever_m,
            self.against_outline.with_frame(together, noise),
            (*recent, seen),
            before,
        )

    def shows_exact_outline(self, noise: SensorNoise) -> bool:
        """Whether the outline is seen where it is: it then tells what ranges err by."""
        if noise.outline_sd_px > 0.0 or noise.has_footprint:
            return False
        known = not any(noise.outline_offset_sd_px[:2])
        return known or self.against_outline.shows_exact_outline

    def possible_m(self, noise: SensorNoise) -> float:
        """Root mean square of an offset of a frame, by all that is believed of it."""
        log_likelihood = self._of_all(noise)
        of_levels = log_likelihood[1:] - np.log(len(_LEVELS)) + _PRIOR_ODDS
        total = logsumexp(np.append(of_levels, log_likelihood[0]))
        return float(self.lever_m * np.sqrt(np.exp(of_levels - total) @ _LEVELS**2))

    def _of_all(self, noise: SensorNoise) -> FloatArray:
        """(1 + n,) log-likelihood of no offset and of each level, by all frames."""
        log_likelihood = self.log_likelihood + self._of_recent()
        if self.shows_exact_outline(noise):
            log_likelihood = log_likelihood + self.against_outline.log_likelihood
        return log_likelihood

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of an offset of a frame."""
        log_likelihood = self._of_all(noise)
        of_levels = log_likelihood[1:] - np.log(len(_LEVELS))
        if float(logsumexp(of_levels)) + _PRIOR_ODDS < log_likelihood[0]:
            return replace(noise, frame_sd_m=0.0)
        weights = np.exp(of_levels - logsumexp(of_levels))
        # The middle of what is likely: few frames leave a long tail of levels.
        return replace(noise, frame_sd_m=float(self.lever_m * np.exp(weights @ np.log(_LEVELS))))

    def _of_recent(self) -> FloatArray:
        """(1 + n,) log-likelihood of no offset and of each level, by the frames of this window."""
        n = len(self.recent)
        if n < _MIN_FRAMES:
            return np.zeros(1 + len(_LEVELS))
        times = np.array([each.time_s for each in self.recent])
        places = np.stack([each.p_cam for each in self.recent])
        step = np.mean(np.diff(times))
        uneven, forced = _of_motion(tuple(np.round((times - times[0]) / step, 3).tolist()))
        sight = places.mean(axis=0)
        sight = sight / np.linalg.norm(sight)
        axes = np.linalg.svd(sight[None])[2]
        own = np.stack([np.diag(axes @ each.covariance @ axes.T) for each in self.recent])
        off = uneven.T @ places @ axes.T
        measured = np.stack([uneven.T @ (part[:, None] * uneven) for part in own.T])
        accelerated = (_ACCELERATIONS[:, None, None] * self.lever_m) ** 2 * forced
        offsets = self.against_outline.levels_m[:, None, None, None] ** 2 * np.eye(len(forced))
        along = log_densities(off[:, 0], measured[0] + accelerated + offsets)
        across = sum(log_densities(off[:, axis], measured[axis] + accelerated) for axis in (1, 2))
        return np.asarray(logsumexp(along + across, axis=1))


@lru_cache(maxsize=8)
def _of_motion(times: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Of frames at times, in steps: combinations (n, m) of places, and a covariance (m, m).

    The combinations are those that an even motion leaves at zero, quadratic in time, of three
    frames straight; the covariance is that of white accelerations, which add a unit of variance to
    a place over one step.
    """
    t = np.array(times)
    even = np.vander(t - t.mean(), 2 if len(t) == _MIN_FRAMES else 3)
    uneven = np.linalg.svd(even)[0][:, even.shape[1] :]
    first, last = np.minimum.outer(t, t), np.maximum.outer(t, t)
    covariance = 0.5 * first**2 * (3.0 * last - first)
    return uneven, uneven.T @ covariance @ uneven


def _without_offset(together: Evidence) -> Evidence:
    """Of the pose alone, if no offset is shared."""
    if len(together.vector) == POSE_SIZE:
        return together
    kept = np.delete(np.arange(len(together.vector)), POSE_SIZE)
    return Evidence(together.information[np.ix_(kept, kept)], together.vector[kept]).of_pose
