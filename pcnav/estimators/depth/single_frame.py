"""The pose of a target from one depth frame alone: all of its faces, no motion model.

Hypotheses, each fitted to the frame, and the one that then explains most. They are fitted by
comparison with the rendered view (`pose_fit`), or by rectangles: predicted view, measured faces,
one update of the filter engine from a prior that says nothing, and again with the view predicted
from the better pose. There a bare pose is a navigation state whose mass centre is the model's
origin and whose camera is the world.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from pcnav.config.depth import Measurements
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.inertia_parameters import BALL
from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY, NavigationState
from pcnav.estimators.depth.mass_centre import RectangleMeasurement
from pcnav.estimators.depth.pose_fit import (
    GATE_PROBABILITY,
    SingleFramePose,
    consistent,
    fit_pose,
)
from pcnav.estimators.depth.target_odds import frame_odds
from pcnav.filtering.error_state import ErrorStateFilter, innovation_gate
from pcnav.perception.agreement import Agreement
from pcnav.perception.association import MeasuredFace
from pcnav.perception.perceive import PerceivedFrame
from pcnav.perception.pose_hypotheses import PoseHypothesis
from pcnav.perception.reading import FrameReader, Trust, View
from pcnav.perception.render_compare import RenderComparer, never
from pcnav.perception.view_hypotheses import SearchReport, evidence_weights
from pcnav.recordings.sequence import Frame

_MAX_HYPOTHESES = 4
_MAX_LAG = 0.3
"""Hypotheses that explain so much less than the best one are not refined."""
_SETTLED_INLIER_RATIO = 0.9
"""Of the best pose that rectangles lead to, and of all returns of its frame, for nothing else to be
tried: a part of the target may be explained by another one, and the rest be taken for other things.
"""
_MAX_VIEW_HYPOTHESES = 6
_MIN_WEIGHT_SHARE = 0.6
"""Of the best pose's weight of evidence, for another one in the same frame to be a hypothesis."""
_ALIGNED_DOUBT = 0.3
"""How far a pose that was aligned with the returns may be off, in terms of those that rectangles
propose."""
_PASSES = 4
"""Most times the predicted view is rendered anew."""
_POSITION_SD_FRACTION = 1.0
_ATTITUDE_SD_RAD = 1.0
"""Prior about the hypothesis, the position over the diameter: so wide that it decides nothing."""
_HYPOTHESIS_SD_FRACTION = 0.02
_HYPOTHESIS_SD_RAD = 0.05
"""How far a hypothesis from one rectangle may be off, the position over the diameter."""
_BEATEN_SD = 3.0
"""A coarse fit is given up when it has so many deviations more pixels against it than another."""
_SAME_PX = 3.0
"""Poses that show no point of the target further apart are one."""
_HELD_SD = 1e-9
"""Deviation of the parts of the state that are no pose: they stay where they are."""
_STILL_SHARE = 1.0
"""A pass that moves every component by less than this share of its deviation is the last."""
_POSE = np.r_[R_HILL, THETA_BODY]


def single_frame_pose(frame: Frame, reader: FrameReader) -> SingleFramePose | None:
    """Pose of the target in one frame without any prediction; None when none is acceptable.

    The hypotheses that explain most are each refined, and the pose that then explains most of the
    frame is taken.
    """
    candidates = refined_hypotheses(reader.look(frame), reader)
    return candidates[0] if candidates and frame_odds(candidates[0].agreement) > 0.0 else None


def refined_hypotheses(
    perceived: PerceivedFrame, reader: FrameReader, near: Sequence[FloatArray] = ()
) -> tuple[SingleFramePose, ...]:
    """The likeliest hypotheses of a frame, each refined on all faces; the best explaining first.

    Each is one of the equivalent poses of a symmetric target: that nearest in attitude to one of
    ``near`` (4, 4 each).
    """
    return search(perceived, reader, near)[0]


