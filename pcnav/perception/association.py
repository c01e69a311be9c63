"""From what was seen to pose measurements of catalogue rectangles, given a predicted pose.

Two ways share the ambiguity's solution by prediction (Yu 2019 (22)-(25)). `measure_by_size` is the
paper's: a segment is recognised by its sides and is that rectangle. `measure_by_prediction`
compares each segment with the predicted view of the face it overlaps, so that hidden parts and rims
bias nothing, and every face counts, whole or cut.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import invert_transform, skew
from pcnav.perception.perceive import PerceivedFrame, Seen
from pcnav.perception.predicted_view import PredictedFace, PredictedView
from pcnav.perception.recognition import AxesCase, apply_case, resolve_case, size_gate
from pcnav.perception.rectangles import AREA, LENGTH, WIDTH, YAW, RectangleObservation, SegmentShape
from pcnav.target.satellite import Rectangle

MAX_YAW_SD_RAD = 0.1
"""A face nearer to a square than this has no yaw of its own: five degrees of freedom are left."""
_MIN_OVERLAP = 0.5
"""Share of an expected face that a segment must cover to be it."""
_SIZE_TOLERANCE = 0.02
"""Unmodelled share of the sides and the area by which seen and expected part may differ."""

WHOLE: BoolArray = np.array([True, True, True, True, True, True])
SQUARE: BoolArray = np.array([True, True, True, True, True, False])
PLANE: BoolArray = np.array([False, False, True, True, True, False])
"""Which of x, y, z, tilt about x, tilt about y, yaw a measurement determines."""


@dataclass(frozen=True)
class MeasuredFace:
    """The pose of one catalogue rectangle as one frame shows it."""

    seen: Seen
    rectangle: Rectangle
    T_cam_rect: FloatArray
    """(4, 4) of the catalogue rectangle, ambiguity resolved."""
    length_m: float
    width_m: float
    """Measured sides of the whole rectangle; of a partly hidden one, by the part that is seen."""
    covariance: FloatArray
    """(6, 6) of x, y, z (m) and rotation about x, y, z (rad), rectangle axes."""
    known: BoolArray
    """(6,) components that the observation determines."""
    case: AxesCase


@dataclass(frozen=True)
class Unused:
    """A segment that gives no measurement, and why."""

    seen: Seen
    reason: str


def measure_by_prediction(
    perceived: PerceivedFrame, predicted: PredictedView, gate_sigma: float
) -> tuple[list[MeasuredFace], list[Unused]]:
    """Measurements of the faces predicted in view; at most one for each segment."""
    measured: list[MeasuredFace] = []
    unused: list[Unused] = []
    taken: set[int] = set()
    for seen in perceived.seen:
        index = _overlapping_face(perceived, seen, predicted)
        if index is None:
            unused.append(Unused(seen, "no face expected there"))
        elif index in taken:
            unused.append(Unused(seen, "its face was seen in a larger segment"))
        else:
            taken.add(index)
            face = _compare(seen, predicted.faces[index], gate_sigma)
            if _is_usable(face):
                measured.append(face)
            else:
                unused.append(Unused(seen, "its covariance is degenerate"))
    return measured, unused


def _is_usable(face: MeasuredFace) -> bool:
    """Whether what a face is known by can be inverted: not for one seen from a hand's breadth."""
    known = face.covariance[np.ix_(face.known, face.known)]
    return bool(np.isfinite(known).all() and np.linalg.eigvalsh(known)[0] > 0.0)


def measure_by_size(
    perceived: PerceivedFrame, T_cam_model: FloatArray
) -> tuple[list[MeasuredFace], list[Unused]]:
    """Measurements of the whole rectangles recognised by size, as Yu 2019 does.

    Of several entries of the same size the one nearest to its predicted pose is taken.
    """
    measured: list[MeasuredFace] = []
    unused: list[Unused] = []
    for seen in perceived.seen:
        if seen.observation.is_cut or not seen.recognitions:
            reason = "cut" if seen.observation.is_cut else "no catalogue rectangle of its size"
            unused.append(Unused(seen, reason))
            continue
        options = [
            as_rectangle(seen, recognition.rectangle, T_cam_model)
            for recognition in seen.recognitions
        ]
        best = min(options, key=lambda face: _pose_distance(face, T_cam_model))
        if not _is_usable(best):
            unused.append(Unused(seen, "its covariance is degenerate"))
        elif best.rectangle.name in {face.rectangle.name for face in measured}:
            unused.append(Unused(seen, "its rectangle was seen in a larger segment"))
        elif _pose_distance(best, T_cam_model) > 0.5 * best.rectangle.length_m:
            unused.append(Unused(seen, "far from every predicted rectangle of its size"))
        else:
            measured.append(best)
    return measured, unused


