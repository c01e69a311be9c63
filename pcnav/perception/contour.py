"""Where the outline of a target lies in an image, compared with where a pose predicts it.

The occluding edges of the mesh are projected, and where one crosses a pixel column (or row) the two
pixels beside the crossing should show the part it bounds and what lies behind. Each pixel on the
wrong side is one pixel of displacement there. Over a straight edge these counts have a mean and a
tilt, two measurements whose errors come from the pixel grid alone and follow in closed form from
how uncertain the prediction is.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.ndimage import uniform_filter1d

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray, picked
from pcnav.core.camera import PinholeCamera, pixel_rays, project, projection_jacobian
from pcnav.core.spatial import transform_points
from pcnav.perception.bent_edges import bent_grid_variances, edge_segments
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.mesh import mesh_diameter
from pcnav.target.rendering import RenderedDepth

_GATE_SIGMA = 4.0
"""A return belongs to a predicted surface when it is this near, in standard deviations."""
_NEAR_FRACTION = 0.01
"""The pixel beside an edge shows the part it bounds when their depths differ by less than this
share of the diameter: rims thinner than a pixel lie between them."""
_APART = 1.25
"""Two surfaces are distinguished where they differ by this many times the sum of their
tolerances."""
_SHARP_PX = 0.3
"""Predictions better than this need one pixel on each side of an edge."""
_MAX_REACH_PX = 4
_SATURATED = 0.6
"""Beyond this share of the pixels looked at on each side, a count is only a bound."""
_MAX_UNKNOWN = 0.5
"""With more than this share of unusable pixels beside an edge it says nothing."""
_ABOUT_CROSSINGS = 5
_MAX_UNMODELLED = 0.5
"""Where more of the crossings about one than this show neither the part nor what lies behind it,
something that is not of the model hides the edge. Lone ones are outliers."""
_RUN_GATE_SIGMA = 4.0
"""An edge displaced by more standard deviations than this is not the one of the mesh."""
OFFSET_PX = 0.1
"""How far beside the predicted edges pixels are counted."""
_EDGE_SD_PX = 0.01
"""How well mesh and lens are known at best, along an edge."""
_GRAZED_SD_PX = 0.5
"""How well the far edge of a face is told that is seen at grazing incidence, where what returns
from a pixel may be of that face or of the one beside it."""
_ONE_PIXEL_SIGMA = 2.5
"""A single displaced pixel may be at most so many standard deviations: its law has a long tail that
a variance alone does not tell, and the gates go by variances."""
_ROW_ROUNDS = 2
"""A row's time moves a point by far less than the rows between."""
_COPLANAR = 1e-6
_MEAN_ABS_NORMAL = float(np.sqrt(2.0 / np.pi))
"""Mean absolute value of a standard normal variable."""


@dataclass(frozen=True)
class MeshEdges:
    """Edges of a mesh that can bound it in an image."""

    vertices: FloatArray
    """(m, 3) model frame, m."""
    diameter_m: float
    """Of the mesh."""
    ends: IntArray
    """(n, 2) vertices."""
    wings: IntArray
    """(n, k) the third vertices of the triangles at each edge, padded by repetition."""


@dataclass(frozen=True)
class ContourRuns:
    """Unbroken stretches of edges, each with its displacement and tilt. Pixels.

    Measured minus predicted, positive where the near part covers more than predicted.
    """

    value: FloatArray
    """(n,)"""
    variance: FloatArray
    """(n,)"""
    jacobian: FloatArray
    """(n, 6) by the pose: translation of the model origin (m, camera axes), rotation (rad, model
    axes)."""
    triangle: IntArray
    """(n,) of the mesh, seen beside the edge."""
    shared: FloatArray
    """(n, 4) by the offsets of the outline, see `SensorNoise.outline_offset_px`."""

    def __len__(self) -> int:
        return len(self.value)