def search(
    perceived: PerceivedFrame, reader: FrameReader, near: Sequence[FloatArray] = ()
) -> tuple[tuple[SingleFramePose, ...], SearchReport]:
    """`refined_hypotheses` and a report of where the target was looked for.

    Rectangles propose first. Where they do not settle the frame, sampled views of the target
    propose as well, in every part of the frame that is of its size.
    """
    frame = perceived.frame
    proposed = _likely(reader.hypotheses(perceived)[:_MAX_HYPOTHESES])
    poses: list[FloatArray] = []
    for hypothesis in proposed:
        # Without others to be near to, near to one another: motions are told apart by attitude.
        near = near or poses[:1]
        poses.append(reader.nearest_equivalent(hypothesis.T_cam_model, near))
    found = best_first(refitted(poses, perceived, reader))
    if reader.measured_by is Measurements.RECTANGLES:
        return found, reader.report(frame, found[0].inlier_ratio if found else np.nan)
    if found and _settles(found[0], frame):
        found = with_rivals(found, frame, reader)
        return found, reader.report(frame, found[0].inlier_ratio)
    seen, report = reader.view_hypotheses(frame)
    likely = _likely(seen[:_MAX_VIEW_HYPOTHESES])
    near = near or [pose.T_cam_model for pose in found[:1]] or [h.T_cam_model for h in likely[:1]]
    new: list[SingleFramePose] = []
    for region in {id(hypothesis.region): hypothesis.region for hypothesis in likely}.values():
        assert region is not None, "sampled views are compared with regions"
        # What one part of the frame shows clearly better than another pose does beats that.
        poses = [
            reader.nearest_equivalent(hypothesis.T_cam_model, near)
            for hypothesis in likely
            if hypothesis.region is region
        ]
        fits = compared_poses(poses, region.frame, reader, _ALIGNED_DOUBT, region.sigma_m)
        for pose in _others([*found, *new], fits, frame, reader):
            judged = reader.judged(frame, pose.T_cam_model, region.sigma_m)
            new.append(replace(pose, agreement=judged))
    best = best_first if reader.shows_target_alone(frame) else _weightiest
    return with_rivals(best([*found, *new]), frame, reader), report


def _settles(pose: SingleFramePose, frame: Frame) -> bool:
    """Whether a pose explains so much of a frame that no better one can be."""
    returns = int(np.count_nonzero(frame.depth_m))
    explained = pose.agreement.agree >= _SETTLED_INLIER_RATIO * returns
    return explained and pose.inlier_ratio >= _SETTLED_INLIER_RATIO


def with_rivals(
    found: tuple[SingleFramePose, ...], frame: Frame, reader: FrameReader
) -> tuple[SingleFramePose, ...]:
    """Poses found in a frame, the best first, and behind them what the target's shape makes most
    like the best, whether anything proposes it or not. A best one that the frame contradicts has
    none."""
    if not found or frame_odds(found[0].agreement) < 0.0:
        return found
    best = found[0].T_cam_model
    turned = reader.rivals(frame, [pose.T_cam_model for pose in found])
    rivals = [reader.nearest_equivalent(pose, (best,)) for pose in turned]
    new = _others(found, compared_poses(rivals, frame, reader, known=found), frame, reader)
    return best_first([*found, *new]) if reader.shows_target_alone(frame) else (*found, *new)


def _others(
    known: Sequence[SingleFramePose],
    poses: Sequence[SingleFramePose],
    frame: Frame,
    reader: FrameReader,
) -> list[SingleFramePose]:
    """Those of poses that are none of the known ones, nor an earlier one of themselves."""
    kept: list[SingleFramePose] = []
    for pose in poses:
        moved = [
            reader.moved_px(pose.T_cam_model, other.T_cam_model, frame) for other in (*known, *kept)
        ]
        if min(moved, default=np.inf) > _SAME_PX:
            kept.append(pose)
    return kept


def _weightiest(poses: Sequence[SingleFramePose]) -> tuple[SingleFramePose, ...]:
    """Those for which most speaks where the frame holds other things, too, the best first."""
    weights = evidence_weights([(pose.T_cam_model, pose.agreement) for pose in poses])
    order = np.argsort(-weights, kind="stable").tolist()
    return tuple(poses[k] for k in order if weights[k] >= _MIN_WEIGHT_SHARE * weights.max())


def _likely(hypotheses: Sequence[PoseHypothesis]) -> list[PoseHypothesis]:
    """Those of hypotheses, best first, that do not explain much less than the best."""
    return [
        hypothesis
        for hypothesis in hypotheses
        if hypothesis.agreement.inlier_ratio > hypotheses[0].agreement.inlier_ratio - _MAX_LAG
    ]


def best_first(poses: Iterable[SingleFramePose]) -> tuple[SingleFramePose, ...]:
    """The likeliest first, among poses of one frame."""
    return tuple(sorted(poses, key=lambda pose: -pose.agreement.support))


