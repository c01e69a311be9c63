"""What each return of a depth frame shows, and the colours that say so. Arrays in, arrays out."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import trimesh

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.target.catalogue import Rectangle
from pcnav.viewer.palette import LABELS, RESIDUAL_STOPS, UNEXPLAINED

Colours = npt.NDArray[np.uint8]

EXPLAINED_SIGMA = 3.0
"""A return further than this from the rendered model is not explained by it, as in perception."""
_RECTANGLE_TOLERANCE = 2e-3
"""A face belongs to a rectangle that holds its corners to within this share of the long side."""
_NICE = (1.0, 1.5, 2.0, 3.0, 5.0, 7.5, 10.0)


@dataclass(frozen=True)
class FaceNames:
    """What the triangles of a mesh belong to."""

    plane: IntArray
    """(n_faces,) rank of the flat part of the surface by its area."""
    rectangle: IntArray
    """(n_faces,) number in the catalogue, the largest first; -1 for none."""


def face_names(mesh: trimesh.Trimesh, rectangles: tuple[Rectangle, ...]) -> FaceNames:
    """Flat parts and catalogue rectangles of a mesh's triangles.

    The largest have a rank, and so a colour, of their own; the others share the last one.
    """
    plane = np.full(len(mesh.faces), -1, dtype=np.intp)
    for number, faces in enumerate(mesh.facets):
        plane[faces] = number
    # A triangle without a coplanar neighbour is a flat part of its own.
    alone = np.flatnonzero(plane < 0)
    plane[alone] = len(mesh.facets) + np.arange(len(alone))
    area = np.bincount(plane, weights=mesh.area_faces)
    return FaceNames(
        _ranks(np.asarray(area, dtype=np.float64))[plane], _rectangle_numbers(mesh, rectangles)
    )


def _ranks(size: FloatArray) -> IntArray:
    """(n,) place of each of n sizes, largest first; equal ones as they come."""
    rank = np.empty(len(size), dtype=np.intp)
    rank[np.argsort(-size, kind="stable")] = np.arange(len(size))
    return np.minimum(rank, len(LABELS) - 1)


def _rectangle_numbers(mesh: trimesh.Trimesh, rectangles: tuple[Rectangle, ...]) -> IntArray:
    """(n_faces,) number in the catalogue of each triangle of a mesh, -1 for none."""
    rectangle = np.full(len(mesh.faces), -1, dtype=np.intp)
    corners = np.asarray(mesh.triangles, dtype=np.float64)
    for number, each in reversed(list(enumerate(rectangles))):
        p_rect = transform_points(invert_transform(each.T_model_rect), corners.reshape(-1, 3))
        slack = _RECTANGLE_TOLERANCE * each.length_m
        half = 0.5 * np.array([each.width_m, each.length_m, 0.0]) + slack
        inside = (np.abs(p_rect) <= half).all(axis=1).reshape(-1, 3).all(axis=1)
        outward = mesh.face_normals @ each.T_model_rect[:3, 2] > 0.0
        rectangle[inside & (outward | each.two_sided)] = number
    return rectangle


def range_residual(
    depth_m: npt.NDArray[np.floating], rays: FloatArray, model_m: FloatArray, faces: IntArray
) -> FloatArray:
    """(n,) range measured minus range of the model, m; nan off the model.

    Of z-depths (n,) along rays (n, 3), z = 1, that meet the model at depths (n,) and faces (n,),
    -1 for none.
    """
    residual = (depth_m - model_m) * np.sqrt(np.einsum("ij,ij->i", rays, rays))
    residual[faces < 0] = np.nan
    return np.asarray(residual)


def labels_of(
    faces: IntArray, residual_m: FloatArray, of_face: IntArray, sigma_m: float
) -> IntArray:
    """(n,) label of the face (n,) that explains each return, -1 where none does."""
    explained = np.abs(residual_m) <= EXPLAINED_SIGMA * sigma_m
    return np.where(explained, of_face[faces], -1)


def label_colours(labels: npt.NDArray[np.integer]) -> Colours:
    """(..., 3) a colour per label (...), the last from there on; that of the unexplained for -1."""
    colours: Colours = LABELS[np.minimum(labels, len(LABELS) - 1)]
    colours[labels < 0] = UNEXPLAINED
    return colours


def residual_scale(sigma_m: float) -> float:
    """End of a symmetric scale, m: the round number from 3 sigma on, where the unexplained begins.

    The same in every frame of a run, so that colours keep their meaning as time passes.
    """
    return nice_ceiling(EXPLAINED_SIGMA * sigma_m)


def nice_ceiling(value: float) -> float:
    """The next round number from a positive value on."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(decade * next(step for step in _NICE if step * decade >= value * (1.0 - 1e-9)))


def residual_colours(residual_m: npt.NDArray[np.floating], scale_m: float) -> Colours:
    """(..., 3) of residuals (...): blue nearer than the model, white on it, red behind it.

    Beyond the scale the end colours stay; what has no residual gets that of the unexplained.
    """
    share = np.clip(np.nan_to_num(residual_m / scale_m), -1.0, 1.0)
    stops = np.array(RESIDUAL_STOPS, dtype=np.float64)
    colours = np.stack(
        [np.interp(share, (-1.0, 0.0, 1.0), stops[:, channel]) for channel in range(3)], axis=-1
    )
    colours[~np.isfinite(residual_m)] = UNEXPLAINED
    return colours.astype(np.uint8)


def range_shades(points: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """(n,) brightness of points (n, 3), camera frame: 1 of the nearest to 0.35."""
    if not len(points):
        return np.zeros(0)
    range_m = np.linalg.norm(points, axis=1)
    low, high = np.percentile(range_m, (1.0, 99.0))
    return np.asarray(1.0 - 0.65 * np.clip((range_m - low) / max(high - low, 1e-9), 0.0, 1.0))
