"""The random faults of the simulated depth sensor, each drawn from its own seeded stream."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.recordings.depth_png import MAXIMUM_UNITS
from pcnav.simulation.surroundings.view import SceneView
from pcnav.target.rendering import RenderedDepth, depth_beyond_edge


@dataclass(frozen=True)
class Systematic:
    """What a frame's ranges are off by, and what does not return, before any pixel's own draw."""

    range_error_m: FloatArray | float = 0.0
    """(height, width)"""
    lost: BoolArray | None = None
    """(height, width)"""
    false_span_m: tuple[float, float] = (0.0, 1.0)
    """Ranges between which false returns lie."""


def add_sensor_faults(
    rendered: RenderedDepth | SceneView,
    noise: NoiseTable,
    seed: int,
    frame_index: int,
    systematic: Systematic | None = None,
) -> DepthImage:
    """What the sensor would return of a clean depth image: (height, width) z-depth, m; 0 = none.

    In this order: mixed pixels, what is systematic, Gaussian noise along the ray, outliers of the
    target, dropouts, false returns, rounding to the stored step. Seed and frame index alone fix the
    draws, so a frame can be repeated without those before it; every fault has its own stream, so
    changing one leaves the others' draws. The target's pixels draw as if nothing stood beside it.

    A mixed pixel lies on an occlusion edge and returns a depth uniform between the two surfaces.
    At the target's outline before empty space the other part of the footprint returns no light: the
    pixel keeps the surface.
    """
    view = rendered if isinstance(rendered, SceneView) else SceneView.of_target(rendered)
    systematic = systematic or Systematic()
    streams = np.random.SeedSequence(seed, spawn_key=(frame_index,)).spawn(5)
    mixed, gaussian, outliers, dropouts = (_Stream(view, each, False) for each in streams[:4])
    ratio = view.seen.range_per_depth
    depth = view.seen.depth_m.astype(np.float64)
    seen = depth > 0.0
    if noise.mixed_pixel_fraction > 0.0:
        chosen, share = mixed.random(), mixed.random()
        beyond = depth_beyond_edge(view.seen)
        chosen_edge = (beyond > 0.0) & (chosen < noise.mixed_pixel_fraction)
        depth = np.where(chosen_edge, depth + share * (beyond - depth), depth)
    sigma = noise.sigma_at(depth * ratio)
    depth = depth + (sigma * gaussian.standard_normal() + systematic.range_error_m) / ratio
    depth = _with_outliers(view, depth, noise.outlier_fraction, outliers)
    depth = np.where(seen, depth, 0.0)
    depth = np.where(dropouts.random() < noise.dropout_fraction, 0.0, depth)
    if systematic.lost is not None:
        depth = np.where(systematic.lost, 0.0, depth)
    if noise.false_return_fraction > 0.0:
        false = _Stream(view, streams[4], True)
        at_all = false.random() < noise.false_return_fraction
        depth = np.where(at_all, false.uniform(*systematic.false_span_m) / ratio, depth)
    return _stored(view, depth, noise)


def _with_outliers(
    view: SceneView, depth: FloatArray, fraction: float, outliers: "_Stream"
) -> FloatArray:
    """With a share of the target's returns drawn uniformly over its depth span."""
    clean = view.target.depth_m[view.target.depth_m > 0.0].astype(np.float64)
    if not clean.size:
        return depth
    uniform = outliers.uniform(clean.min(), clean.max())
    replaced = (outliers.random() < fraction) & view.shows_target
    return np.where(replaced, uniform, depth)


def _stored(view: SceneView, depth: FloatArray, noise: NoiseTable) -> DepthImage:
    """Rounded to the step; without what is behind the camera or beyond the sensor's reach.

    A target beyond what 16 bits hold is left to whoever stores it, who refuses it.
    """
    if view.seen.own_rays is not None:
        return _stored_range(view, depth, noise)
    units = np.maximum(np.rint(depth / noise.quantisation_m), 0.0)
    beyond = (units > MAXIMUM_UNITS) & ~view.shows_target
    if noise.max_range_m is not None:
        beyond |= depth * view.seen.range_per_depth > noise.max_range_m
    image = np.zeros_like(view.seen.depth_m)
    image[:] = np.where(beyond, 0.0, units) * noise.quantisation_m
    return image


def _stored_range(view: SceneView, depth: FloatArray, noise: NoiseTable) -> DepthImage:
    """The same of a scan: its ranges are stored as floats, whatever they are."""
    ratio = view.seen.range_per_depth
    steps = np.maximum(np.rint(depth * ratio / noise.quantisation_m), 0.0)
    range_m = np.where(depth > 0.0, steps * noise.quantisation_m, 0.0)
    if noise.max_range_m is not None:
        range_m[range_m > noise.max_range_m] = 0.0
    return np.asarray(range_m / ratio, dtype=np.float32)


class _Stream:
    """Draws for the pixels that return, or for all: on the target as if it stood alone."""

    def __init__(self, view: SceneView, sequence: np.random.SeedSequence, everywhere: bool) -> None:
        self._target = view.target.depth_m > 0.0
        self._rest = ~self._target & (everywhere | (view.seen.depth_m > 0.0))
        self._on_target = np.random.default_rng(sequence)
        self._on_rest = np.random.default_rng(sequence.spawn(1)[0])

    def standard_normal(self) -> FloatArray:
        """(height, width)"""
        return self._image(np.random.Generator.standard_normal)

    def random(self) -> FloatArray:
        """(height, width) uniform in [0, 1)."""
        return self._image(np.random.Generator.random)

    def uniform(self, low: float, high: float) -> FloatArray:
        """(height, width)"""
        return self._image(lambda rng, size: rng.uniform(low, high, size))

    def _image(self, draw: Callable[[np.random.Generator, int], FloatArray]) -> FloatArray:
        image = np.zeros(self._target.shape)
        image[self._target] = draw(self._on_target, int(np.count_nonzero(self._target)))
        image[self._rest] = draw(self._on_rest, int(np.count_nonzero(self._rest)))
        return image
