"""Poses of a target from the look of its whole surface: no rectangle, edge or corner is needed.

The target is seen once from directions all over the sphere, without perspective, on a coarse metric
grid: which cells it covers and how deep they lie. A part of a frame is laid out on the same grid,
along its mean ray and at turns in the image plane. How well each view fits at each turn follows
from a few products of matrices (cells that both cover and their difference in depth, cells where
the view shows a surface and the frame sees through it, cells that only the frame covers), so it
costs the same for any mesh. The best are aligned with the surface seen from outside, all at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.camera import pixel_rays, project
from pcnav.core.spatial import exp_rotation
from pcnav.perception.regions import Region
from pcnav.perception.surface_alignment import Surface, aligned
from pcnav.recordings.sequence import Frame
from pcnav.target.mesh import mesh_diameter
from pcnav.target.satellite import Target

_SUBDIVISIONS = 3
"""Of an icosahedron: 642 directions, 8 degrees apart."""
_FIRST_DIRECTIONS = 162
"""Those of one subdivision less come first: 16 degrees apart."""
_CELLS = 26
"""Cells along each side of the grid."""
_SPAN_FRACTION = 1.12
"""Side of the grid over the diameter."""
_TURNS = 30
_FIRST_TURN_STEP = 2
_DEPTH_SD_FRACTION = 0.05
"""Depths that scatter by this share of the diameter about a view's count half."""
_STRAY_WEIGHT = 0.6
_STRAY_WEIGHT_WINDOW = 0.25
"""What a cell that only the frame covers counts against a view; less where the part of the frame
was cut out of a larger object."""
_PADDING = 5
"""Cells about the grid, to shift it by."""
_SHIFTS = tuple(
    sorted(
        ((x, y) for x in range(-4, 5, 2) for y in range(-4, 5, 2)),
        key=lambda s: s[0] ** 2 + s[1] ** 2,
    )
)
"""Where the middle of the target may be beside that of its returns, cells."""
_NEAR_SHIFTS = _SHIFTS[:5]
_SHIFTS_MATCHED = 4
_MAX_CLOUD = 3_000
_SURFACE_POINTS = 6_000
_VIEWS_AT_ONCE = 60
_EDGE_ON = 1e-3
_MIN_COMMON_CELLS = 6
_ENOUGH_SHARE = 0.4
"""Of the cells that a typical view covers, for a part of a frame to count in full."""
_MAX_MATCHES = 60
_MAX_ALIGNED = 12
_SAME_ANGLE_RAD = 0.15
_SAME_SHIFT_FRACTION = 0.08


@dataclass(frozen=True)
class _Templates:
    """Views of a target from n directions on a grid of c cells."""

    R_view_model: FloatArray
    """(n, 3, 3) z along the line of sight."""
    covered: DepthImage
    """(n, c) 1 where the view shows a surface."""
    depth: DepthImage
    """(n, c) of it along the line of sight, m; 0 where there is none."""
    centre: FloatArray
    """(n, 3) view axes: what the grid and its depth are centred on, model origin at zero."""

    def first(self) -> "_Templates":
        """Those of the directions that are wide apart."""
        some = slice(_FIRST_DIRECTIONS)
        return _Templates(
            self.R_view_model[some], self.covered[some], self.depth[some], self.centre[some]
        )


@dataclass(frozen=True)
class SampledViews:
    """All that is sampled of a target, once."""

    diameter_m: float
    templates: _Templates
    surface: Surface


