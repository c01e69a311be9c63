"""The surfaces of a frame before anything is known of it: where they step, bend and stay flat.

In the image the inverse depth of a plane is linear in the ray, ``1 / z = m . ray``, whatever its
tilt. A plane is fitted so about every pixel, from sums over a square; what the surface does there
follows from it and from its neighbours' planes.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, FloatArray, IntArray, neighbours
from pcnav.core.camera import pixel_rays
from pcnav.perception.image_parts import bounding_box, connected_parts, parts_of
from pcnav.recordings.sequence import Frame

_ABOUT_PX = 5
"""Side of the square in which a return needs company."""
_MIN_COMPANY = 3
"""Returns in it at about the same depth; false returns are alone."""
_MAX_SLOPE = 5.0
"""Surfaces seen at over 79 degrees step too much from pixel to pixel to be followed."""
_LINK_SIGMA = 5.0
_STEP_FRACTION = 0.02
"""A step in depth that its neighbours do not share is one from this share of the diameter on."""
_HALF_PX = 3
"""Half the side of the square that a plane is fitted in."""
_PLANE_SIGMA = 3.5
_FLAT_SIGMA = 1.5
_PLANE_FRACTION = 0.02
"""Real tables and walls, and their depth images, are flat to this share of the diameter."""
_SEED_PX = 4
_MAX_SEEDS = 1500
_MAX_PLANES = 24
_MIN_SEEDS = 4
_LARGER = 1.3
"""A plane that extends so many times as far as the target's largest flat part is none of it."""
_MIN_PART_PX = 20
_CONCAVE_RAD = 0.35


@dataclass(frozen=True)
class SmoothFrame:
    """A frame's returns without stray ones, and the plane about each."""

    depth_m: FloatArray
    """(height, width) z-depth; 0 where nothing trusted returned. Small gaps are filled."""
    trusted: BoolArray
    """(height, width) pixels with a return that others confirm."""
    points: FloatArray
    """(height, width, 3) camera frame, m."""
    footprint_m: FloatArray
    """(height, width) distance of neighbouring pixels on a surface facing the sensor."""
    sigma_m: FloatArray
    """(height, width) noise of depth, from what is smooth."""
    m: FloatArray
    """(height, width, 3) plane about each pixel, nan where there is none."""
    rms_m: FloatArray
    """(height, width) depth residual about that plane."""
    concave: BoolArray
    """(height, width) pixels at an inward crease."""
    diameter_m: float

    def components(self, mask: BoolArray) -> IntArray:
        """(height, width) number of the connected part of a mask that each of its pixels is in,
        from 1 on; 0 for none.

        Neighbours are apart if a step lies between them: steeper than any surface that can be
        followed, or larger than the steps beside it by more than noise.
        """
        labels = np.zeros(mask.shape, dtype=np.intp)
        if not mask.any():
            return labels
        box = bounding_box(mask)
        within = mask[box]
        right, down = (
            links[box][: within.shape[0] - down, : within.shape[1] - right]
            & within[first]
            & within[second]
            for links, (first, second), right, down in zip(
                self._linked, map(neighbours, (1, 0)), (1, 0), (0, 1), strict=True
            )
        )
        labels[box] = connected_parts(within, right, down)
        return labels

    def points_of(self, pixels: IntArray) -> FloatArray:
        """(n, 3) points of pixels (n,) that are counted row after row, camera frame, m."""
        return np.asarray(self.points.reshape(-1, 3)[pixels])

    @cached_property
    def flat(self) -> BoolArray:
        """(height, width) pixels about which the returns lie on a plane, to the noise."""
        return np.asarray(self.rms_m < _FLAT_SIGMA * self.sigma_m)

    @cached_property
    def _linked(self) -> tuple[BoolArray, BoolArray]:
        """Whether each pixel and the next of its row, and of its column, have no step between."""
        return self._links(1), self._links(0)

    def _links(self, axis: int) -> BoolArray:
        mask = self.depth_m > 0.0
        first, second = neighbours(axis)
        step = self.depth_m[second] - self.depth_m[first]
        both = mask[first] & mask[second]
        noise = _LINK_SIGMA * np.maximum(self.sigma_m[first], self.sigma_m[second])
        steep = np.abs(step) > _MAX_SLOPE * self.footprint_m[first] + noise
        before = np.roll(np.where(both, step, 0.0), 1, axis)
        after = np.roll(np.where(both, step, 0.0), -1, axis)
        beyond = np.maximum(step - np.maximum(before, after), np.minimum(before, after) - step)
        abrupt = beyond > np.maximum(2.0 * noise, _STEP_FRACTION * self.diameter_m)
        abrupt &= beyond > 2.0 * self.footprint_m[first]
        return np.asarray(both & ~steep & ~abrupt)


