"""Recorded times of frames, which are not quite those at which they were taken."""

from pathlib import Path

import numpy as np

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError

_MAX_SHARE = 0.49
"""Of the time between two frames, that a stamp may be off by: frames keep their order."""
_STAMP_STREAM = 3


def recorded_times(
    times_s: FloatArray, noise: NoiseTable, seed: int, source: Path | str = "pipeline"
) -> FloatArray:
    """(n,) increasing times that a recording states of frames taken at times (n,).

    Raises `InputError`, which names the source, for a step that gives two frames one time.
    """
    recorded = times_s
    if noise.stamp_jitter_s > 0.0 and len(times_s) > 1:
        rng = np.random.default_rng([seed, _STAMP_STREAM])
        most = _MAX_SHARE * float(np.diff(times_s).min())
        off = noise.stamp_jitter_s * rng.standard_normal(len(times_s))
        recorded = times_s + np.clip(off, -most, most)
    if noise.stamp_step_s > 0.0:
        recorded = np.rint(recorded / noise.stamp_step_s) * noise.stamp_step_s
    if np.any(np.diff(recorded) <= 0.0):
        expected = "expected a step that leaves every frame a time of its own"
        raise InputError(source, "noise.stamp_step_s", expected)
    return recorded
