"""Pixels that integrate over their area: whether one returns, and what, by what covers it.

Only pixels with an edge in them are sampled by more than the ray through their centre: away from
edges a surface is flat within a pixel, whose mean is its centre.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from pcnav.config.sensors import Footprint, NoiseTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, project, rays_through
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.simulation.surroundings.view import SceneRenderer, SceneView
from pcnav.target.mesh import SHARP_EDGE_RAD
from pcnav.target.rendering import DepthRenderer, RenderedDepth

_STEP_PX = 0.25
"""Between the points of an edge by which the pixels it passes through are found."""
_SLOPE = 4.0
"""Depth over width of the steepest surface that is still one: about 76 degrees."""


@dataclass(frozen=True)
class Body:
    """A mesh of the scene and what is needed to find its edges."""

    renderer: DepthRenderer
    vertices: FloatArray
    normals: FloatArray
    always: IntArray
    """(k, 2) vertices of edges that may be seen from anywhere: sharp ones, and open ones."""
    smooth: IntArray
    """(k, 2) vertices of edges that are an outline from where one of their faces is hidden."""
    beside: IntArray
    """(k, 2) faces of these."""

    @staticmethod
    def of(mesh: trimesh.Trimesh, renderer: DepthRenderer) -> "Body":
        """Of a mesh and its renderer."""
        sharp = np.asarray(mesh.face_adjacency_angles) > SHARP_EDGE_RAD
        shared = np.asarray(mesh.face_adjacency_edges)
        edges, count = np.unique(np.asarray(mesh.edges_sorted), axis=0, return_counts=True)
        return Body(
            renderer,
            np.asarray(mesh.vertices, dtype=np.float64),
            np.asarray(mesh.face_normals),
            np.vstack([shared[sharp], edges[count != 2]]),
            shared[~sharp],
            np.asarray(mesh.face_adjacency)[~sharp],
        )

    def edges_cam(self, T_cam_body: FloatArray) -> FloatArray:
        """(n, 2, 3) ends of all edges at which depth may jump or bend, camera frame."""
        eye = invert_transform(T_cam_body)[:3, 3]
        to_eye = eye - self.vertices[self.smooth[:, 0]]
        facing = np.einsum("nkj,nj->nk", self.normals[self.beside], to_eye) > 0.0
        outline = self.smooth[facing[:, 0] != facing[:, 1]]
        ends = np.vstack([self.always, outline])
        return np.asarray(transform_points(T_cam_body, self.vertices)[ends])


@dataclass(frozen=True)
class _Samples:
    """What the rays of some pixels meet."""

    depth_m: FloatArray
    """(n, rays) z-depth, inf for nothing."""
    face: IntArray
    """(n, rays) -1 for nothing."""
    part: IntArray
    """(n, rays) -1 for nothing."""


class FootprintSampler:
    """Gives the views of a scene their pixels' areas."""

    def __init__(self, renderer: SceneRenderer, noise: NoiseTable) -> None:
        self._noise, self._bodies = noise, list[Body]()
        if noise.footprint is not Footprint.CENTRE_RAY:
            pairs = zip(renderer.meshes, renderer.renderers, strict=True)
            self._bodies = [Body.of(*pair) for pair in pairs]

    def sampled(self, view: SceneView, poses: Sequence[FloatArray]) -> SceneView:
        """A clean view with its pixels' areas; the view itself where a pixel is its centre.

        ``poses`` (4, 4) are those of the scene's bodies; nan of one that is not there.
        """
        return with_footprint(view, self._bodies, poses, self._noise) if self._bodies else view