def mesh_edges(mesh: trimesh.Trimesh) -> MeshEdges:
    """All edges of a mesh but those inside its flat faces."""
    faces = np.array(mesh.faces, dtype=np.intp)
    pairs = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    opposite = faces[:, [2, 0, 1]].ravel()
    owner = np.repeat(np.arange(len(faces)), 3)
    ends, edge = np.unique(pairs, axis=0, return_inverse=True)
    order = np.argsort(edge.ravel(), kind="stable")
    counts = np.bincount(edge.ravel())
    starts = np.cumsum(counts) - counts
    rank = np.arange(len(order)) - np.repeat(starts, counts)
    first = order[starts]
    wings = np.repeat(opposite[first][:, None], counts.max(), axis=1)
    wings[edge.ravel()[order], rank] = opposite[order]
    normals = np.array(mesh.face_normals)
    second = order[starts + (counts > 1)]
    flat = np.einsum("ij,ij->i", normals[owner[first]], normals[owner[second]]) > 1.0 - _COPLANAR
    bounds = (counts != 2) | ~flat
    vertices = np.array(mesh.vertices, dtype=np.float64)
    return MeshEdges(vertices, mesh_diameter(mesh), ends[bounds], wings[bounds])


@dataclass(frozen=True)
class PoseDoubt:
    """A pose, how uncertain it is, and what else makes a surface differ from where it is seen."""

    T_cam_model: FloatArray
    """(4, 4)"""
    covariance: FloatArray
    """(6, 6) of its error, as for `ContourRuns.jacobian`."""
    sigma_m: float
    """Range noise."""

    def by_pose(self, gradient: FloatArray, p_cam: FloatArray) -> FloatArray:
        """(n, 6) derivative by the pose of what changes by gradients (n, 3) where points of the
        target (n, 3) move."""
        R = self.T_cam_model[:3, :3]
        p_model = (p_cam - self.T_cam_model[:3, 3]) @ R
        return np.hstack([gradient, np.cross(p_model, gradient @ R)])

    def variance(self, jacobian: FloatArray) -> FloatArray:
        """(n,) variance that the pose's error makes of quantities with derivatives (n, 6) by it."""
        return np.asarray(np.einsum("ij,ij->i", jacobian @ self.covariance, jacobian))

    def tolerance(self, planes: FloatArray, p_cam: FloatArray) -> FloatArray:
        """(n,) metres within which returns belong to planes (n, 3), near points (n, 3) on them.

        Where a surface moves by dx the depth along a ray changes by ``z m . dx``: on steep faces by
        many times as much.
        """
        variance = self.variance(self.by_pose(planes * p_cam[:, 2:], p_cam))
        return np.asarray(_GATE_SIGMA * np.sqrt(self.sigma_m**2 + variance))


def contour_runs(
    edges: MeshEdges,
    depth_m: DepthImage,
    rendered: RenderedDepth,
    doubt: PoseDoubt,
    dropout: float,
    noise: SensorNoise,
    unknown: BoolArray | None = None,
) -> ContourRuns:
    """The outline of a frame against the view rendered at a pose.

    Args:
        edges: of the mesh.
        depth_m: (height, width) the frame.
        rendered: the view from the pose.
        doubt: about the pose.
        dropout: share of the returns that are lost at random.
        noise: of the sensor: where it sees an outline.
        unknown: (height, width) pixels that say nothing of the outline, see `OutlineFrame`.
    """
    samples = _sampled(edges, rendered, doubt.T_cam_model)
    shift_px = _offsets(len(edges.ends), doubt.T_cam_model)[samples.edge]
    shift_px = shift_px + samples.by_offsets(0) @ noise.outline_offset_px
    jacobian = _displacement_jacobian(samples, rendered.camera, doubt)
    variance_px = np.einsum("ij,jk,ik->i", jacobian, doubt.covariance, jacobian)
    doubt_px = float(np.sqrt(variance_px.max())) if len(variance_px) else 0.0
    reach = contour_reach(doubt_px)
    counted = _count(
        *(samples, shift_px, depth_m, rendered, reach, doubt, dropout, edges.diameter_m),
        among_others=unknown is not None and bool(unknown.any()),
    )
    if unknown is not None:
        counted = replace(counted, usable=counted.usable & ~_any_beside(samples, unknown, reach))
    kept = _between_others(samples, counted)
    counted = replace(picked(counted, kept), shift_px=shift_px[kept])
    is_rough = unknown is not None
    return _runs(picked(samples, kept), counted, jacobian[kept], doubt, reach, noise, is_rough)


