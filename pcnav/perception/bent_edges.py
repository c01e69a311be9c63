"""Straight edges of a mesh whose images are curves, cut into parts that are straight enough."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays

_SEGMENT_SAG_PX = 0.005
"""How far the image of a segment may lie from its chord."""
_PROBES = 17
_HARMONICS = 24
_BEYOND = 1.02
"""Edges are followed so far beyond the outermost ray of the image, over its distance off axis."""


Projection = Callable[[FloatArray], FloatArray]
"""From points (..., 3) in the camera frame, m, to pixels (..., 2)."""


@dataclass(frozen=True)
class EdgeSegments:
    """Parts of edges, each nearly straight in the image."""

    edge: IntArray
    """(n,) which of the edges."""
    start_cam: FloatArray
    """(n, 3) m."""
    end_cam: FloatArray
    """(n, 3) m."""


def edge_segments(
    camera: PinholeCamera, image: Projection, start_cam: FloatArray, end_cam: FloatArray
) -> EdgeSegments:
    """Cut edges from (k, 3) to (k, 3), camera frame with z > 0, m; only what the image may show.

    A cut at a share s of the edge on the plane z = 1 has ``1 / z`` linear in s. ``image`` gives the
    pixels that points are imaged at.
    """
    first, second = start_cam[:, :2] / start_cam[:, 2:], end_cam[:, :2] / end_cam[:, 2:]
    low, high = _clipped(first, second - first, _reach(camera))
    shown = np.flatnonzero(low < high)
    first, along = first[shown], (second - first)[shown]
    inverse = np.stack([1.0 / start_cam[shown, 2], 1.0 / end_cam[shown, 2]])
    low, span = low[shown], (high - low)[shown]

    def points(edge: IntArray, share: FloatArray) -> FloatArray:
        s = low[edge] + share * span[edge]
        xy = first[edge] + s[..., None] * along[edge]
        z = 1.0 / ((1.0 - s) * inverse[0, edge] + s * inverse[1, edge])
        rays = np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)
        return np.asarray(rays * z[..., None])

    every = np.arange(len(shown))
    probes = image(points(every[:, None], np.linspace(0.0, 1.0, _PROBES)[None, :]))
    # A curve c(s) lies at most |c''| h^2 / 8 off the chord of a span h of s.
    bend = np.linalg.norm(np.diff(probes, n=2, axis=1), axis=-1).max(axis=1, initial=0.0)
    sag = bend * (_PROBES - 1) ** 2 / 8.0
    counts = np.maximum(np.ceil(np.sqrt(sag / _SEGMENT_SAG_PX)), 1.0).astype(np.intp)
    edge = np.repeat(every, counts)
    number = np.arange(len(edge)) - np.repeat(np.cumsum(counts) - counts, counts)
    return EdgeSegments(
        edge=shown[edge],
        start_cam=points(edge, number / counts[edge]),
        end_cam=points(edge, (number + 1) / counts[edge]),
    )


@lru_cache(maxsize=12)
def _reach(camera: PinholeCamera) -> float:
    """How far from the axis, on the plane z = 1, edges are followed."""
    rays, lens = pixel_rays(camera), camera.distortion
    outermost = _BEYOND * float(np.hypot(rays[..., 0], rays[..., 1]).max())
    return outermost if lens is None else min(outermost, lens.max_radius)


def _clipped(start: FloatArray, along: FloatArray, radius: float) -> tuple[FloatArray, FloatArray]:
    """(k,) shares from and to which lines ``start + s along`` (k, 2), s from 0 to 1, are within a
    circle; none where the first is not below the second."""
    a = np.maximum(np.einsum("ij,ij->i", along, along), 1e-300)
    b, c = np.einsum("ij,ij->i", start, along), np.einsum("ij,ij->i", start, start) - radius**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    low, high = np.maximum((-b - root) / a, 0.0), np.minimum((root - b) / a, 1.0)
    return low, np.where(b * b > a * c, high, low)


def bent_grid_variances(
    minor_px: FloatArray,
    weights: tuple[FloatArray, FloatArray],
    starts: IntArray,
    distance_px: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Variances (k,) of two weighted sums of the counts along curved edges; for the mean and the
    tilt of straight ones see `pcnav.perception.contour.grid_variances`, whose notation this has.

    The sawtooth's autocovariance is ``C(x) = sum_j cos(2 pi j x) / (2 pi^2 j^2)``, so a sum of
    counts with weights w at places m has the variance ``sum_j (1 - cos 2 pi j d) |W_j|^2 /
    (pi^2 j^2)`` with ``W_j = sum w exp(2 pi i j m)``. Along a curve the high harmonics of different
    crossings are independent: they are taken together.

    Args:
        minor_px: (n,) where the edges are at each crossing, run after run.
        weights: (n,) each, of the two sums.
        starts: (k,) first crossing of each run.
        distance_px: (k,) d.
    """
    harmonic = np.arange(1, _HARMONICS + 1)
    wave = np.exp(2.0j * np.pi * (minor_px - np.floor(minor_px)))
    powers = np.cumprod(np.broadcast_to(wave[:, None], (len(wave), _HARMONICS)), axis=1)
    d = np.minimum(distance_px, 0.5)[:, None]
    share = (1.0 - np.cos(2.0 * np.pi * harmonic * d)) / (np.pi * harmonic) ** 2
    # All harmonics together are those of a single count, d (1 - d).
    rest = np.maximum(d[:, 0] * (1.0 - d[:, 0]) - share.sum(axis=1), 0.0)
    found = []
    for weight in weights:
        spectrum = np.abs(np.add.reduceat(weight[:, None] * powers, starts)) ** 2
        alone = np.add.reduceat(weight**2, starts)
        found.append(np.einsum("ij,ij->i", spectrum, share) + rest * alone)
    return found[0], found[1]
