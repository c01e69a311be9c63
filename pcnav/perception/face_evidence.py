"""What each face of a target says of the error of a predicted pose, by ranges and outline."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from pcnav.config.depth import ModalityName
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.perception.correlated_ranges import (
    FieldEvidence,
    face_field,
    range_evidence,
    steepness_of,
)
from pcnav.perception.modality import (
    POSE_SIZE,
    Evidence,
    Modality,
    RangeFit,
    RangeResiduals,
    SeenFrame,
)
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.satellite import Rectangle

NO_FACE = -1
"""The place in the catalogue of surfaces that are on none of it."""
WITHOUT_RANGES = -2
"""Asks for the outline of all faces that have no ranges."""
_NOWHERE = -3
_MIN_PIXELS = 12
"""Fewer pixels of a face are not used by themselves."""
_MISFIT_SD = 3.0
"""Residuals this much above the noise's own spread are no chance: the face is not as modelled."""


@dataclass(frozen=True)
class FaceEvidence:
    """What one face (or all surfaces that belong to none) says of the error of a predicted pose.

    The error is (6,): translation of the model origin (m, camera axes), rotation (rad, model axes).
    """

    rectangle: Rectangle | None
    """None for the surfaces that are on no catalogue rectangle."""
    information: FloatArray
    """(6, 6) inverse covariance; may be singular."""
    vector: FloatArray
    """(6,) information times the error."""
    n_pixels: int
    chi_square_per_dof: float
    """Of the range residuals about the face's own best fit."""
    with_shared: Evidence | None = None
    """The same with errors that the faces of the frame share as further unknowns, if there are."""
    by_unweighed: FloatArray | None = None
    """(3, 6 + k) what errors of the face that its ranges are not weighed by add to the vector, each
    of one deviation: neither the pose nor its covariance counts them, but whether faces contradict
    each other depends on them. None where there are none."""
    place: int = NO_FACE
    """In the catalogue; `NO_FACE` or `WITHOUT_RANGES` of what is on none of it."""

    @property
    def joint(self) -> Evidence:
        """All that it says, for a sum over the faces of a frame."""
        return self.with_shared or Evidence(self.information, self.vector)

    @property
    def name(self) -> str:
        """For tables."""
        return "other surfaces" if self.rectangle is None else self.rectangle.name


def _ranges(seen: SeenFrame) -> Callable[[int], Evidence]:
    return lambda face: seen.ranges[face].evidence


def _outline(seen: SeenFrame) -> Callable[[int], Evidence]:
    runs = seen.contour
    run_face = seen.face_of_triangle[runs.triangle]
    jacobian = runs.by_pose_and_shared(seen.noise)
    compared = np.isin(run_face, list(seen.ranges))

    def of_face(face: int) -> Evidence:
        own = ~compared if face == WITHOUT_RANGES else run_face == face
        return Evidence.of(runs.value[own], runs.variance[own], jacobian[own])

    return of_face


MODALITIES: Mapping[ModalityName, Modality] = {
    ModalityName.RANGES: _ranges,
    ModalityName.OUTLINE: _outline,
}
"""What frames may be compared by. Their errors are taken as independent."""


def face_evidence(
    seen: SeenFrame, rectangles: Sequence[Rectangle], modalities: Sequence[ModalityName]
) -> tuple[FaceEvidence, ...]:
    """Of the faces that have ranges, in their order, by these modalities."""
    measured = {name: MODALITIES[name](seen) for name in modalities}
    faces, sd = [], unweighed_deviations(seen.noise) * seen.noise.unweighed_are_shown
    for face, fit in seen.ranges.items():
        by_unweighed = None
        if sd.any():
            by_unweighed, steepness = moved_by_field(seen, face)
            by_unweighed *= (sd * steepness)[:, None]
        joint = reduce(Evidence.with_also, (of_face(face) for of_face in measured.values()))
        rectangle = None if face == NO_FACE else rectangles[face]
        fitted = fit.n_pixels, fit.chi_square_per_dof
        faces.append(FaceEvidence(rectangle, *joint.of_pose, *fitted, joint, by_unweighed, face))
    if faces and seen.is_beside_others and ModalityName.OUTLINE in measured:
        # Grazed faces have no ranges, but edges. Where others are hidden, they are needed.
        rest = measured[ModalityName.OUTLINE](WITHOUT_RANGES)
        if rest.information.any():
            faces.append(
                FaceEvidence(
                    *(None, *rest.of_pose, 0, float("nan")), with_shared=rest, place=WITHOUT_RANGES
                )
            )
    return tuple(faces)


def unweighed_deviations(noise: SensorNoise) -> FloatArray:
    """(3,) of an offset and two tilts of a face that ranges are not weighed by, m along the
    normal."""
    return np.array([noise.unweighed_face_sd_m, *[noise.unweighed_face_tilt_sd_m] * 2])