def as_rectangle(seen: Seen, rectangle: Rectangle, T_cam_model: FloatArray) -> MeasuredFace:
    """A whole segment read as one catalogue rectangle, its case resolved by a predicted pose."""
    observation = seen.observation
    predicted = T_cam_model @ rectangle.T_model_rect
    case, _ = resolve_case(observation.T_cam_rect[:3, :3], predicted[:3, :3], rectangle)
    known = SQUARE if _has_no_yaw(observation) else WHOLE
    T_cam_rect = apply_case(observation.T_cam_rect, case)
    if not known[YAW]:
        T_cam_rect = _turned_like(T_cam_rect, predicted)
    sides = (observation.length_m, observation.width_m)
    return _measured(seen, rectangle, T_cam_rect, sides, known, case)


def _pose_distance(face: MeasuredFace, T_cam_model: FloatArray) -> float:
    """How far the measured pose is from the predicted one, metres: centroid and tilted ends."""
    predicted = T_cam_model @ face.rectangle.T_model_rect
    shift = np.linalg.norm(predicted[:3, 3] - face.T_cam_rect[:3, 3])
    turn = np.linalg.norm(predicted[:3, :3] - face.T_cam_rect[:3, :3])
    return float(shift + 0.5 * face.rectangle.length_m * turn)


def _overlapping_face(
    perceived: PerceivedFrame, seen: Seen, predicted: PredictedView
) -> int | None:
    assert perceived.window is not None, "a segment was seen, so there is a window"
    u, v = perceived.window.pixel(seen.segment.pixels).T
    votes = predicted.labels[v, u]
    votes = votes[votes >= 0]
    if len(votes) == 0:
        return None
    counts = np.bincount(votes)
    best = int(counts.argmax())
    # Half of the face itself: what a wrong prediction picks out of other surfaces is a patch.
    return best if counts[best] >= _MIN_OVERLAP * predicted.faces[best].n_pixels else None


def _compare(seen: Seen, face: PredictedFace, gate_sigma: float) -> MeasuredFace:
    """The rectangle's pose from the seen moments and how the expected moments sit on it."""
    observed, expected = seen.observation, face.shape
    case, _ = resolve_case(observed.T_cam_rect[:3, :3], expected.T_cam_rect[:3, :3], face.rectangle)
    T_cam_moments = apply_case(observed.T_cam_rect, case)
    known = SQUARE if _has_no_yaw(observed) else WHOLE
    if not _same_size(observed, expected, gate_sigma):
        known = PLANE
    if not known[YAW]:
        T_cam_moments = _turned_like(T_cam_moments, expected.T_cam_rect)
    T_moments_rect = invert_transform(expected.T_cam_rect) @ face.T_cam_rect
    T_cam_rect = T_cam_moments @ T_moments_rect
    sides = (
        face.rectangle.length_m * observed.length_m / expected.length_m,
        face.rectangle.width_m * observed.width_m / expected.width_m,
    )
    return _measured(seen, face.rectangle, T_cam_rect, sides, known, case)


def _measured(
    seen: Seen,
    rectangle: Rectangle,
    T_cam_rect: FloatArray,
    sides: tuple[float, float],
    known: BoolArray,
    case: AxesCase,
) -> MeasuredFace:
    """The measurement, with the observation's covariance carried over to the rectangle's frame."""
    T_moments_rect = invert_transform(seen.observation.T_cam_rect) @ T_cam_rect
    covariance = _carried(seen.observation.covariance[:6, :6], T_moments_rect)
    return MeasuredFace(seen, rectangle, T_cam_rect, *sides, covariance, known, case)


def _has_no_yaw(observation: RectangleObservation) -> bool:
    return bool(observation.covariance[YAW, YAW] > MAX_YAW_SD_RAD**2)


def _same_size(observed: RectangleObservation, expected: SegmentShape, gate_sigma: float) -> bool:
    """Whether seen and expected part agree in both sides and the area."""
    rows = [LENGTH, WIDTH, AREA]
    seen = np.array([observed.length_m, observed.width_m, observed.area_m2])
    size = np.array([expected.length_m, expected.width_m, expected.area_m2])
    covariance = observed.covariance[np.ix_(rows, rows)] + np.diag((_SIZE_TOLERANCE * size) ** 2)
    difference = seen - size
    chi_square = float(difference @ np.linalg.solve(covariance, difference))
    return chi_square < size_gate(gate_sigma, len(rows))


def _turned_like(T_cam_rect: FloatArray, reference: FloatArray) -> FloatArray:
    """The frame turned about its own normal until its x axis points as near the reference's."""
    normal = T_cam_rect[:3, 2]
    short = reference[:3, 0] - normal * (normal @ reference[:3, 0])
    short /= np.linalg.norm(short)
    turned = T_cam_rect.copy()
    turned[:3, 0], turned[:3, 1] = short, np.cross(normal, short)
    return turned


def _carried(covariance: FloatArray, T_a_b: FloatArray) -> FloatArray:
    """Pose covariance (6, 6) of frame a, in its axes, as that of frame b rigidly attached to it.

    A turn theta_a moves b's origin by ``theta_a x p``; both are then seen in b's axes.
    """
    R_b_a = T_a_b[:3, :3].T
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R_b_a
    adjoint[:3, 3:] = -R_b_a @ skew(T_a_b[:3, 3])
    return np.asarray(adjoint @ covariance @ adjoint.T)
