"""Where the projected edges of a mesh cross the columns or rows of an image."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray, picked
from pcnav.core.camera import PinholeCamera, project, projection_jacobian
from pcnav.core.spatial import transform_points
from pcnav.perception.bent_edges import edge_segments
from pcnav.perception.mesh_edges import MeshEdges
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.target.rendering import RenderedDepth

_MANY_EDGES, _MIN_SPAN_PX = 10_000, 1.0
"""Of more edges than this, those that are imaged shorter are not looked at: a crossing counts
beside two others of its edge."""
_PIXEL_ROUNDS = 2
"""A pixel's time moves a point by far less than the pixels between."""


@dataclass(frozen=True)
class EdgeCrossings:
    """Crossings of projected edges with pixel columns or rows, edge after edge."""

    edge: IntArray
    major: IntArray
    """(n,) the column (or row) crossed."""
    minor: FloatArray
    """(n,) where along it, pixels."""
    upright: BoolArray
    """(n,) whether a row is crossed (the edge is steeper than 45 degrees)."""
    slope: FloatArray
    """(n,) change of minor by major."""
    side: IntArray
    """(n,) +1 where the part lies at larger minor, else -1."""
    p_cam: FloatArray
    """(n, 3) point of the edge, m."""
    is_bent: bool
    """Whether edges are curves in the image."""

    def by_offsets(self, kind: int | IntArray) -> FloatArray:
        """(n, 4) outward displacement, pixels, by the offsets of the outline, see
        `SensorNoise.outline_offset_px`; ``kind`` (n,) 0 where space lies behind the edge, 1 where
        another surface does."""
        space = np.broadcast_to(np.equal(kind, 0), self.slope.shape)
        steepness = np.abs(self.slope)
        both = [space, steepness * space, ~space, steepness * ~space]
        return np.column_stack(both).astype(np.float64)

    def displacement_jacobian(self, camera: PinholeCamera, doubt: PoseDoubt) -> FloatArray:
        """(n, 6) outward displacement of the edge at each crossing, pixels, by the pose."""
        # Image motion of the point across the edge: minor minus slope times major.
        du, dv = np.moveaxis(projection_jacobian(camera, self.p_cam), 1, 0)
        slope = self.slope[:, None]
        across = np.where(self.upright[:, None], du - slope * dv, dv - slope * du)
        return doubt.by_pose(-self.side[:, None] * across, self.p_cam)

    def across(self, minor: IntArray) -> tuple[IntArray, IntArray]:
        """Column and row of pixels (n, k) that lie at ``minor`` along what is crossed."""
        major = np.broadcast_to(self.major[:, None], minor.shape)
        upright = self.upright[:, None]
        return np.where(upright, minor, major), np.where(upright, major, minor)

    def any_beside(self, mask: BoolArray, reach: int) -> BoolArray:
        """(n,) whether any pixel near each crossing, on either side, is of a kind."""
        steps = np.arange(-reach, reach + 2)
        u, v = self.across(np.floor(self.minor).astype(np.intp)[:, None] + steps)
        height, width = mask.shape
        return np.asarray(mask[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].any(axis=1))

    @property
    def pixels(self) -> FloatArray:
        """(n, 2) u, v."""
        major = self.major.astype(np.float64)
        return np.where(
            self.upright[:, None],
            np.column_stack([self.minor, major]),
            np.column_stack([major, self.minor]),
        )


@dataclass(frozen=True)
class _Imaging:
    """Where the points of a target at a pose are imaged."""

    rendered: RenderedDepth
    T_cam_model: FloatArray

    @property
    def is_bent(self) -> bool:
        return self.rendered.camera.distortion is not None or self.rendered.moving is not None

    def pixels(self, p_cam: FloatArray) -> FloatArray:
        """(..., 2) of points (..., 3) of the target where the pose has them."""
        camera = self.rendered.camera
        pixels = project(camera, p_cam)
        if self.rendered.moving is None:
            return pixels
        # The pixel of a point is that in which it is when that pixel is exposed.
        for _ in range(_PIXEL_ROUNDS):
            pixels = project(camera, self.when_seen(p_cam, pixels))
        return pixels

    def when_seen(self, p_cam: FloatArray, pixels: FloatArray) -> FloatArray:
        """(..., 3) where the points are when pixels (..., 2) are exposed."""
        moving = self.rendered.moving
        if moving is None:
            return p_cam
        p_model = (p_cam - self.T_cam_model[:3, 3]) @ self.T_cam_model[:3, :3]
        return moving.moved(p_model, pixels)


@dataclass(frozen=True)
class _Chords:
    """Edges that may bound the target, or parts of them, each straight in the image."""

    edge: IntArray
    """(k,) of the mesh."""
    start_cam: FloatArray
    """(k, 3) m."""
    end_cam: FloatArray
    first_px: FloatArray
    """(k, 2) where it starts in the image."""
    second_px: FloatArray
    on_left: BoolArray
    """(k,) whether the faces lie to its left, v being down."""


