"""How far the distance by ranges and that by the outline lie apart, frame by frame.

An offset that all returns of a frame share moves the one and not the other. The outline may be seen
off its place as well: by as much in all frames, which says nothing, and by a little more or less in
each. Levels of both on a grid are weighed by how well they predict what frames show.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import logsumexp

from pcnav.core.arrays import FloatArray
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.outline_belief import odds_of_none
from pcnav.perception.sensor_noise import OUTLINE_PRIOR_SD_PX, SensorNoise

_MEMORY = 0.98
_UNEVEN_PX = np.array([0.0, 0.02, 0.05, 0.1, 0.2])
"""By how much an outline may be seen elsewhere in each frame,"""
_UNEVEN_SHARE = np.array([0.5, 0.2, 0.15, 0.1, 0.05])
"""and how probable that is beforehand."""
_N_OFFSETS = 4
_CLEAR_ODDS = 1.0
"""Logarithm of the odds for no offset at which there is none."""


@dataclass(frozen=True)
class RangeAgainstOutline:
    """The odds of levels of an offset of a frame."""

    levels_m: FloatArray
    """(n,) standard deviations."""
    loose: FloatArray
    """(6,) how far a pose found may be off."""
    mean_px: FloatArray
    """(n, k, 4) of the outline's offsets that all frames share, for each level and each of what
    frames do not share."""
    covariance_px2: FloatArray
    """(n, k, 4, 4)"""
    log_weights: FloatArray
    """(n, k)"""

    @staticmethod
    def before_any_frame(levels_m: FloatArray, loose: FloatArray) -> "RangeAgainstOutline":
        """Nothing known but how far off outlines are seen."""
        shape = (len(levels_m), len(_UNEVEN_PX))
        covariance = np.eye(_N_OFFSETS) * OUTLINE_PRIOR_SD_PX**2
        return RangeAgainstOutline(
            *(levels_m, loose, np.zeros((*shape, _N_OFFSETS))),
            np.broadcast_to(covariance, (*shape, _N_OFFSETS, _N_OFFSETS)),
            np.broadcast_to(np.log(_UNEVEN_SHARE), shape),
        )

    @cached_property
    def log_likelihood(self) -> FloatArray:
        """(n,) of each level."""
        return np.asarray(logsumexp(self.log_weights, axis=1))

    @property
    def shows_exact_outline(self) -> bool:
        """Whether the outline lies where it should, but for what ranges err by in single frames."""
        likeliest = np.unravel_index(np.argmax(self.log_weights), self.log_weights.shape)
        space = slice(0, 2)
        mean, covariance = self.mean_px[likeliest], self.covariance_px2[likeliest]
        return odds_of_none(mean[space], covariance[space, space]) > _CLEAR_ODDS

    def with_frame(self, together: Evidence, noise: SensorNoise) -> "RangeAgainstOutline":
        """Take in what the faces of a frame say together, under the noise they were measured by."""
        if not noise.has_shared_errors:
            return self
        seen = _of_shared(together, noise, self.loose)
        n, k = self.log_weights.shape
        spread = np.zeros((n, k, 1 + _N_OFFSETS, 1 + _N_OFFSETS))
        spread[..., 0, 0] = self.levels_m[:, None] ** 2
        spread[..., 1:, 1:] = self.covariance_px2
        spread[..., 1:, 1:] += (_UNEVEN_PX**2)[:, None, None] * np.eye(_N_OFFSETS)
        mean = np.zeros((n, k, 1 + _N_OFFSETS))
        mean[..., 1:] = self.mean_px
        left = seen.vector - mean @ seen.information
        inner = np.eye(1 + _N_OFFSETS) + seen.information @ spread
        both = np.concatenate(
            [left[..., None], np.broadcast_to(seen.information, inner.shape)], axis=-1
        )
        solved = np.linalg.solve(inner, both)
        # Of the information the columns of the offsets, after the row of the frame's own.
        gain = self.covariance_px2 @ solved[..., 1:, 2:]
        moved = np.einsum("nkij,nkj->nki", spread, solved[..., 0])
        log_likelihood = (
            -0.5 * np.linalg.slogdet(inner)[1]
            + mean @ seen.vector
            - 0.5 * np.einsum("nki,ij,nkj->nk", mean, seen.information, mean)
            + 0.5 * np.einsum("nki,nki->nk", left, moved)
        )
        shift = np.einsum("nkij,nkj->nki", self.covariance_px2, solved[..., 1:, 0])
        covariance = self.covariance_px2 - gain @ self.covariance_px2
        weights = _MEMORY * self.log_weights + log_likelihood
        return replace(
            self,
            mean_px=self.mean_px + shift,
            covariance_px2=0.5 * (covariance + np.swapaxes(covariance, -1, -2)),
            log_weights=weights - weights.max(),
        )


def _of_shared(together: Evidence, noise: SensorNoise, loose: FloatArray) -> Evidence:
    """(5,) of the offset of the frame, m, and those of the outline, px, the pose being anywhere."""
    sd = np.array(noise.outline_offset_sd_px)
    units = np.concatenate([[noise.frame_unit_m], sd])
    scale = np.ones(len(together.vector))
    scale[POSE_SIZE:] = np.divide(1.0, units, out=np.zeros(len(units)), where=units > 0.0)
    information = together.information * np.outer(scale, scale)
    vector = together.vector * scale
    vector = vector + information[:, POSE_SIZE + 1 :] @ noise.outline_offset_px
    inner = information[:POSE_SIZE, :POSE_SIZE] + np.diag(loose**-2.0)
    cross = information[:POSE_SIZE, POSE_SIZE:]
    solved = np.linalg.solve(inner, np.column_stack([cross, vector[:POSE_SIZE]]))
    kept = information[POSE_SIZE:, POSE_SIZE:] - cross.T @ solved[:, :-1]
    return Evidence(0.5 * (kept + kept.T), vector[POSE_SIZE:] - cross.T @ solved[:, -1])