def smooth_frame(frame: Frame, sigma_m: float, diameter_m: float) -> SmoothFrame:
    """The surfaces of a frame; noise is at least ``sigma_m`` over 3."""
    depth = frame.depth_m.astype(np.float64)
    rays = pixel_rays(frame.camera)
    footprint = depth / max(frame.camera.fx, frame.camera.fy)
    company = _company(depth, _MAX_SLOPE * footprint, _LINK_SIGMA * sigma_m)
    trusted = company >= _MIN_COMPANY
    filled = _filled(np.where(trusted, depth, 0.0), trusted, footprint, sigma_m)
    footprint = filled / max(frame.camera.fx, frame.camera.fy)
    m, rms = _local_planes(filled, rays, 0.1 * diameter_m)
    sigma = _noise(filled, rms, sigma_m / 3.0)
    points = rays * filled[..., None]
    concave = _concave(m, points, rms, sigma, diameter_m)
    return SmoothFrame(filled, trusted, points, footprint, sigma, m, rms, concave, diameter_m)


def _company(depth: FloatArray, slope: FloatArray, noise_m: float) -> FloatArray:
    """(height, width) how many returns about each one lie at about its depth."""
    reach = _ABOUT_PX // 2
    padded = np.pad(depth, reach)
    height, width = depth.shape
    count = np.zeros(depth.shape, dtype=np.int8)
    for dv in range(-reach, reach + 1):
        for du in range(-reach, reach + 1):
            if dv or du:
                other = padded[reach + dv :, reach + du :][:height, :width]
                far = max(abs(dv), abs(du))
                near = np.abs(other - depth) < far * slope + noise_m
                count += near & (other > 0.0)
    return np.where(depth > 0.0, count, 0)


def _filled(
    depth: FloatArray, trusted: BoolArray, footprint: FloatArray, sigma_m: float
) -> FloatArray:
    """The same with the mean of its neighbours in gaps that one surface surrounds."""
    mask = trusted.astype(np.float64)
    near = ndimage.uniform_filter(mask, 3, mode="constant") * 9.0
    total = ndimage.uniform_filter(depth, 3, mode="constant") * 9.0
    low = ndimage.minimum_filter(np.where(trusted, depth, np.inf), 3)
    high = ndimage.maximum_filter(np.where(trusted, depth, -np.inf), 3)
    mean = total / np.maximum(near, 1.0)
    focal_inverse = float(np.median(footprint[trusted] / depth[trusted])) if trusted.any() else 0.0
    one = high - low < 2.0 * _MAX_SLOPE * mean * focal_inverse + _LINK_SIGMA * sigma_m
    gap = ~trusted & (np.rint(near) >= 4) & one
    return np.where(gap, mean, depth)


def _local_planes(
    depth: FloatArray, rays: FloatArray, tolerance_m: float
) -> tuple[FloatArray, FloatArray]:
    """(height, width, 3) plane about each return, and (height, width) its residual, m."""
    seen = depth > 0.0
    w = np.zeros_like(depth)
    w[seen] = 1.0 / depth[seen]
    x, y = rays[..., 0], rays[..., 1]
    one = seen.astype(np.float64)
    layers = np.stack([one, x * one, y * one, x * x * one, x * y * one, y * y * one])
    layers = np.concatenate([layers, np.stack([w, x * w, y * w, w * w])])
    side = 2 * _HALF_PX + 1
    n, sx, sy, sxx, sxy, syy, sw, swx, swy, sww = ndimage.uniform_filter(
        layers, (1, side, side), mode="constant"
    )
    enough = seen & (n > 0.4)
    n = np.where(enough, n, 1.0)
    mx, my, mw = sx / n, sy / n, sw / n
    cxx, cxy, cyy = sxx / n - mx * mx, sxy / n - mx * my, syy / n - my * my
    cxw, cyw, cww = swx / n - mx * mw, swy / n - my * mw, sww / n - mw * mw
    det = cxx * cyy - cxy * cxy
    enough &= det > 1e-3 * np.maximum(cxx, cyy) ** 2
    det = np.where(enough, det, 1.0)
    a = (cxw * cyy - cyw * cxy) / det
    b = (cyw * cxx - cxw * cxy) / det
    left = np.maximum(cww - a * cxw - b * cyw, 0.0)
    rms = np.where(enough, np.sqrt(left) * depth**2, np.inf)
    m = np.stack([a, b, mw - a * mx - b * my], axis=-1)
    m[~enough | (rms > tolerance_m)] = np.nan
    return m, rms


