"""The faults of the simulated depth sensor, each drawn from its own seeded stream."""

import numpy as np

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import range_per_depth
from pcnav.target.rendering import RenderedDepth, depth_beyond_edge


def add_sensor_faults(
    rendered: RenderedDepth, noise: NoiseTable, seed: int, frame_index: int
) -> DepthImage:
    """What the sensor would return of a clean depth image: (height, width) z-depth, m; 0 = none.

    In this order: mixed pixels, Gaussian noise along the ray, outliers, dropouts, rounding to
    the stored step. Seed and frame index alone fix the draws, so a frame can be repeated without
    those before it; every fault has its own stream, so changing one leaves the others' draws.

    A mixed pixel lies on an occlusion edge and returns a depth uniform between the two surfaces.
    At the target's outline the other part of the footprint sees space and returns no light: the
    pixel keeps the surface.
    """
    mixed, gaussian, outliers, dropouts = (
        np.random.default_rng(stream)
        for stream in np.random.SeedSequence(seed, spawn_key=(frame_index,)).spawn(4)
    )
    seen = rendered.depth_m > 0.0
    clean = rendered.depth_m[seen].astype(np.float64)
    if clean.size == 0:
        return rendered.depth_m.copy()
    depth = clean
    if noise.mixed_pixel_fraction > 0.0:
        beyond = depth_beyond_edge(rendered)[seen]
        depth = _mix(clean, beyond, noise.mixed_pixel_fraction, mixed)
    range_noise = noise.range_sigma_m * gaussian.standard_normal(clean.size)
    depth = depth + range_noise / range_per_depth(rendered.camera)[seen]
    uniform = outliers.uniform(clean.min(), clean.max(), clean.size)
    depth = np.where(outliers.random(clean.size) < noise.outlier_fraction, uniform, depth)
    depth = np.where(dropouts.random(clean.size) < noise.dropout_fraction, 0.0, depth)
    image = np.zeros_like(rendered.depth_m)
    # Noise that reaches behind the camera is no return.
    image[seen] = np.maximum(np.rint(depth / noise.quantisation_m), 0.0) * noise.quantisation_m
    return image


def _mix(
    depth: FloatArray, beyond: FloatArray, fraction: float, generator: np.random.Generator
) -> FloatArray:
    chosen = (beyond > 0.0) & (generator.random(depth.size) < fraction)
    share = generator.random(depth.size)
    return np.where(chosen, depth + share * (beyond - depth), depth)
