"""Clean depth images of a mesh by ray casting, exact to the facet."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, HalfspaceIntersection, QhullError

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays, project, range_per_depth
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.target.bent_window import seeing_pixels
from pcnav.target.mesh import half_space_directions
from pcnav.target.row_motion import Exposure, MovingPlanes

Window = tuple[slice, slice]

_MANY_FACES = 4_000
"""Of more faces the planes are worked out only where pixels show them."""
_MAX_OUTER, _OUTER_PLANES = 1_500, 500
_FEW_PIXELS = 6_000
"""Of a window, whose rays are cast in less time than it takes to find which of them pass by."""
_START_FRACTION = 0.999
"""Rays start at this share of the nearest vertex's depth, so that no facet is skipped."""
_JUMP_TOLERANCE = 1e-6
"""A gap in inverse depth smaller than this share of it is rounding, not a depth edge."""


@dataclass(frozen=True)
class RenderedDepth:
    """A depth image without any sensor fault, and what each pixel shows."""

    camera: PinholeCamera
    depth_m: DepthImage
    """(height, width) z-depth, m; 0 where the ray hits nothing."""
    triangle: IntArray
    """(height, width) face of the mesh seen at the pixel; -1 where the ray hits nothing."""
    window: Window
    """Rows and columns outside which there is no return."""
    inverse_depth_planes: FloatArray
    """(n_faces, 3) m with ``1 / z = m . ray`` for a ray (z = 1) that meets the face's plane; of a
    mesh of very many faces zero for those that no pixel shows."""
    moving: MovingPlanes | None = None
    """The same pixel by pixel, where the target moves while they are exposed."""
    own_rays: FloatArray | None = None
    """(height, width, 3) of pixels that look elsewhere than through their centres."""

    @property
    def rays(self) -> FloatArray:
        """(height, width, 3) that the pixels look along, z = 1."""
        return pixel_rays(self.camera) if self.own_rays is None else self.own_rays

    @property
    def range_per_depth(self) -> FloatArray:
        """(height, width) range along the rays divided by z-depth."""
        if self.own_rays is None:
            return range_per_depth(self.camera)
        return np.asarray(np.linalg.norm(self.own_rays, axis=-1))

    def planes_at(self, triangle: IntArray, pixels: tuple[IntArray, IntArray]) -> FloatArray:
        """(k, 3) m of faces (k,) as pixels see them: rows (k,) and columns (k,)."""
        if self.moving is None:
            return np.asarray(self.inverse_depth_planes[triangle])
        return self.moving.at(triangle, self.moving.exposure.index[pixels])

    def without(self, pixels: BoolArray | None) -> "RenderedDepth":
        """The same with nothing shown at pixels (height, width); None for no pixel."""
        if pixels is None:
            return self
        depth_m = np.where(pixels, np.float32(0.0), self.depth_m)
        return replace(self, depth_m=depth_m, triangle=np.where(pixels, -1, self.triangle))