def _noise(depth: FloatArray, rms: FloatArray, least_m: float) -> FloatArray:
    """(height, width) deviation of depth: of the flatter half of what is about as far away."""
    good = np.isfinite(rms) & (depth > 0.0)
    sigma = np.full(depth.shape, least_m)
    if np.count_nonzero(good) < 100:
        return sigma
    z, r = depth[good], rms[good]
    edges = np.quantile(z, np.linspace(0.0, 1.0, 9))
    centres = 0.5 * (edges[1:] + edges[:-1])
    typical = [
        float(np.quantile(r[(z >= low) & (z <= high)], 0.35))
        for low, high in pairwise(edges.tolist())
    ]
    at = np.interp(depth, centres, np.array(typical) * 1.2)
    return np.maximum(at, least_m)


def _concave(
    m: FloatArray, points: FloatArray, rms: FloatArray, sigma: FloatArray, diameter_m: float
) -> BoolArray:
    """(height, width) pixels where the surface bends towards the sensor's side."""
    with np.errstate(invalid="ignore"):
        normal = -m / np.linalg.norm(m, axis=-1, keepdims=True)
    reach = _HALF_PX + 1
    concave = np.zeros(rms.shape, dtype=np.bool_)
    for axis in (0, 1):
        before, after = np.roll(normal, reach, axis), np.roll(normal, -reach, axis)
        p, q = np.roll(points, reach, axis), np.roll(points, -reach, axis)
        apart = q - p
        length = np.linalg.norm(apart, axis=-1)
        with np.errstate(invalid="ignore", divide="ignore"):
            # Facing each other, the normals of an inward crease lean towards one another.
            bend = np.einsum("ijk,ijk->ij", after - before, apart / length[..., None])
            turn = np.arccos(np.clip(np.einsum("ijk,ijk->ij", before, after), -1.0, 1.0))
        near = length < 0.5 * diameter_m
        found = near & (bend < 0.0) & (turn > _CONCAVE_RAD)
        edge = [slice(None), slice(None)]
        edge[axis] = slice(reach, -reach)
        concave[tuple(edge)] |= found[tuple(edge)]
    return concave


