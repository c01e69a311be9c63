"""Where a sensor sees an outline, learnt from frames: offsets that all frames share.

A pixel returns when enough of its area is covered, so the outline of a real sensor lies off that of
the model by a constant, known only from frames. Opposite edges of one frame tell it apart from a
shift of the target. A sensor that samples the centre of each pixel has none: of that and of an
offset the frames decide by their odds.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.sensor_noise import OUTLINE_PRIOR_SD_PX, Offsets, SensorNoise

_N_OFFSETS = 4
_GROUPS = ((0, 1), (2, 3))
"""Offsets that are there or not together: before space, and before another surface."""
_EXACT_SD_PX = 0.01
"""How near to zero the offsets of a sensor are that has none."""
_CLEAR_ODDS = 3.0
"""Logarithm of the odds for none at which there is none."""
_LIKELY_ODDS = 1.0
"""The same before surfaces, of a sensor that has none before space."""
_FRAMES_ALIKE = 2.0
"""Errors of successive frames are alike: two tell as much as one."""
_MAX_COMMON = 20
"""An offset that is wrong is so in all frames. Each is told so much less of it that so many
together are not surer of their mean than the offset is known."""


@dataclass(frozen=True)
class OutlineBelief:
    """What the frames so far tell of the outline."""

    information: FloatArray = field(
        default_factory=lambda: np.eye(_N_OFFSETS) / OUTLINE_PRIOR_SD_PX**2
    )
    """(4, 4) of the offsets, the prior included."""
    vector: FloatArray = field(default_factory=lambda: np.zeros(_N_OFFSETS))
    """(4,) information times offsets."""
    frames: int = 0

    def with_frame(self, seen: Evidence, noise: SensorNoise, lever_m: float) -> "OutlineBelief":
        """Take in what a frame alone says of the offsets.

        Args:
            seen: (6 + k) of its faces together, under
            noise: that they were measured under.
            lever_m: half the target's diameter.
        """
        sd = np.array(noise.outline_offset_sd_px)
        if not noise.has_shared_errors or not sd.any():
            return self
        told = _of_offsets(seen, noise, lever_m)
        return replace(
            self,
            information=self.information + told.information / _FRAMES_ALIKE,
            vector=self.vector + told.vector / _FRAMES_ALIKE,
            frames=self.frames + 1,
        )

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of the outline."""
        offset, sd = np.array(noise.outline_offset_px), np.array(noise.outline_offset_sd_px)
        covariance, mean = np.linalg.inv(self.information), self._offsets
        common = min(max(self.frames, 1), _MAX_COMMON)
        for group in _GROUPS:
            part = np.ix_(group, group)
            index = list(group)
            if not sd[index].any():
                continue
            odds = odds_of_none(mean[index], np.asarray(covariance[part]))
            clear = _CLEAR_ODDS if sd[0] > 0.0 or group == _GROUPS[0] else _LIKELY_ODDS
            if odds > clear:
                offset[index], sd[index] = 0.0, 0.0
                continue
            offset[index] = mean[index]
            known = np.sqrt(common * np.diag(covariance)[index])
            sd[index] = np.minimum(known, OUTLINE_PRIOR_SD_PX)
        return replace(
            noise,
            outline_offset_px=_offsets(offset),
            outline_offset_sd_px=_offsets(sd),
        )

    @property
    def _offsets(self) -> FloatArray:
        return np.asarray(np.linalg.solve(self.information, self.vector))


def _of_offsets(seen: Evidence, noise: SensorNoise, lever_m: float) -> Evidence:
    """Of the offsets in pixels, the pose being anywhere near."""
    offset, sd = np.array(noise.outline_offset_px), np.array(noise.outline_offset_sd_px)
    size = len(seen.vector)
    per_sd = np.ones(size)
    per_sd[-_N_OFFSETS:] = np.divide(1.0, sd, out=np.zeros(_N_OFFSETS), where=sd > 0.0)
    information = seen.information * np.outer(per_sd, per_sd)
    vector = seen.vector * per_sd + information[:, -_N_OFFSETS:] @ offset
    loose = np.array([lever_m] * 3 + [1.0] * 3)
    others = size - _N_OFFSETS
    inner = information[:others, :others] + np.diag(
        np.concatenate([1.0 / (_LOOSE * loose) ** 2, np.ones(others - POSE_SIZE)])
    )
    cross = information[:others, others:]
    solved = np.linalg.solve(inner, np.column_stack([cross, vector[:others]]))
    kept = information[others:, others:] - cross.T @ solved[:, :_N_OFFSETS]
    return Evidence(0.5 * (kept + kept.T), vector[others:] - cross.T @ solved[:, _N_OFFSETS])


_LOOSE = 0.05
"""A pose found is off by less than this share of the target, or rad."""


def odds_of_none(mean_px: FloatArray, covariance_px2: FloatArray) -> float:
    """Logarithm of the odds that there are no offsets, which are known as (k,) and (k, k), over
    that they are as little known as before any frame (Dickey 1971)."""
    unit = np.eye(len(mean_px))
    none = _log_density(mean_px, covariance_px2 + _EXACT_SD_PX**2 * unit)
    return none - _log_density(np.zeros(len(mean_px)), OUTLINE_PRIOR_SD_PX**2 * unit)


def _log_density(error: FloatArray, covariance: FloatArray) -> float:
    squared = float(error @ np.linalg.solve(covariance, error))
    return -0.5 * (squared + float(np.linalg.slogdet(2.0 * np.pi * covariance)[1]))


def _offsets(values: FloatArray) -> Offsets:
    first, second, third, fourth = values.tolist()
    return first, second, third, fourth