def sample_views(mesh: trimesh.Trimesh) -> SampledViews:
    """The views of a mesh: under a second, whatever its number of faces."""
    diameter = mesh_diameter(mesh)
    middle = np.asarray(mesh.bounds).mean(axis=0)
    directions = np.asarray(trimesh.creation.icosphere(_SUBDIVISIONS).vertices)
    R = np.stack([_looking_along(direction) for direction in directions])
    cell = _SPAN_FRACTION * diameter / _CELLS
    grid = _grid(_CELLS, cell)
    starts = grid @ R[:, :2] + (middle - diameter * R[:, 2])[:, None]
    depth, normal = _first_hits(mesh, starts, R[:, 2])
    hit = np.isfinite(depth)
    n, c = hit.shape
    covered, shown = np.zeros((n, c), np.float32), np.zeros((n, c), np.float32)
    centre = np.zeros((n, 3))
    square = (_CELLS, _CELLS)
    for k in np.flatnonzero(hit.any(axis=1)).tolist():
        # Centred on what is covered, to whole cells, as a part of a frame is.
        whole = np.rint(grid[hit[k]].mean(axis=0) / cell).astype(int)
        mean = float(depth[k, hit[k]].mean())
        covered[k] = _moved(hit[k].reshape(square).astype(float), -whole).ravel()
        relative = np.where(hit[k], depth[k] - mean, 0.0)
        shown[k] = _moved(relative.reshape(square), -whole).ravel()
        centre[k] = R[k] @ middle + [*(whole * cell), mean - diameter]
    view, at = np.nonzero(hit)
    order = np.random.default_rng(0).permutation(len(view))[:_SURFACE_POINTS]
    view, at = view[order], at[order]
    cloud = starts[view, at] + depth[view, at][:, None] * R[view, 2]
    surface = Surface(cloud, normal[view, at], cKDTree(cloud))
    return SampledViews(diameter, _Templates(R, covered, shown, centre), surface)