def extended_planes(
    smooth: SmoothFrame, flat_extent_m: float, diameter_m: float
) -> tuple[BoolArray, int]:
    """(height, width) pixels on planes that extend further than any flat part of the target, and
    how many such planes there are.

    The planes about single pixels are tried on those about others, the one that most lie on first.
    """
    taken = np.zeros(smooth.trusted.shape, dtype=np.bool_)
    tolerance = np.maximum(_PLANE_SIGMA * smooth.sigma_m, _PLANE_FRACTION * diameter_m)
    flat = smooth.trusted & np.isfinite(smooth.m[..., 0]) & smooth.flat
    seeds = _seeds(flat)
    if len(seeds) == 0:
        return taken, 0
    v, u = seeds.T
    with np.errstate(invalid="ignore", divide="ignore"):
        rays = smooth.points[v, u] / smooth.depth_m[v, u, None]
        m = smooth.m[v, u]
        apart = np.reciprocal(m @ rays.T)
        apart -= smooth.depth_m[v, u]
        on = np.abs(apart, out=apart) < tolerance[v, u]
    normal = m / np.linalg.norm(m, axis=1, keepdims=True)
    on &= np.abs(normal @ normal.T) > np.cos(_CONCAVE_RAD)
    left = np.ones(len(seeds), dtype=np.bool_)
    votes = np.count_nonzero(on, axis=1)
    count = 0
    for _ in range(_MAX_PLANES):
        best = int(np.argmax(votes))
        if votes[best] < _MIN_SEEDS:
            break
        plane = _refitted(smooth, seeds[on[best] & left], m[best])
        labels = smooth.components(_on(smooth, plane, tolerance) & ~taken)
        large = _large_parts(smooth, labels, _LARGER * flat_extent_m)
        if large.any():
            # Slivers of it that are seen between other things are its own, too.
            plane = _refitted(smooth, np.argwhere(large)[:: 1 + large.sum() // 2_000], plane)
            taken |= large | _beside(smooth, plane, tolerance)
            count += 1
        # What lies on the same plane elsewhere may still be on a large one of its own.
        gone = taken[v, u] | (on[best] & (labels[v, u] == labels[v[best], u[best]]))
        gone[best] = True
        votes -= np.count_nonzero(on[:, gone & left], axis=1)
        left &= ~gone
        votes[~left] = 0
    return taken, count


def _seeds(flat: BoolArray) -> IntArray:
    grid = np.zeros_like(flat)
    grid[::_SEED_PX, ::_SEED_PX] = True
    seeds = np.argwhere(flat & grid)
    return seeds[:: -(-len(seeds) // _MAX_SEEDS)] if len(seeds) else seeds


def _refitted(smooth: SmoothFrame, pixels: IntArray, m: FloatArray) -> FloatArray:
    """(3,) the plane of many pixels, weighted for equal noise of depth."""
    v, u = pixels.T
    if len(v) < 3:
        return m
    z = smooth.depth_m[v, u]
    rays = smooth.points[v, u] / z[:, None]
    weight = z**2 / smooth.sigma_m[v, u]
    found, *_ = np.linalg.lstsq(rays * weight[:, None], weight / z, rcond=None)
    return np.asarray(found)


def _on(smooth: SmoothFrame, m: FloatArray, tolerance: FloatArray) -> BoolArray:
    """(height, width) pixels on a plane: near it and flat along it, and those beside them.

    A strip of another surface lies near the plane wherever the two cross.
    """
    beside = _beside(smooth, m, tolerance)
    core = beside & smooth.flat
    if not core.any():
        return core
    square = np.ones((3, 3), dtype=np.bool_)
    box = bounding_box(beside)
    on = np.zeros_like(beside)
    on[box] = ndimage.binary_dilation(core[box], square, _HALF_PX + 1, mask=beside[box])
    return on


def _beside(smooth: SmoothFrame, m: FloatArray, tolerance: FloatArray) -> BoolArray:
    """(height, width) pixels near a plane, but those that are flat and turned against it."""
    length = float(np.linalg.norm(m))
    away = (smooth.points.reshape(-1, 3) @ m).reshape(tolerance.shape)
    away -= 1.0
    beside = np.abs(away, out=away) < length * tolerance
    beside &= smooth.depth_m > 0.0
    v, u = np.nonzero(beside & smooth.flat)
    own = smooth.m[v, u]
    with np.errstate(invalid="ignore"):
        cosine = np.abs(own @ m) / (np.linalg.norm(own, axis=1) * length)
        beside[v, u] = cosine > np.cos(2.0 * _CONCAVE_RAD)
    return np.asarray(beside)


def _large_parts(smooth: SmoothFrame, labels: IntArray, extent_m: float) -> BoolArray:
    """(height, width) the connected parts that extend further than given."""
    large = np.zeros(labels.shape, dtype=np.bool_)
    for part in parts_of(labels, _MIN_PART_PX):
        points = smooth.points[part]
        # No two points are further apart than the corners of the box about them.
        if np.linalg.norm(np.ptp(points, axis=0)) > extent_m and extent(points) > extent_m:
            large[part] = True
    return large


def extent(points: FloatArray) -> float:
    """Diameter of a cloud (n, 3) by two sweeps to the farthest point: at least 0.87 of the true
    one."""
    first = points[np.argmax(squared_distances(points, points.mean(axis=0)))]
    second = points[np.argmax(squared_distances(points, first))]
    third = points[np.argmax(squared_distances(points, second))]
    return float(np.linalg.norm(third - second))


def squared_distances(points: FloatArray, centre: FloatArray) -> FloatArray:
    """(n,) of points (n, 3) from one (3,)."""
    # Column by column: sums over a short axis are slow.
    x, y, z = (points[:, k] - centre[k] for k in range(3))
    return np.asarray(x * x + y * y + z * z)