class DepthRenderer:
    """Renders one mesh from any pose; the ray-casting scene is built once.

    Rays are carried into the model frame, so the mesh never moves.
    """

    def __init__(self, mesh: trimesh.Trimesh, camera: PinholeCamera) -> None:
        self._camera = camera
        self._vertices = np.array(mesh.vertices, dtype=np.float64)
        self._outer_vertices = _outer(self._vertices)
        self._first_vertices = np.array(mesh.triangles[:, 0], dtype=np.float64)
        self._normals = np.array(mesh.face_normals, dtype=np.float64)
        self._offsets = np.einsum("ij,ij->i", self._normals, self._first_vertices)
        self._face_vertices = np.array(mesh.faces, dtype=np.intp)
        # Embree where it is installed, else trimesh's own slow search.
        self._scene = mesh.ray

    def render(self, T_cam_model: FloatArray, exposure: Exposure | None = None) -> RenderedDepth:
        """Depth image of the mesh at a pose. (4, 4), metres.

        Each pixel sees it as ``exposure`` has it, where that is given.
        """
        camera = self._camera
        outer_cam = transform_points(T_cam_model, self._outer_vertices)
        depth_m = np.zeros((camera.height, camera.width), dtype=np.float32)
        triangle = np.full((camera.height, camera.width), -1, dtype=np.intp)
        moving, poses, outer = None, T_cam_model[None], outer_cam
        own_rays = None if exposure is None else exposure.rays
        pixel_ray = pixel_rays(camera) if own_rays is None else own_rays
        if exposure is not None:
            moving = MovingPlanes(self._normals, self._offsets, exposure)
            poses = np.stack([T_cam_model, exposure.poses[0], exposure.poses[-1]])
            # The vertices move along lines that are as good as straight.
            outer = np.vstack([transform_points(T, self._outer_vertices) for T in poses])
        window, seeing = self._pixels(outer)
        if exposure is not None and exposure.is_scattered:
            window, seeing = (slice(0, camera.height), slice(0, camera.width)), depth_m == 0.0
        # Places in the flat image: NumPy picks by them in a fraction of the time of a mask.
        rows, columns = np.nonzero(seeing)
        place = (rows + window[0].start) * camera.width + (columns + window[1].start)
        rays = pixel_ray.reshape(-1, 3)[place]
        faces = np.empty(0, dtype=np.intp)
        if len(rays) > 0:
            nearest_z = float(outer[:, 2].min())
            if exposure is None:
                faces = self._first_faces(rays, T_cam_model, nearest_z)
            else:
                index = exposure.index.ravel()[place]
                faces = self._first_faces_moving(rays, exposure.poses[index], nearest_z)
        hit = np.flatnonzero(faces >= 0)
        place, rays, faces = place[hit], rays[hit], faces[hit]
        planes = self._inverse_depth_planes(T_cam_model, faces)
        if len(rays) > 0:
            m = planes[faces] if moving is None else moving.at(faces, index[hit])
            depth_m.reshape(-1)[place] = self._depths(rays, faces, m, poses)
            triangle.reshape(-1)[place] = faces
        return RenderedDepth(camera, depth_m, triangle, window, planes, moving, own_rays)

    def cast(self, rays_cam: FloatArray, T_cam_model: FloatArray) -> tuple[FloatArray, IntArray]:
        """z-depth (n,), m, and face (n,) that rays (n, 3), z = 1, meet first; 0 and -1 for none."""
        outer_z = transform_points(T_cam_model, self._outer_vertices)[:, 2]
        depth = np.zeros(len(rays_cam))
        if outer_z.max() <= 0.0 or not len(rays_cam):
            return depth, np.full(len(rays_cam), -1, dtype=np.intp)
        faces = self._first_faces(rays_cam, T_cam_model, float(outer_z.min()))
        hit = faces >= 0
        m = self._inverse_depth_planes(T_cam_model, faces[hit])[faces[hit]]
        depth[hit] = self._depths(rays_cam[hit], faces[hit], m, T_cam_model[None])
        return depth, faces

    def _pixels(self, vertices_cam: FloatArray) -> tuple[Window, BoolArray]:
        """The window of the mesh, and which of its pixels (height, width) may see the mesh."""
        if self._camera.distortion is not None:
            rows, columns, seeing = seeing_pixels(self._camera, vertices_cam)
            return (rows, columns), seeing
        window = self._window(vertices_cam)
        return window, self._outlined(vertices_cam, window)

    def _window(self, vertices_cam: FloatArray) -> Window:
        """Rows and columns that hold the projected vertices, and with them the mesh."""
        height, width = self._camera.height, self._camera.width
        if vertices_cam[:, 2].max() <= 0.0:
            return slice(0, 0), slice(0, 0)
        if vertices_cam[:, 2].min() <= 0.0:
            # Part of the mesh is behind the camera: its projection is unbounded.
            return slice(0, height), slice(0, width)
        pixels = project(self._camera, vertices_cam)
        # Clipping before the cast keeps far-off pixels within the range of integers.
        low = np.clip(np.floor(pixels.min(axis=0)), 0, [width, height]).astype(int)
        high = np.clip(np.ceil(pixels.max(axis=0)) + 1, 0, [width, height]).astype(int)
        return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))

    def _outlined(self, vertices_cam: FloatArray, window: Window) -> BoolArray:
        """(height, width) of a window: the pixels inside the convex outline of the mesh, or all
        where they are few."""
        rows, columns = window
        shape = (rows.stop - rows.start, columns.stop - columns.start)
        few = shape[0] * shape[1] <= _FEW_PIXELS
        if few or vertices_cam[:, 2].min() <= 0.0:
            return np.ones(shape, dtype=np.bool_)
        pixels = project(self._camera, vertices_cam)
        try:
            corners = pixels[ConvexHull(pixels).vertices]
        except QhullError:
            # Seen edge-on, a flat mesh has an outline without area.
            return np.ones(shape, dtype=np.bool_)
        start, end = corners, np.roll(corners, -1, axis=0)
        v = np.arange(rows.start, rows.stop)[:, None]
        # A row just above or below the outline still takes the columns of its tip.
        low, high = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
        crossed = (v >= low - 1.0) & (v <= high + 1.0)
        span = end[:, 1] - start[:, 1]
        share = (np.clip(v, low, high) - start[:, 1]) / np.where(span == 0.0, 1.0, span)
        u = start[:, 0] + share * (end[:, 0] - start[:, 0])
        ends = np.maximum(start[:, 0], end[:, 0])
        right = np.where(crossed, np.where(span == 0.0, ends, u), -np.inf).max(axis=1)
        ends = np.minimum(start[:, 0], end[:, 0])
        left = np.where(crossed, np.where(span == 0.0, ends, u), np.inf).min(axis=1)
        column = np.arange(columns.start, columns.stop)
        return np.asarray((column >= left[:, None] - 1.0) & (column <= right[:, None] + 1.0))

    def _first_faces(
        self, rays_cam: FloatArray, T_cam_model: FloatArray, nearest_z_m: float
    ) -> IntArray:
        """(n,) index of the first face each ray meets, -1 for none."""
        directions = rays_cam @ T_cam_model[:3, :3]
        # Embree works in float32: rays that start just before the target keep the digits that a
        # camera far away would lose.
        start = _START_FRACTION * max(nearest_z_m, 0.0)
        origins = invert_transform(T_cam_model)[:3, 3] + start * directions
        return np.asarray(self._scene.intersects_first(origins, directions), dtype=np.intp)

    def _first_faces_moving(
        self, rays_cam: FloatArray, T_cam_model: FloatArray, nearest_z_m: float
    ) -> IntArray:
        """The same of rays that each have a pose (n, 4, 4) of their own."""
        directions = np.einsum("ni,nij->nj", rays_cam, T_cam_model[:, :3, :3])
        centres = -np.einsum("ni,nij->nj", T_cam_model[:, :3, 3], T_cam_model[:, :3, :3])
        origins = centres + _START_FRACTION * max(nearest_z_m, 0.0) * directions
        return np.asarray(self._scene.intersects_first(origins, directions), dtype=np.intp)

    def _inverse_depth_planes(self, T_cam_model: FloatArray, shown: IntArray) -> FloatArray:
        """(n_faces, 3) of all faces of a small mesh; else of those shown (k,), zero elsewhere."""
        R = T_cam_model[:3, :3]
        p_model_cam = invert_transform(T_cam_model)[:3, 3]
        n = len(self._normals)
        # The last one stands where nothing is shown, at index -1.
        some = slice(None) if n <= _MANY_FACES else np.unique(np.append(shown, n - 1))
        normals = self._normals[some]
        distance = np.einsum("ij,ij->i", normals, self._first_vertices[some] - p_model_cam)
        # A plane through the camera centre is seen edge-on: no ray hits it.
        safe = np.where(distance == 0.0, np.nan, distance)
        m = np.asarray((normals @ R.T) / safe[:, None])
        if n <= _MANY_FACES:
            return m
        planes = np.zeros((n, 3))
        planes[some] = m
        return planes

    def _depths(
        self, rays: FloatArray, faces: IntArray, planes: FloatArray, poses: FloatArray
    ) -> FloatArray:
        """(n,) z-depth where each ray meets the plane (n, 3) of its face, in double precision.

        ``poses`` (k, 4, 4) are those of the mesh at some times.
        """
        inverse_depth = np.einsum("ij,ij->i", planes, rays)
        few, which = np.arange(len(self._face_vertices)), faces
        if len(few) > _MANY_FACES:
            few, which = np.unique(faces, return_inverse=True)
        corners = self._vertices[self._face_vertices[few]]
        z = np.einsum("nij,kj->kni", corners, poses[:, 2, :3]) + poses[:, 2, 3, None, None]
        nearest, farthest = z.min(axis=0), z.max(axis=0)
        low, high = (
            one_of(one_of(z[:, 0], z[:, 1]), z[:, 2])[which]
            for one_of, z in ((np.minimum, nearest), (np.maximum, farthest))
        )
        # A grazing ray that float32 let in at the rim of a face may miss it by a hair and meet its
        # plane far away; the face's own depth span bounds it.
        with np.errstate(divide="ignore"):
            depth = 1.0 / inverse_depth
        kept = np.where(np.isfinite(depth), depth, low)
        return np.asarray(np.minimum(np.maximum(kept, low), high))


