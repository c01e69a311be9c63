"""The pixels of a rendered view that lie inside its surfaces, and their range residuals."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray, neighbours
from pcnav.core.beams import Beams
from pcnav.core.camera import range_per_depth
from pcnav.perception.modality import RangeResiduals
from pcnav.perception.pose_doubt import GATE_SIGMA, PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.rendering import RenderedDepth

_CREASE_SIGMA = 0.5
"""A pixel is inside a surface when the faces of its neighbours, extended to it, differ from its own
by less than this many standard deviations of the noise and of the doubt about the pose."""
_BENT_SIGMA, _SHIFTED_SIGMA = 4.0, 0.1
"""So is one on a surface that bends, from pixel to pixel, by less than so many deviations: what a
pixel sees is a mean, off by up to an eighth of it. And by so little that a displaced view puts no
range off by more than a tenth of one, for it puts those of thousands of pixels off the same way."""
_MIN_COSINE = 0.1
"""Surfaces seen at more than 84 degrees are not used: within a pixel their range varies widely."""
_WHOLE_SHARE, _MIN_WHOLE = 0.5, 300
"""While it is not known what a pixel sees, those beside an edge are left out of a view of which
this share and so many pixels remain."""

FEW_PIXELS = 500
"""Of a view that covers no more, on the sensor's own grid, those beside creases take part as well:
hardly any others are left. Where they show the neighbour's face, gates tell."""


@dataclass(frozen=True)
class SurfacePixels:
    """Pixels inside the surfaces of a rendered view (n of them)."""

    pixels: tuple[IntArray, IntArray]
    """(n,) rows and (n,) columns of them in the rendered window."""
    triangle: IntArray
    """(n,) of the mesh."""
    rays: FloatArray
    """(n, 3) unit."""
    range_m: FloatArray
    """(n,) predicted."""
    range_per_depth: FloatArray
    """(n,)"""
    m: FloatArray
    """(n, 3) plane, ``m . ray = 1 / range``."""
    beam: IntArray | None = None
    """(n,) number of the beam of a scan; None where the pixels see for themselves."""

    def residuals(
        self,
        depth_m: DepthImage,
        rendered: RenderedDepth,
        doubt: PoseDoubt,
        noise: SensorNoise,
        face_of_triangle: IntArray,
        beams: Beams | None = None,
    ) -> RangeResiduals:
        """Of a frame (height, width), or of the beams of one, beside the view, whose pose is so
        uncertain."""
        if beams is None or self.beam is None:
            seen_m = depth_m[rendered.window][self.pixels] * self.range_per_depth
        else:
            seen_m = beams.within(depth_m).depth_m[self.beam] * self.range_per_depth
        returned = seen_m > 0.0
        residual = seen_m - self.range_m
        sigma_m = noise.sigma_at(self.range_m)
        # ``n . dx / (n . ray)`` at the surface point x.
        along, p_cam = self.m * self.range_m[:, None], self.rays * self.range_m[:, None]
        jacobian = doubt.by_pose(along, p_cam)
        variance = doubt.variance(jacobian)
        own = sigma_m**2 + noise.face_variance_m2 + variance
        centre_m = _offset_of_frame(residual[returned], own[returned], noise.frame_sd_m)
        return RangeResiduals(
            face=face_of_triangle[self.triangle],
            returned=returned,
            agrees=returned & ((residual - centre_m) ** 2 < GATE_SIGMA**2 * own),
            residual_m=residual,
            jacobian=jacobian,
            pose_variance_m2=variance,
            range_m=self.range_m,
            sigma_m=sigma_m,
            pixels=self.pixels,
            shape=rendered.triangle[rendered.window].shape,
        )


def _offset_of_frame(residual_m: FloatArray, variance_m2: FloatArray, sd_m: float) -> float:
    """Roughly what the residuals (n,) of a frame share, m: they are judged beside it."""
    if sd_m == 0.0:
        return 0.0
    near = residual_m[residual_m**2 < GATE_SIGMA**2 * (variance_m2 + sd_m**2)]
    return float(np.median(near)) if len(near) else 0.0