def with_footprint(
    view: SceneView, bodies: Sequence[Body], poses: Sequence[FloatArray], noise: NoiseTable
) -> SceneView:
    """See `FootprintSampler.sampled`."""
    camera = view.seen.camera
    there = [k for k, T in enumerate(poses) if np.isfinite(T).all()]
    edged = np.zeros(view.part.shape, dtype=np.bool_)
    for k in there:
        edged |= pixels_on_edges(camera, bodies[k].edges_cam(poses[k]))
    rows, columns = np.nonzero(edged)
    if not rows.size:
        return view
    rays = _rays_within(camera, rows, columns, noise.footprint_rays)
    found: list[_Samples] = []
    first_face = 0
    for k in there:
        depth, face = bodies[k].renderer.cast(rays.reshape(-1, 3), poses[k])
        hit = face >= 0
        samples = np.where(hit, depth, np.inf), np.where(hit, face + first_face, -1)
        each = (*samples, np.where(hit, k, -1))
        found.append(_Samples(*(array.reshape(rays.shape[:2]) for array in each)))
        first_face += len(bodies[k].normals)
    nearest = found[0]
    for other in found[1:]:
        nearer = other.depth_m < nearest.depth_m
        nearest = _Samples(
            np.where(nearer, other.depth_m, nearest.depth_m),
            np.where(nearer, other.face, nearest.face),
            np.where(nearer, other.part, nearest.part),
        )
    step = 1.0 / min(camera.fx, camera.fy)
    seen, part = _covered(view.seen, view.part, (rows, columns), nearest, noise, step)
    alone = np.where(view.target.triangle >= 0, 0, -1)
    target, _ = _covered(view.target, alone, (rows, columns), found[0], noise, step)
    return SceneView(seen, target, part)


def with_samples(
    view: SceneView, samples: Sequence[SceneView], noise: NoiseTable, width_rad: float
) -> SceneView:
    """A clean view of beams that are so wide, from views along rays that share each beam evenly.

    Beams all of whose rays see one face keep what their middle sees.
    """
    found = _of_views([each.seen for each in samples], [each.part for each in samples])
    alone = [np.where(each.target.triangle >= 0, 0, -1) for each in samples]
    of_target = _of_views([each.target for each in samples], alone)
    edged = (found.face != found.face[..., :1]).any(axis=-1)
    edged |= (of_target.face != of_target.face[..., :1]).any(axis=-1)
    if not edged.any():
        return view
    rows, columns = np.nonzero(edged)
    pixels = rows, columns
    found, of_target = (
        _Samples(s.depth_m[pixels], s.face[pixels], s.part[pixels]) for s in (found, of_target)
    )
    seen, part = _covered(view.seen, view.part, pixels, found, noise, width_rad)
    own = np.where(view.target.triangle >= 0, 0, -1)
    target, _ = _covered(view.target, own, pixels, of_target, noise, width_rad)
    return SceneView(seen, target, part)


def _of_views(rendered: Sequence[RenderedDepth], parts: Sequence[IntArray]) -> _Samples:
    """What rays meet that each are a view's, with the views along the last axis."""
    depth = np.stack([each.depth_m for each in rendered], axis=-1).astype(np.float64)
    face = np.stack([each.triangle for each in rendered], axis=-1)
    depth = np.where(face >= 0, depth, np.inf)
    return _Samples(depth, face, np.stack(parts, axis=-1))


def pixels_on_edges(camera: PinholeCamera, edges_cam: FloatArray) -> BoolArray:
    """(height, width) the pixels that edges (n, 2, 3) pass through; parts behind the camera are
    left out."""
    marked = np.zeros((camera.height, camera.width), dtype=np.bool_)
    start, end = edges_cam[:, 0], edges_cam[:, 1]
    near = 1e-6 + 1e-3 * float(np.abs(edges_cam[..., 2]).max(initial=0.0))
    start, end = _before(start, end, near)
    if not len(start):
        return marked
    length = np.linalg.norm(project(camera, end) - project(camera, start), axis=1)
    diagonal = float(np.hypot(camera.width, camera.height))
    # Of an edge that reaches far out of the image, the part in it may be short: be generous.
    count = np.ceil(np.minimum(length, 20.0 * diagonal) / _STEP_PX).astype(int) + 2
    edge = np.repeat(np.arange(len(count)), count)
    along = np.arange(len(edge)) - np.repeat(np.cumsum(count) - count, count)
    share = along / (count[edge] - 1)
    # Even steps in the image are even in inverse depth.
    z0, z1 = start[edge, 2], end[edge, 2]
    share = (share * z0 / (z1 + share * (z0 - z1)))[:, None]
    pixels = project(camera, start[edge] + share * (end - start)[edge])
    for du in (-0.2, 0.2):
        for dv in (-0.2, 0.2):
            u, v = np.rint(pixels[:, 0] + du), np.rint(pixels[:, 1] + dv)
            inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
            marked[v[inside].astype(int), u[inside].astype(int)] = True
    return marked