def refitted(
    poses: Sequence[FloatArray], perceived: PerceivedFrame, reader: FrameReader
) -> list[SingleFramePose]:
    """Poses (4, 4) fitted to a frame in the way the reader measures; those that found a fit."""
    if reader.measured_by is Measurements.RECTANGLES:
        found = [refine_pose(T_cam_model, perceived, reader) for T_cam_model in poses]
        return [pose for pose in found if pose is not None]
    return compared_poses(poses, perceived.frame, reader)


def compared_poses(
    hypotheses: Sequence[FloatArray],
    frame: Frame,
    reader: FrameReader,
    doubt: float = 1.0,
    sigma_m: float | None = None,
    known: Sequence[SingleFramePose] = (),
    *,
    are_motions: bool = False,
) -> list[SingleFramePose]:
    """The poses that comparing a frame with its rendered view gives, from hypotheses (4, 4) each.

    Hypotheses that a few coarse passes bring to one place are one. ``doubt`` is how far they may be
    off, in terms of those that rectangles propose; ``sigma_m`` the noise, where the reader knows it
    less well; ``known`` are poses of the frame that are not to be found again. Where the hypotheses
    ``are_motions`` that explained frames before, the coarse grid only says where each leads: its
    few pixels would drop the right one where a wrong one happens to be fitted better.
    """
    if not hypotheses:
        return []
    comparer = reader.comparer(frame)
    if sigma_m is not None:
        comparer = comparer.with_noise(sigma_m)
    rough = comparer.coarse(frame.depth_m, hypotheses[0])
    sd = doubt * np.repeat([_HYPOTHESIS_SD_FRACTION * reader.diameter_m, _HYPOTHESIS_SD_RAD], 3)
    # What is known beats others as they beat each other: as the coarse grid has it.
    best = [
        fit_pose(frame.depth_m, pose.T_cam_model, np.diag(sd**2), rough, spread=pose.covariance)
        for pose in known[:1]
    ]
    beating = [pose.agreement for pose in best if pose is not None]
    coarse: list[SingleFramePose] = []

    def is_another(T_cam_model: FloatArray) -> bool:
        others = (*known, *coarse)
        moved = (reader.moved_px(T_cam_model, other.T_cam_model, frame) for other in others)
        return all(px > _SAME_PX for px in moved)

    for T_cam_model in hypotheses:
        fit = fit_pose(
            *(frame.depth_m, T_cam_model, np.diag(sd**2), rough),
            goes_on=is_another,
            is_beaten=never if are_motions else partial(_is_beaten, beating),
        )
        if fit is None:
            # Of a small target the coarse grid leaves nothing to compare.
            fit = fit_pose(frame.depth_m, T_cam_model, np.diag(sd**2), comparer)
        if fit is not None and is_another(fit.T_cam_model):
            coarse.append(fit)
            beating.append(fit.agreement)
    left = best_first(
        fit for fit in coarse if are_motions or not _is_beaten(beating, fit.agreement)
    )
    return _refined(left, frame, comparer, np.diag(sd**2), known)


def _refined(
    coarse: Sequence[SingleFramePose],
    frame: Frame,
    comparer: RenderComparer,
    covariance: FloatArray,
    known: Sequence[SingleFramePose],
) -> list[SingleFramePose]:
    """Poses fitted on a coarse grid, the best first, fitted to all pixels."""
    found: list[SingleFramePose] = []
    beating = [pose.agreement for pose in known[:1]]
    for at in coarse:
        # The frame is used once: the coarse pass says where to start, not what is known. What is
        # beaten is not brought any nearer, but it is told how much worse it is.
        fit = fit_pose(
            *(frame.depth_m, at.T_cam_model, covariance, comparer),
            spread=at.covariance,
            is_beaten=partial(_is_beaten, beating),
        )
        if fit is not None:
            found.append(fit)
            beating.append(fit.agreement)
    return found


def _is_beaten(others: Sequence[Agreement], agreement: Agreement) -> bool:
    """Whether a pose explains clearly fewer pixels of a frame than the best of others."""
    if not others:
        return False
    best = max(others, key=lambda other: other.support)
    # Counts vary by their roots.
    slack = _BEATEN_SD * float(np.sqrt(agreement.conflict + best.conflict)) + _BEATEN_SD
    return best.support - agreement.support > slack