def contour_reach(doubt_px: float) -> int:
    """How many pixels on each side of an edge are counted, where it may be so far off, pixels."""
    return 1 if doubt_px < _SHARP_PX else min(int(np.ceil(2.0 * doubt_px)) + 1, _MAX_REACH_PX)


def _offsets(n: int, T_cam_model: FloatArray) -> FloatArray:
    """(n,) how far outward of each predicted edge pixels are counted, plus or minus `OFFSET_PX`.

    Counted at the predicted edge itself, a good prediction sees no displaced pixel in most frames,
    and how good it is would have to be known to say what that means: a filter that thinks too well
    of itself is never put right. Counted a known step away, the counts tell the same displacement
    with noise that does not depend on the prediction. The signs are drawn from the pose, so that a
    comparison can be repeated.
    """
    seed = np.frombuffer(np.ascontiguousarray(T_cam_model).tobytes(), dtype=np.uint32)
    signs = np.random.default_rng(seed).integers(0, 2, n)
    return np.asarray(OFFSET_PX * (2.0 * signs - 1.0), dtype=np.float64)


@dataclass(frozen=True)
class _Samples:
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
        """(n, 4) outward displacement, pixels, by the offsets of the outline; ``kind`` (n,) as in
        `_Counted`."""
        space = np.broadcast_to(np.equal(kind, 0), self.slope.shape)
        steepness = np.abs(self.slope)
        both = [space, steepness * space, ~space, steepness * ~space]
        return np.column_stack(both).astype(np.float64)

    @property
    def pixels(self) -> FloatArray:
        """(n, 2) u, v."""
        major = self.major.astype(np.float64)
        return np.where(
            self.upright[:, None],
            np.column_stack([self.minor, major]),
            np.column_stack([major, self.minor]),
        )


def _sampled(edges: MeshEdges, rendered: RenderedDepth, T_cam_model: FloatArray) -> _Samples:
    camera, moving = rendered.camera, rendered.row_planes
    is_bent = camera.distortion is not None or moving is not None

    def image(p_cam: FloatArray) -> FloatArray:
        pixels = project(camera, p_cam)
        if moving is None:
            return pixels
        # The row of a point is that in which it is when that row is exposed.
        for _ in range(_ROW_ROUNDS):
            pixels = project(camera, at_row(p_cam, pixels[..., 1]))
        return pixels

    def at_row(p_cam: FloatArray, row: FloatArray) -> FloatArray:
        if moving is None:
            return p_cam
        p_model = (p_cam - T_cam_model[:3, 3]) @ T_cam_model[:3, :3]
        return moving.moved(p_model, row)

    p_cam = transform_points(T_cam_model, edges.vertices)
    z = p_cam[:, 2]
    in_front = z > 1e-3 * float(np.abs(z).max())
    safe = np.where(in_front[:, None], p_cam, [0.0, 0.0, 1.0])
    pixels, ends = project(camera, safe), edges.ends
    # Which side of an edge a point lies on is seen where edges are straight.
    places = safe[:, :2] / safe[:, 2:] if is_bent else pixels
    along = places[ends[:, 1]] - places[ends[:, 0]]
    to_wings = places[edges.wings] - places[ends[:, 0]][:, None, :]
    cross = along[:, None, 0] * to_wings[..., 1] - along[:, None, 1] * to_wings[..., 0]
    # Faces on one side of the edge only: beyond it one looks past the part.
    bounds = (cross > 0.0).all(axis=1) | (cross < 0.0).all(axis=1)
    bounds &= in_front[ends].all(axis=1) & in_front[edges.wings].all(axis=1)
    edge = np.flatnonzero(bounds)
    start, end = p_cam[ends[edge, 0]], p_cam[ends[edge, 1]]
    first, second = pixels[ends[edge, 0]], pixels[ends[edge, 1]]
    if is_bent:
        cut = edge_segments(camera, image, start, end)
        edge, start, end = edge[cut.edge], cut.start_cam, cut.end_cam
        first, second = image(start), image(end)
    on_left = cross[edge, 0] > 0.0
    upright = np.abs(second - first)[:, 1] > np.abs(second - first)[:, 0]
    axis = upright.astype(np.intp)
    rows = np.arange(len(edge))
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
    z0, z1 = start[index, 2], end[index, 2]
    # The inverse of depth is linear in the image.
    weight = share * z0 / (share * z0 + (1.0 - share) * z1)
    # Left of the edge (v down) means larger v for one that runs right, and smaller u for one that
    # runs down.
    turned = np.where(upright, -np.sign(a1 - a0), np.sign(a1 - a0))
    side = np.where(on_left, turned, -turned).astype(np.intp)
    samples = _Samples(
        edge=edge[index],
        major=major,
        minor=b0[index] + slope[index] * (major - a0[index]),
        upright=upright[index],
        slope=slope[index],
        side=side[index],
        p_cam=start[index] + weight[:, None] * (end[index] - start[index]),
        is_bent=is_bent,
    )
    if not is_bent:
        return samples
    samples = replace(samples, p_cam=at_row(samples.p_cam, samples.pixels[:, 1]))
    # The segments of an edge that runs left or up follow each other against their crossings.
    return picked(samples, np.lexsort((samples.major, samples.upright, samples.edge)))


