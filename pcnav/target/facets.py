"""The flat faces of a mesh as a sensor outside sees them, however the mesh cuts them up."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import shapely
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import invert_transform, make_transform, transform_points
from pcnav.target.mesh import SHARP_EDGE_RAD, mesh_diameter, plane_axes, seen_from_outside

_SAME_PLANE_FRACTION = 5e-5
"""Faces are coplanar when their planes differ by less than this fraction of the diameter."""
_SAME_PLANE_RAD = 5e-4
_ONE_WAY_RAD = 20.0 * _SAME_PLANE_RAD
"""Normals of one flat face differ from their mean by less."""
_GAP_FRACTION = 1e-4
"""Coplanar faces closer than this fraction of the diameter touch."""
_CLEARANCE_FRACTION = 1e-4
"""How far off a face the eye starts when asking whether it is seen."""
_SEEN_SHARE = 0.5
"""A face of which less than this share is seen from outside is internal."""
_FIRST_LOOK = 32
"""Points of a unit at least that tell a hidden one."""
_FEW = 64
"""So many triangles are joined as fast one way as another."""
_FACES_SAMPLED = 256
"""Triangles looked at to tell whether coplanar ones joined by edges are seen."""
SAME_SIDE_RATIO = 1e-4
"""Sides that differ by less than this make a square."""


@dataclass(frozen=True)
class PlanarFace:
    """One connected flat face, seen from outside."""

    T_model_face: FloatArray
    """(4, 4): origin at the centroid of area, y along the long side of the smallest rectangle
    around the face, x along the short side, z the outward normal. Model frame, m."""
    area_m2: float
    box_m: FloatArray
    """(2,) sides of that rectangle along x and y."""
    second_moments_m2: FloatArray
    """(2, 2) mean of p p^T over the face, p = (x, y) in the face frame."""
    outline: FloatArray
    """(n, 2) corners of its outer boundary in the face frame, anticlockwise about z."""
    two_sided: bool
    """Seen from both sides: a sheet without thickness."""
    curved_share: float
    """Share of the outline across which the surface goes on, bent by less than 20 degrees, into a
    face of comparable area: large on the facets of a tessellated curved surface."""


@dataclass(frozen=True)
class _PlainMesh:
    """Arrays of a mesh: each look at the mesh itself reads it all to see whether it changed."""

    vertices: FloatArray
    faces: IntArray
    areas: FloatArray
    centres: FloatArray
    diameter_m: float

    @staticmethod
    def of(mesh: trimesh.Trimesh) -> "_PlainMesh":
        return _PlainMesh(
            *(np.array(mesh.vertices), np.array(mesh.faces), np.array(mesh.area_faces)),
            *(np.array(mesh.triangles_center), mesh_diameter(mesh)),
        )


@dataclass(frozen=True)
class _Patch:
    """A polygon in the x, y of a plane; z of the plane is the normal."""

    T_model_plane: FloatArray
    polygon: shapely.Polygon
    two_sided: bool


def planar_faces(mesh: trimesh.Trimesh, minimum_area_m2: float) -> tuple[PlanarFace, ...]:
    """Every flat face of at least the given area that is seen from outside, largest first.

    Faces in one plane that touch are one face, whether or not they share vertices; what lies
    between two bodies in contact is left out. The winding of the mesh is not relied upon: a face
    looks outward to where its view is free.
    """
    diameter = mesh_diameter(mesh)
    labels = _group_planes(mesh, mesh.face_normals, mesh.triangles_center)
    group_areas = np.bincount(labels, weights=mesh.area_faces).astype(np.float64)
    # A plane must hold a fair part of the area asked for: a face may be wound half and half.
    large = group_areas[labels] > 0.3 * minimum_area_m2
    candidates = np.flatnonzero(large & _is_flat(mesh, labels)[labels])
    faces, normals, two_sided = _outward_faces(mesh, labels, candidates)
    # Two bodies that meet in a plane from opposite sides are different faces: what is joined lies
    # in one plane and looks the same way.
    planes = _group_planes(mesh, normals, mesh.triangles_center[faces])
    smooth = _smooth_edges(mesh, labels, group_areas)
    plain, found = _PlainMesh.of(mesh), []
    for plane, sided in sorted(set(zip(planes.tolist(), two_sided.tolist(), strict=True))):
        members = (planes == plane) & (two_sided == sided)
        found += [
            _face_of_patch(patch, smooth, _GAP_FRACTION * diameter)
            for patch in _patches(plain, faces[members], normals[members], sided)
            if patch.polygon.area >= minimum_area_m2
        ]
    return tuple(sorted(found, key=lambda face: _order(face, diameter)))


def _group_planes(mesh: trimesh.Trimesh, normals: FloatArray, points: FloatArray) -> IntArray:
    """(n,) label of the oriented plane that each point with a normal lies in."""
    diameter = mesh_diameter(mesh)
    # Offsets are taken about the mesh's centre, where a small error of a normal moves them least.
    offset = np.einsum("ij,ij->i", normals, points - mesh.bounds.mean(axis=0)) / diameter
    scale = _SAME_PLANE_FRACTION / _SAME_PLANE_RAD
    features = np.column_stack([normals * scale, offset])
    # Faces of one plane mostly agree to rounding: the tree then sees each plane once.
    cells, cell_of = np.unique(
        np.round(features / (0.05 * _SAME_PLANE_FRACTION)), axis=0, return_inverse=True
    )
    pairs = cKDTree(cells).query_pairs(1.0 / 0.05, output_type="ndarray")
    return _components(pairs, len(cells))[np.ravel(cell_of)]


def _is_flat(mesh: trimesh.Trimesh, labels: IntArray) -> BoolArray:
    """(n,) whether the faces of a label look one way: a gentle curve may be cut so finely that each
    face is coplanar with the next."""
    normals = np.array(mesh.face_normals)
    weighted = normals * mesh.area_faces[:, None]
    sums = np.stack([np.bincount(labels, weighted[:, k]) for k in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1)
    mean = sums / np.where(length > 0.0, length, 1.0)[:, None]
    cosine = np.full(len(mean), 1.0)
    np.minimum.at(cosine, labels, np.einsum("ij,ij->i", normals, mean[labels]))
    return np.asarray(cosine > np.cos(_ONE_WAY_RAD))


def _outward_faces(
    mesh: trimesh.Trimesh, labels: IntArray, candidates: IntArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """The candidates seen from outside: their indices, outward unit normals, whether two-sided.

    What is hidden is decided for coplanar faces joined by edges, not for triangles: a part that
    stands on a face covers some of it and still leaves the face.
    """
    unit = _joined_by_edges(mesh, labels)[candidates]
    units, unit = np.unique(unit, return_inverse=True)
    points, owner, weight = _sample_points(mesh, candidates, unit)
    normals = mesh.face_normals[candidates]
    facing = normals[np.unique(unit, return_index=True)[1]]
    clearance = _CLEARANCE_FRACTION * mesh_diameter(mesh)
    total = np.bincount(owner, weight, minlength=len(units))
    front, behind = (
        np.bincount(owner, weight * _seen_of_units(mesh, points, side, owner, clearance)) / total
        >= _SEEN_SHARE
        for side in (facing[owner], -facing[owner])
    )
    # A sheet has no outward side: its largest normal component is made positive.
    sign = np.where(front[unit] & behind[unit], _leading_signs(facing)[unit], 1.0)
    sign = np.where(~front[unit] & behind[unit], -1.0, sign)
    seen = front[unit] | behind[unit]
    outward = normals * sign[:, None]
    return candidates[seen], outward[seen], (front & behind)[unit][seen]


def _seen_of_units(
    mesh: trimesh.Trimesh, points: FloatArray, normals: FloatArray, owner: IntArray, clear_m: float
) -> BoolArray:
    """(n,) `seen_from_outside` of points on units, which is not asked of the rest of a unit of
    which none of the first points is seen: the inner side of a body takes most rays."""
    first = _rank_within(owner) % np.maximum(1, np.bincount(owner) // _FIRST_LOOK)[owner] == 0
    seen = np.zeros(len(points), dtype=np.bool_)
    seen[first] = seen_from_outside(mesh, points[first], normals[first], clear_m)
    rest = ~first & (np.bincount(owner, seen) > 0.0)[owner]
    seen[rest] = seen_from_outside(mesh, points[rest], normals[rest], clear_m)
    return seen


def _rank_within(unit: IntArray) -> IntArray:
    """(n,) how many before each have the same label, from 0 up."""
    count = np.bincount(unit)
    order = np.argsort(unit, kind="stable")
    rank = np.empty(len(unit), dtype=np.intp)
    rank[order] = np.arange(len(unit)) - np.repeat(np.cumsum(count) - count, count)
    return rank


def _joined_by_edges(mesh: trimesh.Trimesh, labels: IntArray) -> IntArray:
    """(n,) label of the set of faces of one plane, connected by shared edges, of each face."""
    pairs = mesh.face_adjacency
    pairs = pairs[labels[pairs[:, 0]] == labels[pairs[:, 1]]]
    return _components(pairs, len(mesh.faces))


def _components(pairs: IntArray, count: int) -> IntArray:
    """(count,) label of the connected component of each node of a graph with edges (n, 2)."""
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def _sample_points(
    mesh: trimesh.Trimesh, faces: IntArray, unit: IntArray
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Points (n, 3) on the faces, the unit each stands for, and the area it does."""
    count, rank = np.bincount(unit), _rank_within(unit)
    # A unit of few faces gets many points on each; of a unit of many faces some are enough.
    stride = np.maximum(1, count // _FACES_SAMPLED)[unit]
    chosen = rank % stride == 0
    corners, areas, owner = mesh.triangles[faces], mesh.area_faces[faces], unit
    few = chosen & (count[unit] <= len(_SUBTRIANGLES))
    many = chosen & ~few
    fine = np.einsum("kj,njc->nkc", _SUBTRIANGLES, corners[few]).reshape(-1, 3)
    repeats = len(_SUBTRIANGLES)
    return (
        np.vstack([fine, corners[many].mean(axis=1)]),
        np.concatenate([np.repeat(owner[few], repeats), owner[many]]),
        np.concatenate([np.repeat(areas[few] / repeats, repeats), areas[many]]),
    )


def _subtriangle_centres(cuts: int) -> FloatArray:
    """(cuts^2, 3) barycentric centres of the equal triangles that cut sides into `cuts`."""
    steps = [(i, j) for i in range(cuts) for j in range(cuts - i)]
    upright = [(3 * i + 1, 3 * j + 1) for i, j in steps]
    turned = [(3 * i + 2, 3 * j + 2) for i, j in steps if i + j < cuts - 1]
    first = np.array(upright + turned) / (3.0 * cuts)
    return np.column_stack([first, 1.0 - first.sum(axis=1)])


_SUBTRIANGLES = _subtriangle_centres(4)


def _patches(
    mesh: _PlainMesh, faces: IntArray, normals: FloatArray, two_sided: bool
) -> list[_Patch]:
    """The connected polygons that mesh faces of one plane cover."""
    weights = mesh.areas[faces]
    normal = weights @ normals
    normal /= np.linalg.norm(normal)
    origin = weights @ mesh.centres[faces] / weights.sum()
    T_model_plane = make_transform(plane_axes(normal), origin)
    # A vertex is moved once, so that triangles that share it agree to the bit.
    used, corners = np.unique(mesh.faces[faces], return_inverse=True)
    points = transform_points(invert_transform(T_model_plane), mesh.vertices[used])[:, :2]
    triangles = shapely.polygons(points[corners.reshape(-1, 3)])
    polygons = _union(_joined(triangles), _GAP_FRACTION * mesh.diameter_m)
    return [_Patch(T_model_plane, polygon, two_sided) for polygon in polygons]


def _joined(triangles: npt.NDArray[np.object_]) -> npt.NDArray[np.object_]:
    """What triangles cover; those of a fine tessellation, which meet edge to edge, as few polygons.

    Overlapping ones are left as they are.
    """
    if len(triangles) <= _FEW:
        return triangles
    try:
        covered = shapely.coverage_union_all(triangles)
    except shapely.errors.GEOSException:
        # Their edges cross.
        return triangles
    stated = float(shapely.area(triangles).sum())
    whole = bool(shapely.is_valid(covered)) and abs(covered.area - stated) <= 1e-9 * stated
    return shapely.get_parts(covered) if whole else triangles


def _union(polygons: npt.NDArray[np.object_], gap_m: float) -> list[shapely.Polygon]:
    """The connected polygons that the given ones cover together, without gaps below 2 `gap_m`."""
    # On a grid, if a fine one, the union is exact: in plain floating point it can lose a polygon
    # whose corners differ from its neighbour's in the last digit.
    merged = shapely.union_all(polygons, grid_size=1e-5 * gap_m)
    # Growing and shrinking with mitred corners closes the cracks and leaves the corners in place.
    grown = shapely.buffer(merged, gap_m, join_style="mitre")
    closed = shapely.simplify(shapely.buffer(grown, -gap_m, join_style="mitre"), 0.1 * gap_m)
    return [part for part in shapely.get_parts(closed) if part.area > 0.0]


def _smooth_edges(mesh: trimesh.Trimesh, labels: IntArray, group_areas: FloatArray) -> FloatArray:
    """Edges at which one flat face bends gently into another of comparable area.

    (n, 4): the middle of the edge, model frame, and its length.
    """
    pair = labels[mesh.face_adjacency]
    areas = np.sort(group_areas[pair], axis=1)
    # The facets of a tessellated curve are alike; a rounded edge is far smaller than its face.
    alike = (pair[:, 0] != pair[:, 1]) & (areas[:, 0] > 0.25 * areas[:, 1])
    gentle = np.asarray(mesh.face_adjacency_angles) < SHARP_EDGE_RAD
    ends = mesh.vertices[mesh.face_adjacency_edges[alike & gentle]]
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return np.column_stack([0.5 * (ends[:, 0] + ends[:, 1]), length])


def _face_of_patch(patch: _Patch, smooth: FloatArray, tolerance_m: float) -> PlanarFace:
    """Measure a patch and give it the frame of its smallest enclosing rectangle."""
    area, centroid, moments = _polygon_moments(patch.polygon)
    axes_plane, box = _smallest_box(patch.polygon, patch.T_model_plane[:3, :3])
    R_plane_face = np.eye(3)
    R_plane_face[:2, :2] = axes_plane
    T_plane_face = make_transform(R_plane_face, np.append(centroid, 0.0))
    outline = shapely.get_coordinates(shapely.orient_polygons(patch.polygon).exterior)[:-1]
    return PlanarFace(
        T_model_face=patch.T_model_plane @ T_plane_face,
        area_m2=area,
        box_m=box,
        second_moments_m2=axes_plane.T @ moments @ axes_plane,
        outline=(outline - centroid) @ axes_plane,
        two_sided=patch.two_sided,
        curved_share=_curved_share(patch, smooth, tolerance_m),
    )


def _polygon_moments(polygon: shapely.Polygon) -> tuple[float, FloatArray, FloatArray]:
    """Area, centroid (2,) and second moments about it over the area (2, 2), by Green's theorem."""
    oriented = shapely.orient_polygons(polygon)
    shift = shapely.get_coordinates(oriented)[0]
    area, first, second = 0.0, np.zeros(2), np.zeros((2, 2))
    for ring in (oriented.exterior, *oriented.interiors):
        corners = shapely.get_coordinates(ring) - shift
        a, b = corners[:-1], corners[1:]
        cross = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        area += float(cross.sum()) / 2.0
        first += cross @ (a + b) / 6.0
        # The triangle (0, a, b) contributes cross / 24 (a a^T + b b^T + (a + b)(a + b)^T).
        for v in (a, b, a + b):
            second += np.einsum("n,ni,nj->ij", cross, v, v) / 24.0
    centroid = first / area
    return area, centroid + shift, second / area - np.outer(centroid, centroid)


def _smallest_box(
    polygon: shapely.Polygon, R_model_plane: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Axes of the enclosing rectangle of least area: columns (2, 2) short, long; and sides (2,).

    One of its sides lies along an edge of the convex hull.
    """
    hull = shapely.get_coordinates(shapely.convex_hull(polygon).exterior)
    edges = np.diff(hull, axis=0)
    along = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.column_stack([-along[:, 1], along[:, 0]])
    sides = np.stack([np.ptp(hull @ along.T, axis=0), np.ptp(hull @ across.T, axis=0)], axis=1)
    areas = sides.prod(axis=1)
    best = int(np.argmax(areas < areas.min() * (1.0 + 1e-9)))
    u, v, (size_u, size_v) = along[best], across[best], sides[best]
    square = abs(size_u - size_v) <= SAME_SIDE_RATIO * max(size_u, size_v)
    # A square has no long side: the one nearer the model's z (then y) axis is taken.
    rank_u, rank_v = (tuple(np.round(np.abs(R_model_plane[::-1, :2] @ a), 6)) for a in (u, v))
    long_is_u = rank_u > rank_v if square else size_u > size_v
    y, box = (u, np.array([size_v, size_u])) if long_is_u else (v, np.array([size_u, size_v]))
    y = y * _leading_signs(R_model_plane[:, :2] @ y)
    return np.column_stack([[y[1], -y[0]], y]), box


def _leading_signs(vectors: FloatArray) -> FloatArray:
    """(...) sign of the component of largest magnitude, the first of equals, of (..., 3)."""
    largest = np.argmax(np.round(np.abs(vectors), 6), axis=-1, keepdims=True)
    return np.where(np.take_along_axis(vectors, largest, axis=-1)[..., 0] >= 0.0, 1.0, -1.0)


def _curved_share(patch: _Patch, smooth: FloatArray, tolerance_m: float) -> float:
    """Share of the outline of a patch that lies on the edges of `_smooth_edges`."""
    height = (smooth[:, :3] - patch.T_model_plane[:3, 3]) @ patch.T_model_plane[:3, 2]
    near = smooth[np.abs(height) < tolerance_m]
    middle = transform_points(invert_transform(patch.T_model_plane), near[:, :3])
    distance = shapely.distance(patch.polygon.boundary, shapely.points(middle[:, :2]))
    return float(near[distance < tolerance_m, 3].sum() / patch.polygon.length)


def _order(face: PlanarFace, diameter: float) -> tuple[float, ...]:
    """Sort key: largest area first, then centroid and normal; free of rounding noise."""
    centroid = np.round(face.T_model_face[:3, 3] / diameter, 5)
    normal = np.round(face.T_model_face[:3, 2], 5)
    # Adding zero turns -0.0 into 0.0.
    return (-round(face.area_m2 / diameter**2, 7), *(-centroid + 0.0), *(-normal + 0.0))
