"""Which plane each pixel belongs to, and where a segment of a plane is cut instead of ending.

Sequential RANSAC lets the first plane steal its neighbours' points inside the inlier threshold.
Here every pixel is given to the plane that explains it best once all planes are known; along the
crease of two faces, where noise decides between them, geometry decides instead of noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.arrays import BoolArray, FloatArray, IntArray
from pcnav.perception.planes import PlaneFit, fit_plane, plane_range
from pcnav.perception.returns import Window

_GATE_SIGMA = 3.5
"""A return further than this from every plane belongs to none."""
_SMOOTHING = 1.0
"""Cost, in squared standard deviations, of each of the 8 neighbours that another plane owns."""
_CREASE_REACH_PX = 3
"""How far from a crease noise can give pixels to the wrong face."""
_CREASE_AGREEMENT = 0.75
"""Share of the clear pixels on both sides that must tell a crease convex (or concave)."""
_FILL_NEIGHBOURS = 5
"""Neighbours of 8 that make a pixel without a return part of the segment: a pixel on a straight
side has five inside, one beyond the side three."""

_EIGHT = np.ones((3, 3), dtype=np.uint8)
_NO_PLANE = -1


@dataclass(frozen=True)
class Segment:
    """A connected piece of one plane in the image."""

    fit: PlaneFit
    pixels: IntArray
    """(n,) flat window indices of its pixels, filled-in dropouts included."""
    n_returns: int
    """How many of them have a return that the plane explains."""
    cut_pixels: IntArray
    """(k,) flat window indices just outside it where something nearer, or the image border, hides
    the rest of the face."""
    n_outline: int
    """Number of pixels just outside it in total."""


def segment_planes(
    window: Window, planes: tuple[FloatArray, ...], sigma_m: float, minimum_pixels: int
) -> tuple[list[Segment], IntArray]:
    """Connected segments of the planes, largest first, and the (height, width) segment labels.

    Args:
        window: the pixels.
        planes: planes ``m`` to start from, 1/m.
        sigma_m: noise along the ray.
        minimum_pixels: smaller segments are dropped.
    """
    no_labels = np.full(window.shape, _NO_PLANE, dtype=np.intp)
    if not planes:
        return [], no_labels
    labels, fits = no_labels, list(planes)
    for _ in range(2):
        ranges = np.stack([plane_range(m, window.rays) for m in fits])
        labels = _assign(window, ranges, sigma_m)
        labels, convex = _straighten_creases(labels, ranges.reshape(-1, *window.shape), sigma_m)
        kept = [k for k in range(len(fits)) if np.count_nonzero(labels == k) >= minimum_pixels]
        if not kept:
            return [], no_labels
        labels, convex = _renumber(labels, kept), convex[np.ix_(kept, kept)]
        fits = [_refit(window, labels == k, sigma_m, fits[old]).m for k, old in enumerate(kept)]
    return _components(window, labels, fits, convex, sigma_m, minimum_pixels)


def _refit(window: Window, mask: BoolArray, sigma_m: float, m: FloatArray) -> PlaneFit:
    chosen = np.flatnonzero(mask.ravel() & window.has_return)
    return fit_plane(window.rays[chosen], window.range_m[chosen], sigma_m, m)


def _renumber(labels: IntArray, kept: list[int]) -> IntArray:
    table = np.full(labels.max() + 2, _NO_PLANE, dtype=np.intp)
    table[kept] = np.arange(len(kept))
    return table[labels]


def _assign(window: Window, ranges: FloatArray, sigma_m: float) -> IntArray:
    """(height, width) best plane of each return: residual first, then the neighbours' vote."""
    cost = np.minimum(((window.range_m - ranges) / sigma_m) ** 2, 1e6)
    cost[:, ~window.has_return] = 1e6
    explained = cost.min(axis=0) < _GATE_SIGMA**2
    labels = np.where(explained, cost.argmin(axis=0), _NO_PLANE).reshape(window.shape)
    cost = cost.reshape(-1, *window.shape)
    for _ in range(3):  # iterated conditional modes of a Potts model
        votes = np.stack([_neighbours(labels == k) for k in range(len(cost))])
        best = (cost - _SMOOTHING * votes).argmin(axis=0)
        labels = np.where(explained.reshape(window.shape), best, _NO_PLANE)
    own = np.take_along_axis(cost, np.maximum(labels, 0)[None], axis=0)[0]
    return np.where(own < (_GATE_SIGMA + 1.0) ** 2, labels, _NO_PLANE)


def _neighbours(mask: BoolArray) -> IntArray:
    """How many of the 8 neighbours of each pixel are set."""
    counts = mask.astype(np.int8)
    for axis in (0, 1):
        counts = ndimage.convolve1d(counts, np.ones(3, dtype=np.int8), axis, mode="constant")
    return np.asarray(counts - mask)


