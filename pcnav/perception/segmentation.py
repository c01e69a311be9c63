"""Which plane each pixel belongs to, and where a segment of a plane is cut instead of ending.

Sequential RANSAC lets the first plane steal its neighbours' points inside the inlier threshold.
Here every pixel is given to the plane that explains it best once all planes are known; along the
crease of two faces, where noise decides between them, geometry decides instead of noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.perception.planes import PlaneFit, fit_plane, is_edge_on, plane_range
from pcnav.perception.returns import Window

Part = tuple[slice, slice]
"""Rows and columns of an image or window."""

_GATE_SIGMA = 3.5
"""A return further than this from every plane belongs to none."""
_SMOOTHING = 1.0
"""Cost, in squared standard deviations, of each of the 8 neighbours that another plane owns."""
_VOTES = 3
"""Rounds of voting."""
_CREASE_REACH_PX = 3
"""How far from a crease noise can give pixels to the wrong face."""
_CREASE_AGREEMENT = 0.75
"""Share of the clear pixels on both sides that must tell a crease convex (or concave)."""
_FILL_NEIGHBOURS = 5
"""Neighbours of 8 that make a pixel without a return part of the segment: a pixel on a straight
side has five inside, one beyond the side three."""

_EIGHT = np.ones((3, 3), dtype=np.uint8)
_AROUND = [(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1) if (dv, du) != (0, 0)]
_NO_PLANE = -1
_MAX_COST = np.float32(1e6)


@dataclass(frozen=True)
class PredictedSurface:
    """What a predicted pose says of each pixel of an image (height, width)."""

    planes: tuple[FloatArray, ...]
    """Planes ``m`` in view, 1/m."""
    labels: IntArray
    """Index into ``planes``, -1 for none."""
    range_m: FloatArray
    """Along the ray; 0 where there is no surface."""
    settled: BoolArray
    """Pixels at no step and no crease: a prediction good to a pixel is right about them."""

    def planes_only(self) -> "PredictedSurface":
        """The same of a prediction that may be off by pixels: nothing is settled."""
        return replace(self, settled=np.zeros_like(self.settled))

    def part(self, part: Part) -> "PredictedSurface":
        """The same for a part of the image."""
        return PredictedSurface(
            self.planes, self.labels[part], self.range_m[part], self.settled[part]
        )


def settled_pixels(labels: IntArray, range_m: FloatArray, sigma_m: float) -> BoolArray:
    """Where labels (height, width) of a rendered view hold for a slightly different pose too.

    Not where a neighbour belongs to another plane, nor where the surface steps by more than
    noise can bridge: the second difference of range vanishes on a plane, whatever its tilt. The
    target's outline against space needs no label: a return tells it.
    """
    surface = range_m > 0.0
    settled = surface.copy()
    largest = ndimage.maximum_filter(labels, 3)
    smallest = ndimage.minimum_filter(np.where(labels == _NO_PLANE, labels.size, labels), 3)
    settled &= (largest == _NO_PLANE) | (largest == smallest)
    for axis in (0, 1):
        bend = ndimage.correlate1d(range_m, [1.0, -2.0, 1.0], axis, mode="nearest")
        inside = ndimage.minimum_filter1d(surface, 3, axis, mode="nearest")
        settled &= ~inside | (np.abs(bend) < 2.0 * _GATE_SIGMA * sigma_m)
    return np.asarray(settled)


@dataclass(frozen=True)
class Segment:
    """A connected piece of one plane in the image."""

    fit: PlaneFit
    pixels: IntArray
    """(n,) flat window indices of its pixels, filled-in dropouts included."""
    cut_pixels: IntArray
    """(k,) flat window indices just outside it where something nearer, or the image border, hides
    the rest of the face."""
    n_outline: int
    """Number of pixels just outside it in total."""


@dataclass(frozen=True)
class Segmenter:
    """Splits the pixels of a window into connected segments of planes."""

    window: Window
    sigma_m: float
    """Noise along the ray."""
    minimum_pixels: int
    """Smaller segments are dropped."""
    expected: PredictedSurface | None = None
    """Of the window; decides where noise would, on steps too small to see."""

    def segments(
        self, planes: Sequence[FloatArray], rounds: int = 2
    ) -> tuple[list[Segment], IntArray]:
        """Connected segments of the planes, largest first, and the (height, width) segment labels.

        Args:
            planes: planes ``m`` to start from, 1/m.
            rounds: how often pixels are assigned and planes refitted; one is enough for planes
                that were right to begin with.
        """
        fits = list(planes)
        labels = np.full(self.window.shape, _NO_PLANE, dtype=np.intp)
        convex = np.zeros((0, 0), dtype=bool)
        for _ in range(rounds if fits else 0):
            labels, convex = self.labels(fits)
            labels, convex, fits = self._refitted(labels, convex, fits)
            if not fits:
                break
        return self._components(labels, fits, convex)

    def labels(self, planes: Sequence[FloatArray]) -> tuple[IntArray, BoolArray]:
        """(height, width) which of the planes each pixel shows, -1 for none; and which pairs of
        planes (n, n) meet in a convex edge."""
        window = self.window
        typical_m = float(np.mean(window.range_m[window.has_return]))
        ranges = np.full((len(planes), len(window.rays)), np.inf)
        for own, m in zip(ranges, planes, strict=True):
            if not is_edge_on(m, typical_m):
                own[:] = plane_range(m, window.rays)
        labels = self._assigned(ranges)
        return _straighten_creases(labels, ranges.reshape(-1, *window.shape), self.sigma_m)

    def _refitted(
        self, labels: IntArray, convex: BoolArray, planes: list[FloatArray]
    ) -> tuple[IntArray, BoolArray, list[FloatArray]]:
        """Planes refitted to their pixels; those with too few pixels, or seen edge-on, are gone."""
        table = np.full(len(planes) + 1, _NO_PLANE, dtype=np.intp)  # the last serves the label -1
        kept: list[int] = []
        fits: list[FloatArray] = []
        flat, window = labels.ravel(), self.window
        for k, m in enumerate(planes):
            own = np.flatnonzero(flat == k)
            if len(own) < self.minimum_pixels:
                continue
            fit = fit_plane(window.rays[own], window.range_m[own], self.sigma_m, m)
            if fit is not None:
                table[k] = len(kept)
                kept.append(k)
                fits.append(fit.m)
        return table[labels], convex[np.ix_(kept, kept)], fits

    def _assigned(self, ranges: FloatArray) -> IntArray:
        """(height, width) best plane of each return: residual first, then the neighbours' vote.

        The vote is one of iterated conditional modes in a Potts model. Only pixels whose two best
        planes are nearer than the vote could ever decide take part. A part that stands so little
        out of a face that noise hides the step would be given to the face by noise, a different
        share of it in every frame: there the expected surface decides, where the return agrees
        with it.
        """
        window, expected = self.window, self.expected
        returns = np.flatnonzero(window.has_return)
        residual = (window.range_m[returns] - ranges[:, returns]) / self.sigma_m
        # Also of planes the ray never meets.
        cost = np.minimum(residual.astype(np.float32) ** 2, _MAX_COST)
        best = cost.argmin(axis=0)
        lowest = np.take_along_axis(cost, best[None], axis=0)[0]
        near = lowest < _GATE_SIGMA**2
        padded = np.full((window.height + 2, window.width + 2), _NO_PLANE, dtype=np.intp)
        inner = padded[1:-1, 1:-1]
        rows, columns = np.divmod(returns, window.width)
        inner[rows, columns] = np.where(near, best, _NO_PLANE)
        doubtful = near & (np.sum(cost < lowest + 8.0 * _SMOOTHING, axis=0) > 1)
        if expected is not None:
            surprise = np.abs(window.range_m[returns] - expected.range_m.ravel()[returns])
            known = expected.settled.ravel()[returns]
            known &= surprise < (_GATE_SIGMA + 0.5) * self.sigma_m
            inner[rows[known], columns[known]] = expected.labels.ravel()[returns[known]]
            doubtful &= ~known
        v, u, doubtful_cost = rows[doubtful], columns[doubtful], cost[:, doubtful]
        numbers = np.arange(len(ranges))[:, None]
        for _ in range(_VOTES):
            votes = np.zeros(doubtful_cost.shape, dtype=np.float32)
            for dv, du in _AROUND:
                votes += padded[v + 1 + dv, u + 1 + du] == numbers
            choice = np.argmin(doubtful_cost - _SMOOTHING * votes, axis=0)
            own = np.take_along_axis(doubtful_cost, choice[None], axis=0)[0]
            inner[v, u] = np.where(own < (_GATE_SIGMA + 1.0) ** 2, choice, _NO_PLANE)
        return inner.copy()

    def _components(
        self, labels: IntArray, planes: list[FloatArray], convex: BoolArray
    ) -> tuple[list[Segment], IntArray]:
        """Split each plane's pixels into connected segments: coplanar parts are different faces."""
        shape = self.window.shape
        pieces: list[tuple[int, Part, BoolArray]] = []
        for k in range(len(planes)):
            parts, count = ndimage.label(labels == k, structure=_EIGHT)
            sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
            boxes = ndimage.find_objects(parts)
            for number in np.flatnonzero(sizes >= self.minimum_pixels):
                box = _widened(boxes[number], shape)
                pieces.append((k, box, parts[box] == number + 1))
        # What is left of a label are stray pixels of other surfaces: they say nothing of its plane.
        kept = np.zeros(shape, dtype=bool)
        for _, box, piece in pieces:
            kept[box] |= piece
        labels = np.where(kept, labels, _NO_PLANE)
        if not planes:
            return [], labels
        seen = np.stack([plane_range(m, self.window.rays) for m in planes])
        surface = np.take_along_axis(seen, np.maximum(labels.ravel(), 0)[None], axis=0)[0]
        scene = _Scene(self.window, labels, surface.reshape(shape), self.sigma_m)
        found = [_segment(scene, planes[k], convex[k], box, piece) for k, box, piece in pieces]
        segments = [segment for segment in found if segment is not None]
        segments.sort(key=lambda segment: -len(segment.pixels))
        numbered = np.full(shape, _NO_PLANE, dtype=np.intp)
        for index, segment in enumerate(segments):
            numbered.ravel()[segment.pixels] = index
        return segments, numbered


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