def _displacement_jacobian(
    samples: _Samples, camera: PinholeCamera, doubt: PoseDoubt
) -> FloatArray:
    """(n, 6) outward displacement of the edge at each crossing, pixels, by the pose."""
    # Image motion of the point across the edge: minor minus slope times major.
    du, dv = np.moveaxis(projection_jacobian(camera, samples.p_cam), 1, 0)
    slope = samples.slope[:, None]
    across = np.where(samples.upright[:, None], du - slope * dv, dv - slope * du)
    return doubt.by_pose(-samples.side[:, None] * across, samples.p_cam)


@dataclass(frozen=True)
class _Counted:
    usable: BoolArray
    displacement_px: FloatArray
    extra_variance: FloatArray
    """(n,) beyond that of the pixel grid, px^2; where a surface lies behind the edge, of each pixel
    that is displaced."""
    kind: IntArray
    """(n,) 0 where space lies behind the edge, 1 where another surface does."""
    triangle: IntArray
    shift_px: FloatArray
    """(n,) how far outward of the predicted edge pixels were counted."""
    common_px2: FloatArray
    """(n,) variance of an error that the crossings of an edge share, px^2."""


def _count(
    samples: _Samples,
    shift_px: FloatArray,
    depth_m: DepthImage,
    rendered: RenderedDepth,
    reach: int,
    doubt: PoseDoubt,
    dropout: float,
    diameter_m: float,
    among_others: bool,
) -> _Counted:
    camera = rendered.camera
    below = np.floor(samples.minor - samples.side * shift_px).astype(np.intp)
    nearest = np.where(samples.side > 0, below + 1, below)
    # The pixels counted on each side, and after them one more, which tells what should be there:
    # the line counted at is not where the view has its edge.
    steps = np.arange(reach + 1)
    near = nearest[:, None] + samples.side[:, None] * steps
    far = nearest[:, None] - samples.side[:, None] * (steps + 1)
    minor = np.hstack([near, far])
    size = np.where(samples.upright, camera.width, camera.height)
    inside = ((minor >= 0) & (minor < size[:, None])).all(axis=1)
    minor = np.clip(minor, 0, size[:, None] - 1)
    major = np.broadcast_to(samples.major[:, None], minor.shape)
    upright = samples.upright[:, None]
    u, v = np.where(upright, minor, major), np.where(upright, major, minor)
    triangle = rendered.triangle[v, u]
    rays = pixel_rays(camera)[v, u]
    near_triangle, far_triangle = triangle[:, reach], triangle[:, -1]
    near_plane, far_plane = (
        rendered.planes_at(seen, row)
        for seen, row in ((near_triangle, v[:, reach]), (far_triangle, v[:, -1]))
    )
    edge_z = samples.p_cam[:, 2]
    edge_rays = samples.p_cam / edge_z[:, None]
    beside_z = _depths(near_plane, edge_rays[:, None])[:, 0]
    space = far_triangle < 0
    far_z = np.where(space, edge_z, _depths(far_plane, rays[:, -1:])[:, 0])
    gap = np.where(space, np.inf, far_z - edge_z)
    allowed = np.minimum(_NEAR_FRACTION * diameter_m, 0.25 * gap)
    plain = (near_triangle >= 0) & (np.abs(beside_z - edge_z) < allowed)
    beyond = np.ones_like(plain)
    counted = np.r_[0:reach, reach + 1 : 2 * reach + 1]
    if reach > 1:
        # The strip must be plain: the part on one side, one surface or space on the other.
        near_z = rendered.depth_m[v[:, 1:reach], u[:, 1:reach]]
        predicted = _depths(near_plane, rays[:, 1:reach])
        plain &= (np.abs(near_z - predicted) < allowed[:, None]).all(axis=1)
        beyond = (triangle[:, reach + 2 :] == far_triangle[:, None]).all(axis=1)
    # The far edge of a face seen at grazing incidence has another face beside it at once. Among
    # other things, where the near edges may touch some of them, it is often all that is left.
    stepped = ~plain & space & (triangle[:, 1 : reach + 1] >= 0).all(axis=1)
    stepped &= among_others
    usable = inside & beyond & (plain | stepped)
    deep_z = np.where(stepped, rendered.depth_m[v[:, reach], u[:, reach]], edge_z)
    p_behind = rays[:, -1] * far_z[:, None]
    u, v, rays = u[:, counted], v[:, counted], rays[:, counted]
    seen = depth_m[v, u].astype(np.float64)
    returned = seen > 0.0
    part_z, behind_z = _depths(near_plane, rays), _depths(far_plane, rays)
    # Displaced, the edge shows the rim that lies between it and the pixel beside it.
    half_rim = 0.5 * np.clip(edge_z - beside_z, -allowed, allowed)[:, None]
    part_z = part_z + half_rim
    part_tolerance = doubt.tolerance(near_plane, samples.p_cam)[:, None]
    part_tolerance = part_tolerance + np.abs(half_rim)
    # Whatever lies between the two is the part then.
    half_step = 0.5 * np.abs(edge_z - deep_z)[:, None]
    part_z = np.where(stepped[:, None], 0.5 * (edge_z + deep_z)[:, None], part_z)
    part_tolerance = np.where(
        stepped[:, None], half_step + _GATE_SIGMA * doubt.sigma_m, part_tolerance
    )
    behind_tolerance = doubt.tolerance(far_plane, p_behind)[:, None]
    is_part = returned & (np.abs(seen - part_z) < part_tolerance)
    is_behind = returned & (np.abs(seen - behind_z) < behind_tolerance)
    # Extended beyond the edge, a steep part may come near what lies behind.
    told_apart = behind_z - part_z > _APART * (part_tolerance + behind_tolerance)
    usable &= space | told_apart.all(axis=1)
    unmodelled = (returned & ~is_part & (space[:, None] | ~is_behind)).any(axis=1)
    usable &= uniform_filter1d(unmodelled.astype(np.float64), _ABOUT_CROSSINGS) < _MAX_UNMODELLED
    grown = is_part[:, reach:].sum(axis=1).astype(np.float64)
    lost = (~returned[:, :reach]).sum(axis=1) - dropout * reach
    covered = is_behind[:, :reach].sum(axis=1)
    known = (is_part | is_behind).mean(axis=1)
    surfaces = usable & ~space
    unknown = 1.0 - float(known[surfaces].mean()) if surfaces.any() else 1.0
    if unknown > _MAX_UNKNOWN:
        usable &= space
    unknown = min(unknown, _MAX_UNKNOWN)
    displacement = shift_px + np.where(
        space, (grown - lost) / (1.0 - dropout), (grown - covered) / (1.0 - unknown)
    )
    # Which pixels are lost is chance: of those looked at on the part that stands before space, of
    # those displaced before another surface.
    extra = np.where(space, reach * dropout / (1.0 - dropout), unknown / (1.0 - unknown))
    common = np.where(stepped, _GRAZED_SD_PX**2, 0.0)
    return _Counted(
        usable, displacement, extra, (~space).astype(np.intp), near_triangle, shift_px, common
    )


