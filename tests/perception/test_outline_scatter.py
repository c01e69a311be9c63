"""The scatter of an outline, learnt from frames of a scatter and an offset that are known."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.perception.contour import ContourRuns
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.outline_scatter import OutlineScatter
from pcnav.perception.sensor_noise import SensorNoise

LEVER_M, SIGMA_M, PX_PER_M = 1.0, 0.01, 30.0
NOISE = SensorNoise(SIGMA_M, outline_offset_sd_px=(0.05, 0.05, 0.05, 0.05))
"""As it is known after the first frames: an offset of the outline is not what ranges are off by."""


def runs_of(rng: np.random.Generator, scatter_px: float) -> ContourRuns:
    """Forty stretches around a target, at the true pose."""
    n, own, by_scatter = 40, np.full(40, 0.03**2), rng.uniform(0.3, 1.0, 40)
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    H = PX_PER_M * rng.normal(0.0, 0.3, (n, POSE_SIZE))
    H[:, 0], H[:, 1] = PX_PER_M * np.cos(angle), PX_PER_M * np.sin(angle)
    # Farther away it is seen smaller: all of its outline lies further in.
    H[:, 2] = -0.2 * PX_PER_M
    value = np.sqrt(own + scatter_px**2 * by_scatter) * rng.normal(size=n)
    shared = np.column_stack([np.ones(n), np.abs(np.sin(2.0 * angle)), np.zeros((n, 2))])
    return ContourRuns(
        value,
        own,
        H,
        np.zeros(n, dtype=np.intp),
        shared,
        np.zeros(n),
        own,
        by_scatter,
        np.empty((n, 0)),
    )


def ranges_of(rng: np.random.Generator, offset_m: float) -> Evidence:
    """Sixty ranges in all directions, which err by an offset of their frame."""
    n = 60
    H = np.zeros((n, POSE_SIZE + NOISE.n_shared))
    H[:, :POSE_SIZE] = rng.normal(0.0, 0.5, (n, POSE_SIZE))
    H[:, 2], H[:, POSE_SIZE] = 1.0, NOISE.frame_unit_m
    variance = np.full(n, SIGMA_M**2)
    return Evidence.of(offset_m + SIGMA_M * rng.normal(size=n), variance, H)


def learnt(scatter_px: float, offset_sd_m: float) -> FloatArray:
    """Over eight draws, each of eight frames."""
    found = []
    for seed in range(8):
        rng, belief = np.random.default_rng(seed), OutlineScatter(LEVER_M)
        for offset_m in offset_sd_m * rng.normal(size=8):
            ranges = ranges_of(rng, float(offset_m))
            belief = belief.with_frame(runs_of(rng, scatter_px), NOISE, ranges)
        found.append(belief.applied(NOISE).outline_sd_px)
    return np.array(found)


@pytest.mark.parametrize("offset_sd_m", [0.0, 0.1])
def test_an_offset_of_the_ranges_of_a_frame_is_no_scatter_of_its_outline(
    offset_sd_m: float,
) -> None:
    assert not learnt(0.0, offset_sd_m).any()


@pytest.mark.parametrize("offset_sd_m", [0.0, 0.1])
@pytest.mark.parametrize("scatter_px", [0.1, 0.4])
def test_a_scatter_is_found_with_its_size(scatter_px: float, offset_sd_m: float) -> None:
    assert learnt(scatter_px, offset_sd_m) == pytest.approx(scatter_px, rel=0.25)