def _widened(box: tuple[slice, ...], shape: tuple[int, int]) -> Part:
    """A box with one pixel more on every side, as far as the window goes."""
    rows, columns = (
        slice(max(side.start - 1, 0), min(side.stop + 1, size))
        for side, size in zip(box, shape, strict=True)
    )
    return rows, columns


@dataclass(frozen=True)
class _Scene:
    """All segments' surroundings."""

    window: Window
    labels: IntArray
    """(height, width) plane of each pixel, stray pixels removed."""
    surface: FloatArray
    """(height, width) range to the pixel's plane; meaningless where it has none."""
    sigma_m: float

    def flat(self, mask: BoolArray, box: Part) -> IntArray:
        """Flat window indices of the pixels set in a mask of a box."""
        v, u = np.nonzero(mask)
        return np.asarray((v + box[0].start) * self.window.width + u + box[1].start)


def _segment(
    scene: _Scene, m: FloatArray, convex_with: BoolArray, box: Part, piece: BoolArray
) -> Segment | None:
    mask = _filled(piece, scene.labels[box])
    returns = scene.flat(piece, box)
    rays, ranges = scene.window.rays[returns], scene.window.range_m[returns]
    fit = fit_plane(rays, ranges, scene.sigma_m, m)
    if fit is None:
        return None
    outline = scene.flat((_neighbours(mask) > 0) & ~mask, box)
    border = scene.flat(mask & _at_border(scene.window)[box], box)
    cut = outline[_is_hidden(scene, fit.m, convex_with, outline)]
    return Segment(
        fit=fit,
        pixels=scene.flat(mask, box),
        cut_pixels=np.concatenate([cut, border]),
        n_outline=len(outline) + len(border),
    )


