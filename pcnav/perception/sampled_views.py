"""Poses of a target from the look of its whole surface: no rectangle, edge or corner is needed.

The target is seen once from directions all over the sphere, without perspective, on a coarse metric
grid: which cells it covers and how deep they lie. A part of a frame is laid out on the same grid,
along its mean ray and at turns in the image plane. How well each view fits at each turn follows
from a few products of matrices (cells that both cover and their difference in depth, cells where
the view shows a surface and the frame sees through it, cells that only the frame covers), so it
costs the same for any mesh. The best are aligned with the surface seen from outside, all at once.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import project
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.surface_alignment import Surface, aligned
from pcnav.recordings.sequence import Frame
from pcnav.target.mesh import mesh_diameter
from pcnav.target.satellite import Target

_SUBDIVISIONS = 3
"""Of an icosahedron: 642 directions, 8 degrees apart."""
_CELLS = 28
"""Cells along each side of the grid."""
_SPAN_FRACTION = 1.12
"""Side of the grid over the diameter."""
_TURNS = 36
_DEPTH_SD_FRACTION = 0.04
"""Depths that scatter by this share of the diameter about a view's count half."""
_STRAY_WEIGHT = 0.6
_STRAY_WEIGHT_WINDOW = 0.25
"""What a cell that only the frame covers counts against a view; less where the part of the frame
was cut out of a larger object."""
_SHIFTS = ((0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1))
"""Where the middle of the target may be beside that of its returns, over the diameter."""
_MAX_CLOUD = 3_000
_SURFACE_POINTS = 6_000
_HIDDEN = 2
_FREE = 1
_MIN_COMMON_CELLS = 6
_MAX_MATCHES = 60
_MATCHES_ALIGNED = 24


@dataclass(frozen=True)
class _Templates:
    """Views of a target from n directions on a grid of c cells."""

    R_view_model: FloatArray
    """(n, 3, 3) z along the line of sight."""
    covered: FloatArray
    """(n, c) 1 where the view shows a surface."""
    depth: FloatArray
    """(n, c) of it along the line of sight, m; 0 where there is none."""
    centre: FloatArray
    """(n, 3) view axes: what the grid and its depth are centred on, model origin at zero."""


@dataclass(frozen=True)
class SampledViews:
    """All that is sampled of a target, once."""

    diameter_m: float
    templates: _Templates
    surface: Surface


@lru_cache(maxsize=4)
def _views_of(key: tuple[int, int], mesh: "_Keyed") -> SampledViews:
    return _sample(mesh.mesh)


@dataclass(frozen=True)
class _Keyed:
    """A mesh as a key of a cache: the same object is the same mesh."""

    mesh: trimesh.Trimesh

    def __hash__(self) -> int:
        return id(self.mesh)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Keyed) and other.mesh is self.mesh


def sampled_views(target: Target) -> SampledViews:
    """The views of a target; sampled when first asked for, then kept."""
    return _views_of((len(target.mesh.vertices), len(target.mesh.faces)), _Keyed(target.mesh))


def _sample(mesh: trimesh.Trimesh) -> SampledViews:
    diameter = mesh_diameter(mesh)
    middle = np.asarray(mesh.bounds).mean(axis=0)
    directions = np.asarray(trimesh.creation.icosphere(_SUBDIVISIONS).vertices)
    R = np.stack([_looking_along(direction) for direction in directions])
    side = _SPAN_FRACTION * diameter
    axis = ((np.arange(_CELLS) + 0.5) / _CELLS - 0.5) * side
    gx, gy = (grid.ravel() for grid in np.meshgrid(axis, axis))
    n, c = len(R), len(gx)
    covered, depth = np.zeros((n, c)), np.zeros((n, c))
    centre = np.zeros((n, 3))
    clouds, normals = [], []
    for k in range(n):
        start = middle + np.column_stack([gx, gy, np.full(c, -diameter)]) @ R[k]
        hit_depth, face = _first_hits(mesh, start, R[k][2])
        hit = face >= 0
        if not hit.any():
            continue
        # Centred on what is covered, to whole cells, as the frame is.
        shift = np.array([gx[hit].mean(), gy[hit].mean()])
        whole = np.rint(shift / (side / _CELLS)).astype(int)
        z = hit_depth - diameter
        mean = float(z[hit].mean())
        shown = np.where(hit, z - mean, 0.0).reshape(_CELLS, _CELLS)
        covered[k] = _moved(hit.reshape(_CELLS, _CELLS).astype(float), -whole).ravel()
        depth[k] = _moved(shown, -whole).ravel()
        centre[k] = R[k] @ middle + [*(whole * side / _CELLS), mean]
        points = start[hit] + hit_depth[hit][:, None] * R[k][2]
        facing = np.asarray(mesh.face_normals)[face[hit]]
        facing = facing * -np.sign(facing @ R[k][2])[:, None]
        every = slice(k % 5, None, 5)
        clouds.append(points[every])
        normals.append(facing[every])
    cloud, normal = np.concatenate(clouds), np.concatenate(normals)
    chosen = np.random.default_rng(0).permutation(len(cloud))[:_SURFACE_POINTS]
    surface = Surface(cloud[chosen], normal[chosen], cKDTree(cloud[chosen]))
    return SampledViews(diameter, _Templates(R, covered, depth, centre), surface)