def _first_hits(
    mesh: trimesh.Trimesh, starts: FloatArray, directions: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(n, c) distance along rays from starts (n, c, 3) in n directions (n, 3), infinite where they
    miss, and (n, c, 3) normal of the face that is hit, against the ray."""
    face_normals, faces = np.asarray(mesh.face_normals), np.asarray(mesh.faces)
    corners = np.asarray(mesh.vertices)[faces[:, 0]]
    distance = np.full(starts.shape[:2], np.inf)
    normal = np.zeros(starts.shape)
    for first in range(0, len(starts), _VIEWS_AT_ONCE):
        some = slice(first, first + _VIEWS_AT_ONCE)
        rays = np.repeat(directions[some], starts.shape[1], axis=0)
        origins = starts[some].reshape(-1, 3)
        face = np.asarray(mesh.ray.intersects_first(origins, rays), dtype=np.intp)
        hit = face >= 0
        met, ray = face[hit], rays[hit]
        across = face_normals[met]
        along = np.einsum("ij,ij->i", across, ray)
        to_corner = corners[met] - origins[hit]
        # A face seen edge-on is as deep as its corner.
        edge_on = np.abs(along) < _EDGE_ON
        gap = np.einsum("ij,ij->i", to_corner, across) / np.where(edge_on, 1.0, along)
        part = np.full(len(face), np.inf)
        part[hit] = np.where(edge_on, np.einsum("ij,ij->i", to_corner, ray), gap)
        distance[some] = part.reshape(distance[some].shape)
        facing = np.zeros((len(face), 3))
        facing[hit] = across * -np.where(along < 0.0, -1.0, 1.0)[:, None]
        normal[some] = facing.reshape(normal[some].shape)
    return distance, normal


def _moved(grid: FloatArray, cells: IntArray) -> FloatArray:
    """A square grid (rows y, columns x) moved by whole cells (x, y); what leaves it is lost."""
    moved = np.zeros_like(grid)
    size = len(grid)
    dx, dy = int(cells[0]), int(cells[1])
    rows = slice(max(dy, 0), size + min(dy, 0)), slice(max(-dy, 0), size + min(-dy, 0))
    columns = slice(max(dx, 0), size + min(dx, 0)), slice(max(-dx, 0), size + min(-dx, 0))
    moved[rows[0], columns[0]] = grid[rows[1], columns[1]]
    return moved


def _looking_along(direction: FloatArray) -> FloatArray:
    """(3, 3) rotation whose third row is a unit direction (3,)."""
    other = np.eye(3)[int(np.argmin(np.abs(direction)))]
    x = np.cross(other, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction])


@dataclass(frozen=True)
class ViewMatch:
    """A pose that a sampled view proposes."""

    T_cam_model: FloatArray
    """(4, 4)"""
    fit: float
    """0 to 1: how well the surfaces lie on one another, a share of the returns."""


class PartLayout:
    """A part of a frame, laid out to be compared with the views of a target."""

    def __init__(self, region: Region, whole: Frame, views: SampledViews) -> None:
        self._views, self._whole = views, whole
        self._cell_m = _SPAN_FRACTION * views.diameter_m / _CELLS
        seen = region.frame.depth_m > 0.0
        self._is_partial = not region.is_whole or _is_cut(seen)
        depth = region.frame.depth_m[seen][:, None].astype(np.float64)
        points = pixel_rays(region.frame.camera)[seen] * depth
        self.cloud: FloatArray = points[:: -(-len(points) // _MAX_CLOUD)]
        # Between the returns of a part nothing is seen through, nor just beside them.
        hidden = ndimage.binary_dilation(seen, np.ones((3, 3), dtype=np.bool_))
        if region.frame.unseen is not None:
            hidden |= region.frame.unseen
        self._free = ~hidden
        """(n, 3) returns, camera frame, m."""
        self._mean = self.cloud.mean(axis=0)
        self._R_ray_cam = _looking_along(self._mean / np.linalg.norm(self._mean))
        self._local = (self.cloud - self._mean) @ self._R_ray_cam.T
        self._stray = _STRAY_WEIGHT_WINDOW if region.is_window else _STRAY_WEIGHT
        self._poses: list[FloatArray] = []
        self._scores: list[FloatArray] = []

    def first_score(self) -> float:
        """0 to 1: how well any view fits, on few directions, turns and shifts."""
        few = _NEAR_SHIFTS if self._is_partial else _NEAR_SHIFTS[:1]
        score = max(self._coarse_score(shift) for shift in few)
        # A patch much smaller than the target fits anywhere on it.
        typical = float(np.median(self._views.templates.covered.sum(axis=1)))
        share = float(self._padded.covered.sum(axis=(1, 2)).max()) / max(typical, 1.0)
        return score * float(min(share / _ENOUGH_SHARE, 1.0) ** 0.5)

    def match(self) -> float:
        """Compare with all views and keep the best; how well that fits.

        Where part of the target may be hidden, its middle is not that of its returns: what few
        views say of all shifts chooses those that all views are compared at.
        """
        shifts: Sequence[tuple[int, int]] = _SHIFTS[:1]
        if self._is_partial:
            scores = np.array([self._coarse_score(shift) for shift in _SHIFTS])
            shifts = [_SHIFTS[k] for k in np.argsort(-scores)[:_SHIFTS_MATCHED].tolist()]
        for shift in shifts:
            layout = self._padded.at(shift, 1, self._cell_m)
            score, offset = _scores(self._views.templates, layout, self._views, self._stray)
            best = np.argpartition(-score.ravel(), _MAX_MATCHES)[:_MAX_MATCHES]
            view, turn = np.unravel_index(best, score.shape)
            self._poses.append(self._poses_of(layout, view, turn, offset[view, turn]))
            self._scores.append(score[view, turn])
        return float(np.concatenate(self._scores).max())

    def _coarse_score(self, shift: tuple[int, int]) -> float:
        layout = self._padded.at(shift, _FIRST_TURN_STEP, self._cell_m)
        templates = self._views.templates.first()
        return float(_scores(templates, layout, self._views, self._stray)[0].max())

    def matches(self, target: Target) -> list[ViewMatch]:
        """Poses near those kept, aligned with the returns, the best fitting first."""
        poses, scores = np.concatenate(self._poses), np.concatenate(self._scores)
        kept = np.argsort(-scores)[:_MAX_MATCHES]
        surface, D = self._views.surface, self._views.diameter_m
        poses, fits = aligned(poses[kept], self.cloud, surface, D, finely=False)
        chosen = distinct(poses, np.argsort(-fits), target, _MAX_ALIGNED)
        poses, fits = aligned(poses[chosen], self.cloud, surface, D, finely=True)
        chosen = distinct(poses, np.argsort(-fits), target, _MAX_ALIGNED)
        return [ViewMatch(poses[k], float(fits[k])) for k in chosen]

    def _poses_of(
        self, layout: "_Layout", view: IntArray, turn: IntArray, offset: FloatArray
    ) -> FloatArray:
        """(k, 4, 4) the pose of each view at its turn and depth."""
        templates = self._views.templates
        R_turned_ray = layout.R_turned_ray[turn]
        R_cam_turned = np.swapaxes(R_turned_ray @ self._R_ray_cam, 1, 2)
        # The centre of the view lies at that of the layout.
        at = np.column_stack([layout.centre[turn], offset]) - templates.centre[view]
        poses = np.tile(np.eye(4), (len(view), 1, 1))
        poses[:, :3, :3] = R_cam_turned @ templates.R_view_model[view]
        poses[:, :3, 3] = np.einsum("kij,kj->ki", R_cam_turned, at) + self._mean
        return poses

    @cached_property
    def _padded(self) -> "_PaddedLayout":
        """The part at all turns, on a grid that is wide enough to be shifted."""
        size = _CELLS + 2 * _PADDING
        # The mean over what is covered, not over returns, which crowd on what faces the sensor.
        occupied = np.unique(np.floor(self._local[:, :2] / self._cell_m).astype(int), axis=0)
        middle = (occupied + 0.5).mean(axis=0) * self._cell_m
        R = _turns()
        n, c = len(R), size**2
        about = np.einsum("tij,nj->tni", R[:, :2, :2], self._local[:, :2] - middle)
        index = np.floor(about / self._cell_m + 0.5 * size).astype(np.intp)
        inside = ((index >= 0) & (index < size)).all(axis=2)
        flat = index[..., 1] * size + index[..., 0] + c * np.arange(n)[:, None]
        z = np.broadcast_to(self._local[:, 2], inside.shape)
        count = np.bincount(flat[inside], minlength=n * c)
        total = np.bincount(flat[inside], z[inside], minlength=n * c)
        centre = R[:, :2, :2] @ middle
        square = (n, size, size)
        covered = (count > 0).reshape(square)
        free = self._seen_through(R, centre, size).reshape(square) & ~covered
        depth = (total / np.maximum(count, 1)).reshape(square)
        return _PaddedLayout(
            R,
            covered.astype(np.float32),
            depth.astype(np.float32),
            free.astype(np.float32),
            centre,
        )

    def _seen_through(self, R: FloatArray, centre: FloatArray, size: int) -> BoolArray:
        """(t, size^2) where the frame sees past the part: space, or something behind it."""
        cells = _grid(size, self._cell_m) + centre[:, None]
        points = np.einsum("tji,tcj->tci", R[:, :2, :2], cells) @ self._R_ray_cam[:2] + self._mean
        camera = self._whole.camera
        in_front = points[..., 2] > 1e-6 * self._views.diameter_m
        points[~in_front] = [0.0, 0.0, 1.0]
        pixel = np.rint(np.clip(project(camera, points), -1e6, 1e6)).astype(np.intp)
        inside = ((pixel >= 0) & (pixel < [camera.width, camera.height])).all(axis=2) & in_front
        pixel = np.clip(pixel, 0, [camera.width - 1, camera.height - 1])
        return np.asarray(inside & self._free[pixel[..., 1], pixel[..., 0]])


@dataclass(frozen=True)
class _PaddedLayout:
    """A part of a frame on a grid of s x s cells (rows y), at t turns."""

    R_turned_ray: FloatArray
    """(t, 3, 3)"""
    covered: DepthImage
    """(t, s, s)"""
    depth: DepthImage
    """(t, s, s) mean in each cell; 0 where not covered."""
    free: DepthImage
    """(t, s, s) 1 where the frame sees past the part."""
    centre: FloatArray
    """(t, 2) of the grid, turned ray axes, m."""

    def at(self, shift: tuple[int, int], turn_step: int, cell_m: float) -> "_Layout":
        """Its inner part about a middle shifted by whole cells (x, y), at every so many turns."""
        x, y = _PADDING + shift[0], _PADDING + shift[1]
        part = (slice(None, None, turn_step), slice(y, y + _CELLS), slice(x, x + _CELLS))
        covered, depth, free = (
            grid[part].reshape(-1, _CELLS**2) for grid in (self.covered, self.depth, self.free)
        )
        centre = self.centre[::turn_step] + np.array(shift) * cell_m
        return _Layout(self.R_turned_ray[::turn_step], covered, depth, free, centre)


@dataclass(frozen=True)
class _Layout:
    """A part of a frame on the grid of c cells, at t turns."""

    R_turned_ray: FloatArray
    """(t, 3, 3)"""
    covered: DepthImage
    """(t, c)"""
    depth: DepthImage
    """(t, c) mean in each cell; 0 where not covered."""
    free: DepthImage
    """(t, c) 1 where the frame sees past the part."""
    centre: FloatArray
    """(t, 2) of the grid, turned ray axes, m."""


@lru_cache(maxsize=1)
def _turns() -> FloatArray:
    """(t, 3, 3) turns about the line of sight."""
    angles = 2.0 * np.pi * np.arange(_TURNS) / _TURNS
    return np.stack([exp_rotation(np.array([0.0, 0.0, angle])) for angle in angles])


def _grid(size: int, cell_m: float) -> FloatArray:
    """(size^2, 2) middles of the cells of a square grid about zero, m, row after row."""
    axis = (np.arange(size) + 0.5 - 0.5 * size) * cell_m
    x, y = np.meshgrid(axis, axis)
    return np.column_stack([x.ravel(), y.ravel()])


def _is_cut(seen: BoolArray) -> bool:
    """Whether returns (height, width) reach the border of the image."""
    return bool(seen[[0, -1]].any() or seen[:, [0, -1]].any())


def _scores(
    templates: _Templates, layout: _Layout, views: SampledViews, stray: float
) -> tuple[FloatArray, FloatArray]:
    """(n, t) how well each view fits at each turn, 0 to 1, and (n, t) the depth it fits at."""
    T, t = templates.covered, templates.depth
    F, d = layout.covered, layout.depth
    both = T @ F.T
    enough = np.maximum(both, 1.0)
    first = (T @ d.T - t @ F.T) / enough
    second = (T @ (d * d).T - 2.0 * (t @ d.T) + (t * t) @ F.T) / enough
    variance = np.maximum(second - first**2, 0.0)
    agree = both / (1.0 + variance / (_DEPTH_SD_FRACTION * views.diameter_m) ** 2)
    through = T @ layout.free.T
    only_frame = F.sum(axis=1)[None, :] - both
    score = agree / (both + through + stray * only_frame + 1e-6)
    score[both < _MIN_COMMON_CELLS] = 0.0
    return score, first


def distinct(poses: FloatArray, order: IntArray, target: Target, most: int) -> list[int]:
    """Which of poses (k, 4, 4), taken in an order, no earlier one is equal to, up to the target's
    symmetry; at most so many."""
    kept: list[int] = []
    inverse = np.linalg.inv(poses)
    for k in order.tolist():
        if len(kept) == most:
            break
        # One pose is another if what takes it there is nearly a symmetry.
        between = inverse[kept] @ poses[k] if kept else np.empty((0, 4, 4))
        if not _nearly_symmetric(between, target):
            kept.append(k)
    return kept


def _nearly_symmetric(motions: FloatArray, target: Target) -> bool:
    group = target.symmetry_transforms
    cosine = np.einsum("kij,gij->kg", motions[:, :3, :3], group[:, :3, :3])
    turned = 0.5 * (cosine - 1.0) > np.cos(_SAME_ANGLE_RAD)
    # What a motion does to the middle of the target, not to a far-off origin.
    middle = np.asarray(target.mesh.bounds).mean(axis=0)
    moved = motions[:, :3, :3] @ middle + motions[:, :3, 3]
    mapped = group[:, :3, :3] @ middle + group[:, :3, 3]
    apart = np.linalg.norm(moved[:, None] - mapped[None], axis=2)
    return bool(np.any(turned & (apart < _SAME_SHIFT_FRACTION * target.diameter_m)))