def _filled(mask: BoolArray, labels: IntArray) -> BoolArray:
    """Add the pixels without a plane that the segment surrounds: dropouts and outliers."""
    free = labels == _NO_PLANE
    for _ in range(3):
        grown = mask | (free & (_neighbours(mask) >= _FILL_NEIGHBOURS))
        if np.array_equal(grown, mask):
            break
        mask = grown
    return mask


def _is_hidden(
    scene: _Scene, m: FloatArray, convex_with: BoolArray, outline: IntArray
) -> BoolArray:
    """Which pixels just outside a segment hide more of its face.

    A face ends where what lies beyond its outline is further away or empty; it is cut where
    something nearer stands in front of it.
    """
    own = plane_range(m, scene.window.rays[outline])
    label = scene.labels.ravel()[outline]
    # A neighbour with a plane is compared by its plane, which has no pixel noise.
    on_plane = (label != _NO_PLANE) & ~convex_with[np.maximum(label, 0)]
    hidden = on_plane & (scene.surface.ravel()[outline] < own - 0.5 * scene.sigma_m)
    seen = scene.window.range_m[outline]
    nearer = (seen > 0.0) & (seen < own - _GATE_SIGMA * scene.sigma_m)
    return np.asarray(hidden | ((label == _NO_PLANE) & nearer))


def _at_border(window: Window) -> BoolArray:
    """(height, width) pixels of the window on the image's own border: it cuts what it shows."""
    top, bottom, left, right = window.touches_border
    at_border = np.zeros(window.shape, dtype=bool)
    at_border[0, :] |= top
    at_border[-1, :] |= bottom
    at_border[:, 0] |= left
    at_border[:, -1] |= right
    return at_border