def edge_crossings(
    edges: MeshEdges, rendered: RenderedDepth, T_cam_model: FloatArray
) -> EdgeCrossings:
    """Those of the edges that bound the target, or a part of it, in a view.

    Args:
        edges: of the mesh.
        rendered: the view.
        T_cam_model: (4, 4) the pose that it was rendered at.
    """
    imaging = _Imaging(rendered, T_cam_model)
    found = _crossings(_bounding(edges, imaging), rendered.camera, imaging.is_bent)
    if not imaging.is_bent:
        return found
    found = replace(found, p_cam=imaging.when_seen(found.p_cam, found.pixels))
    # The segments of an edge that runs left or up follow each other against their crossings.
    return picked(found, np.lexsort((found.major, found.upright, found.edge)))


def _bounding(edges: MeshEdges, imaging: _Imaging) -> _Chords:
    """The edges beyond which one looks past a part of the target."""
    camera = imaging.rendered.camera
    edge, ends, wings, vertices = _candidates(edges, imaging.rendered)
    p_cam = transform_points(imaging.T_cam_model, vertices)
    z = p_cam[:, 2]
    in_front = z > 1e-3 * float(np.abs(z).max(initial=0.0))
    safe = np.where(in_front[:, None], p_cam, [0.0, 0.0, 1.0])
    pixels = project(camera, safe)
    # Which side of an edge a point lies on is seen where edges are straight.
    places = safe[:, :2] / safe[:, 2:] if imaging.is_bent else pixels
    along = places[ends[:, 1]] - places[ends[:, 0]]
    to_wings = places[wings] - places[ends[:, 0]][:, None, :]
    cross = along[:, None, 0] * to_wings[..., 1] - along[:, None, 1] * to_wings[..., 0]
    # Faces on one side of the edge only: beyond it one looks past the part.
    bounds = (cross > 0.0).all(axis=1) | (cross < 0.0).all(axis=1)
    bounds &= in_front[ends].all(axis=1) & in_front[wings].all(axis=1)
    edge, ends, on_left = edge[bounds], ends[bounds], cross[bounds, 0] > 0.0
    start, end = p_cam[ends[:, 0]], p_cam[ends[:, 1]]
    first, second = pixels[ends[:, 0]], pixels[ends[:, 1]]
    if imaging.is_bent:
        cut = edge_segments(camera, imaging.pixels, start, end)
        edge, on_left = edge[cut.edge], on_left[cut.edge]
        start, end = cut.start_cam, cut.end_cam
        first, second = imaging.pixels(start), imaging.pixels(end)
    return _Chords(edge, start, end, first, second, on_left)


def _candidates(
    edges: MeshEdges, rendered: RenderedDepth
) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Edges (k,) that may bound the target over some pixels; their ends (k, 2) and wings (k, w)
    among vertices (m, 3) of the model."""
    depth = rendered.depth_m[rendered.window]
    if len(edges) <= _MANY_EDGES or not depth.any():
        return np.arange(len(edges)), edges.ends, edges.wings, edges.vertices
    nearest_m = float(depth[depth > 0.0].min())
    focal = max(rendered.camera.fx, rendered.camera.fy)
    edge = edges.at_least(_MIN_SPAN_PX * nearest_m / focal)
    both = np.hstack([edges.ends[edge], edges.wings[edge]])
    used, places = np.unique(both, return_inverse=True)
    places = places.reshape(both.shape)
    return edge, places[:, :2], places[:, 2:], edges.vertices[used]


def _crossings(chords: _Chords, camera: PinholeCamera, is_bent: bool) -> EdgeCrossings:
    first, second = chords.first_px, chords.second_px
    upright = np.abs(second - first)[:, 1] > np.abs(second - first)[:, 0]
    axis = upright.astype(np.intp)
    rows = np.arange(len(chords.edge))
    a0, b0 = first[rows, axis], first[rows, 1 - axis]
    a1, b1 = second[rows, axis], second[rows, 1 - axis]
    length = np.where(np.abs(a1 - a0) > 0.0, a1 - a0, np.inf)
    slope = (b1 - b0) / length
    size = np.where(upright, camera.height, camera.width)
    low = np.maximum(np.ceil(np.minimum(a0, a1)), 0.0).astype(np.intp)
    high = np.minimum(np.floor(np.maximum(a0, a1)), size - 1.0).astype(np.intp)
    counts = np.maximum(high - low + 1, 0)
    index = np.repeat(rows, counts)
    major = low[index] + np.arange(len(index)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = (major - a0[index]) / length[index]
    start, end = chords.start_cam[index], chords.end_cam[index]
    # The inverse of depth is linear in the image.
    weight = share * start[:, 2] / (share * start[:, 2] + (1.0 - share) * end[:, 2])
    # Left of the edge (v down) means larger v for one that runs right, and smaller u for one that
    # runs down.
    turned = np.where(upright, -np.sign(a1 - a0), np.sign(a1 - a0))
    side = np.where(chords.on_left, turned, -turned).astype(np.intp)
    return EdgeCrossings(
        edge=chords.edge[index],
        major=major,
        minor=b0[index] + slope[index] * (major - a0[index]),
        upright=upright[index],
        slope=slope[index],
        side=side[index],
        p_cam=start + weight[:, None] * (end - start),
        is_bent=is_bent,
    )
