"""The rectangle catalogue: which flat faces of a mesh are rectangles, and where they are."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.target.facets import SAME_SIDE_RATIO, PlanarFace

MINIMUM_SIDE_FRACTION = 0.02
"""Sides shorter than this fraction of the target's diameter are too small to matter."""
RECTANGLE_TOLERANCE = 0.01
EQUIVALENT_TOLERANCE = 0.15
"""Tolerance within which a face may stand in by its equivalent rectangle."""
_CURVED_SHARE = 0.25


@dataclass(frozen=True)
class Rectangle:
    """A flat rectangular face of the target.

    The rectangle frame has its origin at the centroid, x along the short side, y along the long
    side and z along the outward normal (Yu 2019, Figure 1).
    """

    name: str
    T_model_rect: FloatArray
    """(4, 4) pose of the rectangle frame in the model frame."""
    length_m: float
    """Long side a, along y."""
    width_m: float
    """Short side b, along x."""
    two_sided: bool
    """A sheet without thickness: seen from both sides, so its normal has no outward direction."""

    @property
    def area_m2(self) -> float:
        """Area."""
        return self.length_m * self.width_m

    def scaled(self, factor: float) -> "Rectangle":
        """That of a target larger by a factor about the model's origin."""
        pose = self.T_model_rect.copy()
        pose[:3, 3] *= factor
        length_m, width_m = factor * self.length_m, factor * self.width_m
        return replace(self, T_model_rect=pose, length_m=length_m, width_m=width_m)


def rectangles_among(
    faces: tuple[PlanarFace, ...], minimum_side_m: float, tolerance: float, stem: str
) -> tuple[Rectangle, ...]:
    """The rectangles among flat faces, in the order of the faces, named stem_1, stem_2, ...

    A face is one when its area and both second moments agree with those of the smallest rectangle
    around it to `tolerance`, and when it is not a facet of a tessellated curved surface, whose
    outline no sensor sees. Sides are those of the rectangle with the face's second moments (Yu
    2019 reads them the same way from the points): exact for a rectangle, and the equivalent
    rectangle of a face that the tolerance lets pass.
    """
    found = [
        face
        for face in faces
        if rectangle_fault(face) <= tolerance
        and face.curved_share < _CURVED_SHARE
        and _sides(face).min() >= minimum_side_m
    ]
    return tuple(_rectangle(f"{stem}_{k}", face) for k, face in enumerate(found, start=1))


def rectangle_fault(face: PlanarFace) -> float:
    """Largest relative departure of area and second moments from those of the enclosing box."""
    width, length = face.box_m
    expected = np.array([width**2, length**2]) / 12.0
    moments = face.second_moments_m2
    return float(
        max(
            abs(1.0 - face.area_m2 / (width * length)),
            np.max(np.abs(1.0 - np.diag(moments) / expected)),
            abs(moments[0, 1]) / np.sqrt(expected.prod()),
        )
    )


def _sides(face: PlanarFace) -> FloatArray:
    """(2,) sides along x and y of the rectangle that has the second moments of the face."""
    return np.asarray(np.sqrt(12.0 * np.diag(face.second_moments_m2)))


def _rectangle(name: str, face: PlanarFace) -> Rectangle:
    width, length = (float(side) for side in _sides(face))
    T_model_rect = face.T_model_face
    if abs(width - length) <= SAME_SIDE_RATIO * length:
        width = length = 0.5 * (width + length)
    elif width > length:
        # Only a face that is no true rectangle can be longer across its box than along it.
        width, length = length, width
        quarter_turn = make_transform(exp_rotation(np.array([0.0, 0.0, np.pi / 2])), np.zeros(3))
        T_model_rect = T_model_rect @ quarter_turn
    return Rectangle(name, T_model_rect, length, width, face.two_sided)
