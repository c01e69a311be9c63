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