def refine_pose(
    T_cam_model: FloatArray, perceived: PerceivedFrame, reader: FrameReader
) -> SingleFramePose | None:
    """The pose that the faces measured about a hypothesis (4, 4) give; None when there are none.

    In area-weighted mode the frame is read anew from every better pose, which knows the planes
    that RANSAC may have missed or made up; in paper mode the faces are those RANSAC found.
    """
    view = View(perceived, [], [])
    estimate: SingleFramePose | None = None
    for attempt in range(_PASSES):
        # A hypothesis can be off by pixels; a pose fitted to all faces is not.
        trust = Trust.PLANES if attempt == 0 else Trust.PIXELS
        if reader.depends_on_pose:
            view = reader.read(perceived.frame, T_cam_model, trust)
        else:
            view = reader.read_again(view, T_cam_model)
        if not view.faces:
            break
        before, estimate = estimate, fuse_faces(view.faces, T_cam_model, reader.diameter_m)
        T_cam_model = estimate.T_cam_model
        if before is not None and _is_still(before, estimate):
            estimate = replace(estimate, converged=True)
            break
    if estimate is None:
        return None
    return replace(estimate, agreement=reader.score(perceived.frame, T_cam_model))


def fuse_faces(
    faces: Sequence[MeasuredFace], T_cam_model: FloatArray, diameter_m: float
) -> SingleFramePose:
    """The pose that fits the measured faces that agree best.

    Args:
        faces: at least one.
        T_cam_model: (4, 4) where to start.
        diameter_m: of the target; the scale of the prior.
    """
    used = agreeing_faces(faces, T_cam_model, diameter_m)
    kept = {id(face) for face in used}
    rejected = [face.rectangle.name for face in faces if id(face) not in kept]
    kalman = _fused(used, T_cam_model, diameter_m)
    covariance = kalman.covariance[np.ix_(_POSE, _POSE)]
    names = tuple(face.rectangle.name for face in used)
    pose = kalman.state.T_cam_model(np.eye(4), np.eye(3))
    silent = Agreement(0, 0)
    return SingleFramePose(pose, covariance, silent, names, tuple(rejected), converged=False)


def agreeing_faces(
    faces: Sequence[MeasuredFace], T_cam_model: FloatArray, diameter_m: float
) -> list[MeasuredFace]:
    """The measured faces of one frame that agree on a pose. Arguments as for `fuse_faces`."""

    def excess(used: list[MeasuredFace]) -> list[float]:
        found = []
        for face in used:
            others = _fused([f for f in used if f is not face], T_cam_model, diameter_m)
            squared, degrees = others.innovation(_measurement(face))
            found.append(squared / innovation_gate(GATE_PROBABILITY, degrees))
        return found

    return consistent(faces, excess)


def _fused(
    faces: Sequence[MeasuredFace], T_cam_model: FloatArray, diameter_m: float
) -> ErrorStateFilter[NavigationState]:
    state = NavigationState(
        r_hill=T_cam_model[:3, 3],
        v_hill=np.zeros(3),
        com_model=np.zeros(3),
        R_world_body=T_cam_model[:3, :3],
        omega_body=np.zeros(3),
        inertia_ratios=BALL,
    )
    sd = np.full(STATE_SIZE, _HELD_SD)
    sd[R_HILL], sd[THETA_BODY] = _POSITION_SD_FRACTION * diameter_m, _ATTITUDE_SD_RAD
    # The prior is uninformative: no measurement is gated against it.
    kalman = ErrorStateFilter(
        state, np.diag(sd**2), gate_probability=1.0 - 1e-15, max_iterations=10
    )
    kalman.update([_measurement(face) for face in faces])
    return kalman


def _measurement(face: MeasuredFace) -> RectangleMeasurement:
    return RectangleMeasurement.of(face, np.eye(4), np.eye(3))


def _is_still(before: SingleFramePose, after: SingleFramePose) -> bool:
    sd = np.sqrt(np.diag(after.covariance))
    shift = after.T_cam_model[:3, 3] - before.T_cam_model[:3, 3]
    turn = log_rotation(before.T_cam_model[:3, :3].T @ after.T_cam_model[:3, :3])
    return bool(np.all(np.abs(np.concatenate([shift, turn])) < _STILL_SHARE * sd))