def _first_hits(
    mesh: trimesh.Trimesh, starts: FloatArray, direction: FloatArray
) -> tuple[FloatArray, IntArray]:
    """(n,) distance to the first face along parallel rays, and (n,) the face, -1 for none."""
    directions = np.broadcast_to(direction, starts.shape)
    face = np.asarray(mesh.ray.intersects_first(starts, directions), dtype=np.intp)
    hit = face >= 0
    normal = np.asarray(mesh.face_normals)[face[hit]]
    corner = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[face[hit], 0]]
    along = normal @ direction
    flat = np.abs(along) < 1e-3
    distance = np.zeros(len(starts))
    gap = np.einsum("ij,ij->i", corner - starts[hit], normal) / np.where(flat, 1.0, along)
    # A face seen edge-on is as deep as its corner.
    distance[hit] = np.where(flat, (corner - starts[hit]) @ direction, gap)
    return distance, face


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


def view_matches(
    frame: Frame, whole: Frame, views: SampledViews, *, is_window: bool, is_partial: bool
) -> list[ViewMatch]:
    """Poses that sampled views propose for a part of a frame, the best fitting first.

    Args:
        frame: the part, `pcnav.perception.regions.Region`.
        whole: the frame it is a part of.
        views: of the target.
        is_window: whether the part may hold other things beside the target.
        is_partial: whether part of the target may be hidden or lost.
    """
    cloud = _cloud(frame)
    if len(cloud) < _MIN_COMMON_CELLS:
        return []
    D = views.diameter_m
    mean = cloud.mean(axis=0)
    R_ray_cam = _looking_along(mean / np.linalg.norm(mean))
    local = (cloud - mean) @ R_ray_cam.T
    shifts = _SHIFTS if is_partial or is_window else _SHIFTS[:1]
    stray = _STRAY_WEIGHT_WINDOW if is_window else _STRAY_WEIGHT
    poses, scores = [], []
    for shift in shifts:
        layout = _laid_out(local, D, np.array(shift) * D)
        if layout is None:
            continue
        free = _seen_through(layout, whole, frame, mean, R_ray_cam, D)
        score, offset = _scores(views.templates, layout, free, D, stray)
        best = np.argpartition(-score.ravel(), _MAX_MATCHES)[:_MAX_MATCHES]
        for view, turn in np.column_stack(np.unravel_index(best, score.shape)).tolist():
            R_turn = _turn(turn)
            R_cam_model = R_ray_cam.T @ R_turn.T @ views.templates.R_view_model[view]
            at = np.array([*layout.centre[turn], float(offset[view, turn])])
            # The centre of the view lies at that of the layout.
            p = R_ray_cam.T @ R_turn.T @ (at - views.templates.centre[view]) + mean
            poses.append(make_transform(R_cam_model, p))
            scores.append(float(score[view, turn]))
    order = np.argsort(-np.array(scores))[: _MAX_MATCHES if len(shifts) == 1 else 2 * _MAX_MATCHES]
    coarse = np.stack([poses[k] for k in order.tolist()])
    found, fits = aligned(coarse, cloud, views.surface, D)
    best_first = np.argsort(-fits)
    return [ViewMatch(found[k], float(fits[k])) for k in best_first.tolist()]