def surface_pixels(
    rendered: RenderedDepth,
    sigma_m: float,
    doubt_px: float,
    noise: SensorNoise,
    few_pixels: int = FEW_PIXELS,
    beams: Beams | None = None,
) -> SurfacePixels:
    """Those of a view, or of a scan all beams in such pixels.

    Args:
        rendered: the view.
        sigma_m: deviation of a range, by the noise and by the doubt about the pose.
        doubt_px: how far the view may be displaced.
        noise: of the sensor.
        few_pixels: of a view that covers no more, all take part.
        beams: of a scan; the view shows those pixels, too, that none of them fell in.
    """
    # A displaced view shows the neighbour's face in the place of a pixel's own, as far as it is
    # displaced: by that part of the bend its range is then off.
    bend_sigma = min(_SHIFTED_SIGMA / max(doubt_px, 1e-9), _BENT_SIGMA)
    inside = np.asarray(rendered.triangle[rendered.window] >= 0)
    if np.count_nonzero(inside) > few_pixels:
        inside = _away_from_creases(rendered, _CREASE_SIGMA * sigma_m, bend_sigma * sigma_m)
        if noise.may_have_footprint:
            inside = _whole(inside, noise)
    top, left = (part.start for part in rendered.window)
    if beams is None:
        rows, columns = np.nonzero(inside)
        pixels, beam = (rows, columns), None
        seen = (rows + top) * rendered.camera.width + (columns + left)
        per_depth = range_per_depth(rendered.camera).ravel()[seen]
        unit = rendered.rays.reshape(-1, 3)[seen] / per_depth[:, None]
        triangle = rendered.triangle.ravel()[seen]
        m = rendered.planes_at(triangle, (pixels[0] + top, pixels[1] + left))
    else:
        pixels, beam = _beams_inside(beams, inside, (top, left))
        rays = beams.rays[beam]
        per_depth = np.linalg.norm(rays, axis=1)
        unit = rays / per_depth[:, None]
        triangle = rendered.triangle[rendered.window][pixels]
        assert rendered.moving is not None, "a scan is seen through its own rays"
        m = rendered.moving.at(triangle, beams.slice[beam])
    norm = np.linalg.norm(m, axis=1)
    inverse = np.einsum("ij,ij->i", m, unit)
    steep = inverse < _MIN_COSINE * norm
    if steep.any():
        pixels = pixels[0][~steep], pixels[1][~steep]
        beam = None if beam is None else beam[~steep]
        triangle, per_depth, m, unit, inverse = (
            part[~steep] for part in (triangle, per_depth, m, unit, inverse)
        )
    return SurfacePixels(pixels, triangle, unit, 1.0 / inverse, per_depth, m, beam)


def _beams_inside(
    beams: Beams, inside: BoolArray, corner: tuple[int, int]
) -> tuple[tuple[IntArray, IntArray], IntArray]:
    """Rows and columns in a window, of pixels marked inside, and the beams that fell in them."""
    v, u = np.divmod(beams.pixel, beams.shown.shape[1])
    v, u = v - corner[0], u - corner[1]
    height, width = inside.shape
    beam = np.flatnonzero((v >= 0) & (v < height) & (u >= 0) & (u < width))
    beam = beam[inside[v[beam], u[beam]]]
    return (v[beam], u[beam]), beam


def _away_from_creases(rendered: RenderedDepth, crease_m: float, bend_m: float) -> BoolArray:
    """(height, width) of the window: pixels whose neighbours lie on the same surface, but for a
    crease that makes no difference to the pixel, or a bend that makes little."""
    triangle = np.ascontiguousarray(rendered.triangle[rendered.window])
    inside = np.asarray(triangle >= 0)
    # Slices, for a target out of view leaves an empty window.
    inside[:1] = inside[-1:] = False
    inside[:, :1] = inside[:, -1:] = False
    # By places in flat images: NumPy picks by rows and columns in twice the time.
    shown, marks, width = triangle.ravel(), inside.ravel(), triangle.shape[1]
    planes, rays = rendered.inverse_depth_planes, rendered.rays.reshape(-1, 3)
    depth_m = rendered.depth_m.ravel()
    for (first, second), step in ((neighbours(1), 1), (neighbours(0), width)):
        i, j = np.nonzero(triangle[first] != triangle[second])
        here = i * width + j
        a, b = shown[here], shown[here + step]
        both = (a >= 0) & (b >= 0)
        beside_space, here = here[~both], here[both]
        marks[beside_space] = marks[beside_space + step] = False
        between = planes[b[both]] - planes[a[both]]
        # Relative gap of inverse depths is that of depths.
        gaps = []
        for places in (here, here + step):
            seen = _in_image(places, rendered)
            depth = depth_m[seen].astype(np.float64)
            gaps.append(np.einsum("ij,ij->i", between, rays[seen]) * depth**2)
        # Where a surface bends, its faces change places between the pixels; at a step they do not.
        bends = (gaps[0] * gaps[1] <= 0.0) & (np.abs(gaps[0] - gaps[1]) < bend_m)
        for places, gap in zip((here, here + step), gaps, strict=True):
            marks[places[~(bends | (np.abs(gap) < crease_m))]] = False
    return inside


def _in_image(places: IntArray, rendered: RenderedDepth) -> IntArray:
    """(n,) places in the flat image, of places (n,) in the flat window of a view."""
    rows, columns = rendered.window
    i, j = np.divmod(places, columns.stop - columns.start)
    return np.asarray((i + rows.start) * rendered.camera.width + (j + columns.start))


def _whole(inside: BoolArray, noise: SensorNoise) -> BoolArray:
    """Pixels that see nothing but their surface in all of their area, where enough do."""
    whole = ndimage.binary_erosion(inside, np.ones((3, 3), dtype=np.bool_))
    left, n = np.count_nonzero(whole), np.count_nonzero(inside)
    if noise.has_footprint or left > max(_WHOLE_SHARE * n, _MIN_WHOLE):
        return np.asarray(whole)
    return inside