def _outer(vertices: FloatArray) -> FloatArray:
    """Points (k, 3) whose convex hull holds vertices (n, 3): where they are imaged, all is within.

    They are the corners of the hull or, where a curved surface has very many, of a polytope about
    it that is little larger.
    """
    try:
        corners = np.asarray(vertices[ConvexHull(vertices).vertices])
    except QhullError:
        # All of a flat mesh lies in its hull.
        return vertices
    if len(corners) <= _MAX_OUTER:
        return corners
    above = half_space_directions(_OUTER_PLANES // 2)
    normals = np.vstack([above, -above])
    reach = (corners @ normals.T).max(axis=0)
    planes = np.column_stack([normals, -reach])
    return np.asarray(HalfspaceIntersection(planes, corners.mean(axis=0)).intersections)


def depth_beyond_edge(rendered: RenderedDepth) -> FloatArray:
    """(height, width) depth of the other surface at an occlusion edge, m; 0 away from edges.

    Of two neighbouring pixels (up, down, left, right) on different faces, an edge lies between
    them when the plane of one is nearer than the plane of the other at both pixels: one face
    then ends in front of the other. Where two faces meet in a crease the order swaps, so a crease
    and a steep face are no edges; nor is a gap smaller than the depth that the steeper face spans
    within a pixel. With several edges the farthest-off neighbour counts. Space behind the target
    is no surface.
    """
    depth = rendered.depth_m[rendered.window].astype(np.float64)
    triangle = rendered.triangle[rendered.window]
    rays = pixel_rays(rendered.camera)[rendered.window]
    other = depth.copy()
    height, width = depth.shape
    for first, second in (
        ((slice(None), slice(0, width - 1)), (slice(None), slice(1, width))),
        ((slice(0, height - 1), slice(None)), (slice(1, height), slice(None))),
    ):
        both = (triangle[first] >= 0) & (triangle[second] >= 0)
        i, j = np.nonzero(both & (triangle[first] != triangle[second]))
        m_gap = (
            rendered.inverse_depth_planes[triangle[first][i, j]]
            - rendered.inverse_depth_planes[triangle[second][i, j]]
        )
        gap_first = np.einsum("ij,ij->i", m_gap, rays[first][i, j])
        gap_second = np.einsum("ij,ij->i", m_gap, rays[second][i, j])
        smallest = np.minimum(np.abs(gap_first), np.abs(gap_second))
        edge = (gap_first * gap_second > 0.0) & (smallest * depth[first][i, j] > _JUMP_TOLERANCE)
        i, j = i[edge], j[edge]
        for here, there in ((first, second), (second, first)):
            farther_off = np.abs(depth[there][i, j] - depth[here][i, j]) > np.abs(
                other[here][i, j] - depth[here][i, j]
            )
            other[here][i[farther_off], j[farther_off]] = depth[there][i, j][farther_off]
    beyond = np.zeros(rendered.depth_m.shape)
    beyond[rendered.window] = np.where(other == depth, 0.0, other)
    return beyond