def _cloud(frame: Frame) -> FloatArray:
    """(n, 3) returns of a frame, at most a few thousand of them."""
    from pcnav.core.camera import pixel_rays

    seen = frame.depth_m > 0.0
    points = pixel_rays(frame.camera)[seen] * frame.depth_m[seen][:, None].astype(np.float64)
    return np.asarray(points[:: -(-len(points) // _MAX_CLOUD)] if len(points) else points)


def _turn(k: int) -> FloatArray:
    return exp_rotation(np.array([0.0, 0.0, 2.0 * np.pi * k / _TURNS]))


@dataclass(frozen=True)
class _Layout:
    """A part of a frame on the grid, at t turns."""

    covered: FloatArray
    """(t, c)"""
    depth: FloatArray
    """(t, c) mean in each cell; 0 where not covered."""
    centre: FloatArray
    """(t, 2) of the grid, turned ray axes, m."""


def _laid_out(local: FloatArray, diameter_m: float, shift_m: FloatArray) -> _Layout | None:
    side = _SPAN_FRACTION * diameter_m
    cell = side / _CELLS
    # The mean over what is covered, not over returns, which crowd on what faces the sensor.
    occupied = np.unique(np.floor(local[:, :2] / cell).astype(int), axis=0)
    middle = (occupied + 0.5).mean(axis=0) * cell + shift_m
    about = local[:, :2] - middle
    covered = np.zeros((_TURNS, _CELLS**2))
    depth = np.zeros_like(covered)
    centre = np.zeros((_TURNS, 2))
    for k in range(_TURNS):
        R = _turn(k)[:2, :2]
        centre[k] = R @ middle
        index = np.floor((about @ R.T) / cell + 0.5 * _CELLS).astype(int)
        inside = ((index >= 0) & (index < _CELLS)).all(axis=1)
        flat = index[inside, 1] * _CELLS + index[inside, 0]
        count = np.bincount(flat, minlength=_CELLS**2)
        total = np.bincount(flat, local[inside, 2], minlength=_CELLS**2)
        covered[k] = count > 0
        depth[k] = total / np.maximum(count, 1)
    if covered.sum(axis=1).max() < _MIN_COMMON_CELLS:
        return None
    return _Layout(covered, depth, centre)


def _seen_through(
    layout: _Layout,
    whole: Frame,
    part: Frame,
    mean: FloatArray,
    R_ray_cam: FloatArray,
    diameter_m: float,
) -> FloatArray:
    """(t, c) 1 where the frame sees past the part's own depth: space, or something behind it."""
    side = _SPAN_FRACTION * diameter_m
    axis = ((np.arange(_CELLS) + 0.5) / _CELLS - 0.5) * side
    gx, gy = (grid.ravel() for grid in np.meshgrid(axis, axis))
    camera = whole.camera
    free = np.zeros_like(layout.covered)
    for k in range(_TURNS):
        xy = (np.column_stack([gx, gy]) + layout.centre[k]) @ _turn(k)[:2, :2]
        points = np.column_stack([xy, np.zeros(len(xy))]) @ R_ray_cam + mean
        pixel = np.rint(project(camera, points)).astype(int)
        inside = ((pixel >= 0) & (pixel < [camera.width, camera.height])).all(axis=1)
        u, v = np.clip(pixel, 0, [camera.width - 1, camera.height - 1]).T
        hidden = part.unseen[v, u] if part.unseen is not None else np.zeros(len(u), dtype=bool)
        free[k] = inside & ~hidden & (layout.covered[k] == 0.0)
    return free


def _scores(
    templates: _Templates, layout: _Layout, free: FloatArray, diameter_m: float, stray: float
) -> tuple[FloatArray, FloatArray]:
    """(n, t) how well each view fits at each turn, 0 to 1, and (n, t) the depth it fits at."""
    T, t = templates.covered.astype(np.float32), templates.depth.astype(np.float32)
    F = layout.covered.astype(np.float32)
    d = (layout.depth * layout.covered).astype(np.float32)
    both = T @ F.T
    enough = np.maximum(both, 1.0)
    first = (T @ d.T - t @ F.T) / enough
    second = (T @ (d * d).T - 2.0 * (t @ d.T) + (t * t) @ F.T) / enough
    variance = np.maximum(second - first**2, 0.0)
    agree = both / (1.0 + variance / (_DEPTH_SD_FRACTION * diameter_m) ** 2)
    through = T @ free.astype(np.float32).T
    only_frame = F.sum(axis=1)[None, :] - both
    score = agree / (both + through + stray * only_frame + 1e-6)
    score[both < _MIN_COMMON_CELLS] = 0.0
    return score, first