def moved_by_field(seen: SeenFrame, face: int) -> tuple[FloatArray, float]:
    """(3, 6 + k) what an offset and two tilts of a face of a meter along its rays add to the vector
    of a frame's evidence, if its ranges are not weighed by them; and its `steepness_of`."""
    residuals, fit = seen.residuals, seen.ranges[face]
    chosen = residuals.agrees & (residuals.face == face)
    H = residuals.jacobian[chosen]
    field = face_field(residuals.u[chosen], residuals.v[chosen]) / fit.variance_m2
    by_field = np.zeros((field.shape[1], POSE_SIZE + seen.noise.n_shared))
    by_field[:, :POSE_SIZE] = field.T @ H
    if seen.noise.n_shared:
        by_field[:, POSE_SIZE] = field.sum(axis=0) * seen.noise.frame_unit_m
    return by_field, steepness_of(H)


def pooled_faces(
    face_of_triangle: IntArray, residuals: RangeResiduals, few_pixels: int
) -> IntArray:
    """The place in the catalogue of each triangle, where the faces of which little is seen are one
    surface if no more than few pixels of the whole view agree: of a far target no face has enough
    by itself."""
    shown = residuals.face[residuals.agrees]
    if len(shown) > few_pixels:
        return face_of_triangle
    faces, counts = np.unique(shown, return_counts=True)
    order = np.argsort(counts, kind="stable")
    before = np.cumsum(counts[order]) - counts[order]
    # As many faces as together are enough, the smallest first.
    own = (counts[order] >= _MIN_PIXELS) & (before >= _MIN_PIXELS)
    return np.where(np.isin(face_of_triangle, faces[order][own]), face_of_triangle, NO_FACE)


def range_fits(seen: RangeResiduals, noise: SensorNoise) -> dict[int, RangeFit]:
    """By face of which enough pixels agree with the view."""
    found: dict[int, RangeFit] = {}
    sums = list(_sums_by_face(seen))
    if not sums:
        return found
    # Of all faces at once: of one, the call takes longer than the work.
    strengths, axes = np.linalg.eigh(np.stack([each.information for each in sums]))
    for each, strength, axis in zip(sums, strengths, axes, strict=True):
        n = len(each.pixels)
        misfit = _misfit(each, strength, axis)
        variance = each.sigma_m**2 * _inflation(misfit, n)
        if noise.is_white:
            weight = 1.0 / variance
            says = FieldEvidence(Evidence(each.information * weight, each.vector * weight))
        else:
            field = face_field(seen.u[each.pixels], seen.v[each.pixels])
            says = range_evidence(each.jacobian, each.residual_m, field, variance, noise)
        found[each.face] = RangeFit(says.evidence, n, misfit, variance, says.by_field)
    return found


@dataclass(frozen=True)
class _FaceSums:
    """The normal equations of the n pixels of a face that agree."""

    face: int
    pixels: IntArray
    """(n,) which of the residuals they are."""
    jacobian: FloatArray
    """(n, 6) and their residuals (n,), weighted about the face's own typical noise."""
    residual_m: FloatArray
    sigma_m: float
    information: FloatArray
    vector: FloatArray


def _sums_by_face(seen: RangeResiduals) -> Iterator[_FaceSums]:
    index = np.where(seen.agrees, seen.face, _NOWHERE)
    for face in np.unique(seen.face[seen.agrees]).tolist():
        pixels = np.flatnonzero(index == face)
        if len(pixels) < _MIN_PIXELS:
            continue
        H, r, scale_m = seen.jacobian[pixels], seen.residual_m[pixels], seen.sigma_m
        if isinstance(scale_m, np.ndarray):
            own = scale_m[pixels]
            scale_m = float(np.sqrt(np.mean(own**2)))
            H, r = H * (scale_m / own)[:, None], r * (scale_m / own)
        yield _FaceSums(face, pixels, H, r, scale_m, H.T @ H, H.T @ r)


def _misfit(sums: _FaceSums, strength: FloatArray, axes: FloatArray) -> float:
    """Chi-square per degree of freedom of residuals about their own linear fit, by the eigenvalues
    (6,) and vectors (6, 6) of the information."""
    known = strength > 1e-9 * strength[-1]
    fitted = float(np.sum((sums.vector @ axes[:, known]) ** 2 / strength[known]))
    squares = float(sums.residual_m @ sums.residual_m)
    return max(squares - fitted, 0.0) / (sums.sigma_m**2 * max(len(sums.pixels) - 3, 1))


def _inflation(chi_square_per_dof: float, n: int) -> float:
    expected = 1.0 + _MISFIT_SD * np.sqrt(2.0 / n)
    return chi_square_per_dof if chi_square_per_dof > expected else 1.0