def _any_beside(samples: _Samples, mask: BoolArray, reach: int) -> BoolArray:
    """(n,) whether any pixel near each crossing, on either side, is of a kind."""
    steps = np.arange(-reach, reach + 2)
    minor = np.floor(samples.minor).astype(np.intp)[:, None] + steps
    major = np.broadcast_to(samples.major[:, None], minor.shape)
    upright = samples.upright[:, None]
    u, v = np.where(upright, minor, major), np.where(upright, major, minor)
    height, width = mask.shape
    return np.asarray(mask[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].any(axis=1))


def _depths(planes: FloatArray, rays: FloatArray) -> FloatArray:
    """(n, k) z-depth where rays (n, k, 3) meet planes (n, 3); infinite where they never do."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.einsum("ij,ikj->ik", planes, rays))


def _between_others(samples: _Samples, counted: _Counted) -> BoolArray:
    """(n,) usable crossings whose neighbours along the edge are usable, too.

    At the last crossing before a corner, or before something hides the edge, the pixels beside it
    may be cut by the other edge as well.
    """
    joined = np.zeros(len(samples.edge) + 1, dtype=np.bool_)
    joined[1:-1] = (
        (np.diff(samples.edge) == 0) & (np.diff(samples.major) == 1) & (np.diff(counted.kind) == 0)
    )
    joined[1:-1] &= samples.upright[1:] == samples.upright[:-1]
    joined[1:-1] &= counted.usable[1:] & counted.usable[:-1]
    return np.asarray(joined[1:] & joined[:-1])


def _runs(
    samples: _Samples,
    counted: _Counted,
    jacobian: FloatArray,
    doubt: PoseDoubt,
    reach: int,
    noise: SensorNoise,
    is_rough: bool,
) -> ContourRuns:
    edge, kind, displacement = samples.edge, counted.kind, counted.displacement_px
    if len(edge) == 0:
        empty = np.empty(0)
        none = np.empty(0, dtype=np.intp)
        return ContourRuns(empty, empty, np.empty((0, 6)), none, np.empty((0, 4)))
    breaks = (np.diff(edge) != 0) | (np.diff(samples.major) != 1) | (np.diff(kind) != 0)
    breaks |= samples.upright[1:] != samples.upright[:-1]
    starts = np.concatenate([[0], np.flatnonzero(breaks) + 1])
    n = np.diff(np.append(starts, len(edge)))
    offset = np.arange(len(edge)) - np.repeat(starts + 0.5 * (n - 1), n)
    spread = np.add.reduceat(offset**2, starts)
    tilt_weight = offset / np.repeat(np.maximum(spread, 0.5), n)
    mean_weight = np.repeat(1.0 / n, n)
    by_offsets = samples.by_offsets(kind)
    expected = by_offsets @ noise.outline_offset_px
    offset_px2 = ((by_offsets[starts] * noise.outline_offset_sd_px) ** 2).sum(axis=1)
    pose_px2 = np.add.reduceat(doubt.variance(jacobian), starts) / n
    doubt_px2 = pose_px2 + offset_px2
    # Where a line as far from the edge as these would be, pixels were counted.
    apart = np.abs(np.abs(expected - counted.shift_px)[starts])
    displaced = np.hypot(apart, _MEAN_ABS_NORMAL * np.sqrt(doubt_px2))
    if samples.is_bent:
        grid = bent_grid_variances(samples.minor, (mean_weight, tilt_weight), starts, displaced)
    else:
        grid = grid_variances(n, samples.slope[starts], displaced)
    extra = counted.extra_variance[starts] * np.where(kind[starts] == 0, 1.0, displaced)
    # As far as one looked, or farther: no better known than before.
    looked = displacement - counted.shift_px
    reached = np.abs(np.add.reduceat(looked * mean_weight, starts)) > _SATURATED * reach
    edge_px2 = _EDGE_SD_PX**2 + noise.outline_sd_px**2
    rows = []
    for power, weight in enumerate((mean_weight, tilt_weight)):
        H = np.add.reduceat(jacobian * weight[:, None], starts)
        value = np.add.reduceat((displacement - expected) * weight, starts)
        shared = np.add.reduceat(by_offsets * weight[:, None], starts)
        variance = grid[power] + extra * np.add.reduceat(weight**2, starts)
        variance += edge_px2 * n * np.add.reduceat(weight**2, starts)
        # Displaced pixels are few and whole: one is no outlier.
        one = np.maximum.reduceat(np.abs(weight), starts)
        variance = np.maximum(variance, (one / _ONE_PIXEL_SIGMA) ** 2)
        common = np.maximum.reduceat(counted.common_px2, starts)
        if power == 0:
            variance += np.where(reached, doubt_px2, 0.0) + common
        else:
            variance += common * n / np.maximum(spread, 0.5)
        innovation = doubt.variance(H) + variance
        innovation += ((shared * noise.outline_offset_sd_px) ** 2).sum(axis=1)
        kept = np.abs(value) < _RUN_GATE_SIGMA * np.sqrt(innovation)
        if is_rough and power == 0:
            # Among other things returns end raggedly at an edge, which is then known to no more
            # than what it is off by; without it nothing may hold the pose along a face.
            variance, kept = np.where(kept, variance, value**2), np.ones(len(n), dtype=np.bool_)
        kept &= n > power
        picked_rows = (value, variance, H, counted.triangle[starts], shared)
        rows.append(tuple(part[kept] for part in picked_rows))
    value, variance, H, triangles, shared = (
        np.concatenate(part) for part in zip(*rows, strict=True)
    )
    return ContourRuns(value, variance, H, triangles, shared)


def grid_variances(
    n: IntArray, slope: FloatArray, distance_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variances (k,) of the mean (px^2) and the tilt (px^2 per crossing^2) of counts along edges.

    The last pixel inside an edge at crossing i lies ``e_i = frac(c + i s) - 1/2`` off it, a
    sawtooth with autocovariance C(x) = B2(frac x) / 2. The line d away that pixels are counted at
    has the same sawtooth at other phases, so the counts err by ``e_i(c + d) - e_i(c)``, with
    autocovariance ``2 C(x) - C(x + d) - C(x - d)``.

    Args:
        n: (k,) crossings of each edge.
        slope: (k,) s, pixels per crossing.
        distance_px: (k,) d, the mean distance of that line from the edge; at most half a pixel
            counts.
    """
    lag = np.arange(int(n.max()))
    phase = lag * slope[:, None]
    d = np.minimum(distance_px, 0.5)[:, None]
    covariance = 2.0 * _sawtooth(phase) - _sawtooth(phase + d) - _sawtooth(phase - d)
    covariance[:, 1:] *= 2.0
    # How many pairs of crossings lie so far apart, and the sum of the products of their positions.
    pairs = np.maximum(n[:, None] - lag, 0).astype(np.float64)
    c = 0.5 * (n[:, None] - 1.0)
    products = pairs * (pairs - 1.0) * ((2.0 * pairs - 1.0) / 6.0 + 0.5 * lag - c)
    products += pairs * c * (c - lag)
    mean = np.einsum("ij,ij->i", covariance, pairs) / n**2
    tilt = (
        np.einsum("ij,ij->i", covariance, products) / np.maximum(n * (n**2 - 1.0) / 12.0, 0.5) ** 2
    )
    return np.maximum(mean, 0.0), np.maximum(tilt, 0.0)


def _sawtooth(phase: FloatArray) -> FloatArray:
    x = phase - np.floor(phase)
    return np.asarray(0.5 * (x * x - x + 1.0 / 6.0))