def _straighten_creases(
    labels: IntArray, ranges: FloatArray, sigma_m: float
) -> tuple[IntArray, BoolArray]:
    """Let geometry decide along creases; also says which pairs of planes (n, n) meet convexly.

    Of two faces that meet in a convex edge a ray hits the one it enters last, so the further of
    the two planes; in a concave edge the nearer one. That rule carries no noise but the planes'
    own, while the residuals there say next to nothing.
    """
    n = len(ranges)
    convex = np.zeros((n, n), dtype=bool)
    size = 2 * _CREASE_REACH_PX + 1
    near = [ndimage.maximum_filter(labels == k, size, mode="constant") for k in range(n)]
    straight = labels.copy()
    for a in range(n):
        for b in range(a + 1, n):
            band = near[a] & near[b] & ((labels == a) | (labels == b))
            if not band.any():
                continue
            a_further = np.subtract(ranges[a], ranges[b], where=band, out=np.zeros(band.shape))
            clear = band & (np.abs(a_further) > sigma_m)
            in_a, in_b = a_further[clear & (labels == a)] > 0, a_further[clear & (labels == b)] < 0
            if min(len(in_a), len(in_b)) == 0:
                continue
            vote = np.array([in_a.mean(), in_b.mean()])
            if vote.min() > _CREASE_AGREEMENT:
                rule = a_further > 0
                convex[a, b] = convex[b, a] = True
            elif vote.max() < 1.0 - _CREASE_AGREEMENT:
                rule = a_further < 0
            else:
                continue  # one face hides part of the other: there is no crease
            doubtful = band & (np.abs(a_further) < (_GATE_SIGMA + 1.0) * sigma_m)
            straight[doubtful] = np.where(rule, a, b)[doubtful]
    return straight, convex


def _components(
    window: Window,
    labels: IntArray,
    planes: list[FloatArray],
    convex: BoolArray,
    sigma_m: float,
    minimum_pixels: int,
) -> tuple[list[Segment], IntArray]:
    """Split each plane's pixels into connected segments: coplanar parts are different faces."""
    pieces: list[tuple[int, BoolArray]] = []
    for k in range(len(planes)):
        parts, count = ndimage.label(labels == k, structure=_EIGHT)
        sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
        pieces += [(k, parts == part + 1) for part in np.flatnonzero(sizes >= minimum_pixels)]
    # What is left of a label are stray pixels of other surfaces: they say nothing of their plane.
    kept = np.zeros(window.shape, dtype=bool)
    for _, piece in pieces:
        kept |= piece
    labels = np.where(kept, labels, _NO_PLANE)
    seen = np.stack([plane_range(m, window.rays) for m in planes])
    surface = np.take_along_axis(seen, np.maximum(labels.ravel(), 0)[None], axis=0)[0]
    segments = []
    for k, piece in pieces:
        mask = _filled(piece, labels)
        fit = _refit(window, piece, sigma_m, planes[k])
        cut, outline = _cut_outline(window, mask, fit.m, labels, surface, convex[k], sigma_m)
        n_returns = int(np.count_nonzero(piece))
        segments.append(Segment(fit, np.flatnonzero(mask.ravel()), n_returns, cut, outline))
    segments.sort(key=lambda segment: -len(segment.pixels))
    numbered = np.full(window.shape, _NO_PLANE, dtype=np.intp)
    for number, segment in enumerate(segments):
        numbered.ravel()[segment.pixels] = number
    return segments, numbered


def _filled(mask: BoolArray, labels: IntArray) -> BoolArray:
    """Add the pixels without a plane that the segment surrounds: dropouts and outliers."""
    free = labels == _NO_PLANE
    for _ in range(3):
        grown = mask | (free & (_neighbours(mask) >= _FILL_NEIGHBOURS))
        if np.array_equal(grown, mask):
            break
        mask = grown
    return mask


def _cut_outline(
    window: Window,
    mask: BoolArray,
    m: FloatArray,
    labels: IntArray,
    surface: FloatArray,
    convex_with: BoolArray,
    sigma_m: float,
) -> tuple[IntArray, int]:
    """Flat indices where the outline is a cut, and the number of pixels in the outline.

    A face ends where what lies beyond its outline is further away or empty; it is cut where
    something nearer hides it, or where the image ends.
    """
    outline = np.flatnonzero(((_neighbours(mask) > 0) & ~mask).ravel())
    own = plane_range(m, window.rays[outline])
    label = labels.ravel()[outline]
    # A neighbour with a plane is compared by its plane, which has no pixel noise.
    on_plane = (label != _NO_PLANE) & ~convex_with[np.maximum(label, 0)]
    hidden = on_plane & (surface[outline] < own - 0.5 * sigma_m)
    seen = window.range_m[outline]
    hidden |= (label == _NO_PLANE) & (seen > 0.0) & (seen < own - _GATE_SIGMA * sigma_m)
    top, bottom, left, right = window.touches_border
    at_border = np.zeros(window.shape, dtype=bool)
    at_border[0, :] |= top
    at_border[-1, :] |= bottom
    at_border[:, 0] |= left
    at_border[:, -1] |= right
    border = np.flatnonzero((at_border & mask).ravel())
    return np.concatenate([outline[hidden], border]), len(outline) + len(border)