def _before(start: FloatArray, end: FloatArray, near_m: float) -> tuple[FloatArray, FloatArray]:
    """Segments (n, 3) cut where they pass behind a plane before the camera."""
    kept = (start[:, 2] > near_m) | (end[:, 2] > near_m)
    start, end = start[kept].copy(), end[kept].copy()
    for a, b in ((start, end), (end, start)):
        behind = a[:, 2] < near_m
        share = (near_m - a[behind, 2]) / (b[behind, 2] - a[behind, 2])
        a[behind] += share[:, None] * (b[behind] - a[behind])
    return start, end


def _rays_within(camera: PinholeCamera, rows: IntArray, columns: IntArray, side: int) -> FloatArray:
    """(n, side^2, 3) rays through the middles of the equal parts of pixels."""
    offset = (np.arange(side) + 0.5) / side - 0.5
    dv, du = (grid.ravel() for grid in np.meshgrid(offset, offset, indexing="ij"))
    pixels = np.stack([columns[:, None] + du, rows[:, None] + dv], axis=-1)
    return rays_through(camera, pixels)


def _covered(
    rendered: RenderedDepth,
    part: IntArray,
    pixels: tuple[IntArray, IntArray],
    samples: _Samples,
    noise: NoiseTable,
    step: float,
) -> tuple[RenderedDepth, IntArray]:
    """With what some pixels return by their samples: the nearest surface that covers enough of
    them, or the mean over all surfaces where those together do.

    Surfaces are told apart by gaps in depth that no slope within a pixel explains.
    """
    order = np.argsort(samples.depth_m, axis=1)
    depth = np.take_along_axis(samples.depth_m, order, axis=1)
    hit = np.isfinite(depth)
    total, rays = hit.sum(axis=1), depth.shape[1]
    enough = np.maximum(noise.footprint.threshold * rays, 1.0)
    with np.errstate(invalid="ignore"):
        gap = np.diff(depth, axis=1) > _SLOPE * step * depth[:, :-1]
    surface = np.concatenate([np.zeros((len(depth), 1), int), np.cumsum(gap, axis=1)], axis=1)
    chosen = _chosen_surface(surface, hit, enough)
    returns = (chosen >= 0) if not noise.footprint_mixes else total >= enough
    own = hit & (surface == chosen[:, None])
    averaged = hit if noise.footprint_mixes else own
    count = np.maximum(averaged.sum(axis=1), 1)
    mean = np.where(averaged, depth, 0.0).sum(axis=1) / count
    # What it is told to be seen is the middle ray of the surface.
    among = own if not noise.footprint_mixes else averaged
    middle = np.argmax(np.cumsum(among, axis=1) * 2 >= among.sum(axis=1)[:, None], axis=1)
    index = order[np.arange(len(order)), middle]
    face = samples.face[np.arange(len(order)), index]
    number = samples.part[np.arange(len(order)), index]
    depth_m, triangle, part = rendered.depth_m.copy(), rendered.triangle.copy(), part.copy()
    depth_m[pixels] = np.where(returns, mean, 0.0)
    triangle[pixels] = np.where(returns, face, -1)
    part[pixels] = np.where(returns, number, -1)
    return replace(rendered, depth_m=depth_m, triangle=triangle), part


def _chosen_surface(surface: IntArray, hit: BoolArray, enough: float) -> IntArray:
    """(n,) the nearest surface that covers enough of a pixel, -1 for none."""
    chosen = np.full(len(surface), -1)
    for number in range(int(surface.max(initial=0)) + 1):
        covers = (hit & (surface == number)).sum(axis=1) >= enough
        chosen = np.where((chosen < 0) & covers, number, chosen)
    return chosen
