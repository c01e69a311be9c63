"""Pose hypotheses from one frame without any prediction.

Every recognised rectangle, as each catalogue entry of its size and in each case of the ambiguity,
puts the whole target somewhere. The model rendered there says how much of the frame that
explains: returns at the predicted depth count for it; a return where space is predicted, space
where a surface is predicted, and returns at another depth count against it.
"""

from dataclasses import dataclass

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import invert_transform
from pcnav.perception.agreement import Agreement
from pcnav.perception.association import MAX_YAW_SD_RAD
from pcnav.perception.perceive import PerceivedFrame
from pcnav.perception.recognition import apply_case, possible_cases
from pcnav.perception.rectangles import YAW
from pcnav.perception.regions import Region
from pcnav.perception.render_compare import RenderComparer
from pcnav.target.satellite import Target

_MAX_RECTANGLES = 4
"""Only the largest recognised rectangles propose poses; the others take part in the score. One
that seems cut may propose, too: the score judges what it makes of the frame."""
_SAME_ANGLE_RAD = 0.15
_SAME_SHIFT_FRACTION = 0.1
"""Hypotheses closer than this angle and share of the diameter are one."""
_DEPTH_TOLERANCE_SIGMA = 4.0
_DEPTH_TOLERANCE_FRACTION = 0.01
"""Depths agree within this many sigma plus this share of the diameter: hypotheses are not exact."""


@dataclass(frozen=True)
class PoseHypothesis:
    """One place where the target may be."""

    T_cam_model: FloatArray
    """(4, 4)"""
    agreement: Agreement
    """Of the frame with the view from there, on a coarse grid."""
    proposed_by: str
    """The catalogue entry, or what else it was."""
    region: Region | None = None
    """The part of the frame it was found in, where it was searched for in parts."""


def pose_hypotheses(
    perceived: PerceivedFrame, target: Target, comparer: RenderComparer, range_sigma_m: float
) -> tuple[PoseHypothesis, ...]:
    """All distinct hypotheses of a frame, the one that explains most first."""
    tolerance = depth_tolerance(target, range_sigma_m)
    hypotheses = []
    for T_cam_model, rectangle in _distinct(_proposals(perceived), target):
        found = comparer.score(perceived.frame.depth_m, T_cam_model, tolerance)
        hypotheses.append(PoseHypothesis(T_cam_model, found, rectangle))
    return tuple(sorted(hypotheses, key=lambda hypothesis: -hypothesis.agreement.inlier_ratio))


def depth_tolerance(target: Target, range_sigma_m: float) -> float:
    """Difference in depth, m, that a pose which is roughly right may leave."""
    return _DEPTH_TOLERANCE_SIGMA * range_sigma_m + _DEPTH_TOLERANCE_FRACTION * target.diameter_m


def _proposals(perceived: PerceivedFrame) -> list[tuple[FloatArray, str]]:
    proposals = []
    recognised = [
        seen
        for seen in perceived.seen
        if seen.recognitions and seen.observation.covariance[YAW, YAW] < MAX_YAW_SD_RAD**2
    ]
    for seen in recognised[:_MAX_RECTANGLES]:
        for recognition in seen.recognitions:
            rectangle = recognition.rectangle
            for case in possible_cases(rectangle):
                T_cam_rect = apply_case(seen.observation.T_cam_rect, case)
                T_cam_model = T_cam_rect @ invert_transform(rectangle.T_model_rect)
                proposals.append((T_cam_model, rectangle.name))
    return proposals


def _distinct(
    proposals: list[tuple[FloatArray, str]], target: Target
) -> list[tuple[FloatArray, str]]:
    """Drop proposals that an earlier one (of a larger rectangle) already makes, or one that the
    target's symmetry makes equal to it."""
    kept: list[tuple[FloatArray, str]] = []
    for T, name in proposals:
        if not any(
            target.shows_alike(other, T, _SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION) for other, _ in kept
        ):
            kept.append((T, name))
    return kept
