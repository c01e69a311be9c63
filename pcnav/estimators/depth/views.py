"""One frame as the tracker used it: measurements of the filter, and records for the result."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import make_transform, skew
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.mass_centre import RectangleMeasurement
from pcnav.estimators.depth.pose_measurement import (
    ObserverPose,
    PoseMeasurement,
    PoseReference,
    moved_pose,
)
from pcnav.filtering.error_state import Measurement, UpdateResult
from pcnav.perception.association import MeasuredFace, Unused
from pcnav.perception.face_evidence import FaceEvidence
from pcnav.perception.reading import View
from pcnav.perception.render_compare import Comparison
from pcnav.perception.twist_evidence import evidence_of_twist
from pcnav.recordings.sequence import Frame
from pcnav.runs.records import ACCEPTED, AXES, RectangleRecord

GATED = "failed the innovation gate"
_UNKNOWN_SD = 1.0
"""Of a face's own pose, m and rad: beyond this it is not measured."""


@dataclass(frozen=True)
class FrameView:
    """A frame and what was made of it."""

    frame: Frame
    image_labels: IntArray
    """(height, width) which face or segment each pixel was given to, -1 for none."""
    measurements: tuple[Measurement[NavigationState], ...]
    """One per face."""
    records: tuple[RectangleRecord, ...]
    """One per face that is a rectangle, in the order of `face_of_record`."""
    face_of_record: tuple[int, ...]
    unused: tuple[RectangleRecord, ...]
    inlier_ratio: float
    """Share of the frame that the pose in mind explains; nan where nothing was rendered."""
    shared: tuple[FloatArray, ...] = ()
    """Of each measurement, (m, k) how errors of unit variance that the frame shares enter it; none
    where there are no such errors."""
    comparison: Comparison | None = None
    """With the rendered view, where there was one."""
    T_cam_seen: FloatArray | None = None
    """(4, 4) where the frame shows the model to be in the camera, if that is known better than by
    way of the world: where the camera's recorded pose is noisy."""

    def without_faces(self, reason: str) -> "FrameView":
        """None of the faces used, and why."""
        out = tuple(replace(record, outcome=reason) for record in self.records)
        return replace(
            self,
            measurements=(),
            shared=(),
            records=(),
            face_of_record=(),
            unused=(*self.unused, *out),
            T_cam_seen=None,
        )

    def outcomes(
        self, accepted: tuple[bool, ...], result: UpdateResult | None = None
    ) -> tuple[RectangleRecord, ...]:
        """All records, given which faces the filter accepted, and how they fared in its gates."""
        count = len(self.measurements)
        if result is None or len(result.gates) != count:
            nis = gates = (np.nan,) * count
        else:
            nis, gates = result.nis, result.gates
        used = tuple(
            replace(
                record,
                outcome=ACCEPTED if accepted[face] else GATED,
                squared_distance=nis[face],
                gate=gates[face],
            )
            for record, face in zip(self.records, self.face_of_record, strict=True)
        )
        return used + self.unused


def silent_view(frame: Frame) -> FrameView:
    """A frame that was not measured."""
    labels = np.full(frame.depth_m.shape, -1, dtype=np.intp)
    return FrameView(frame, labels, (), (), (), (), float("nan"))


def view_of_rectangles(view: View, observer: ObserverPose) -> FrameView:
    """A frame read as rectangles."""
    time_s = view.frame.time_s
    T_cam_hill = observer.T_cam_world @ make_transform(observer.R_hill_world.T, np.zeros(3))
    measurements = tuple(
        RectangleMeasurement.of(face, T_cam_hill, observer.R_hill_world, observer.noise)
        for face in view.faces
    )
    return FrameView(
        view.frame,
        view.image_labels,
        measurements,
        tuple(_face_record(time_s, face) for face in view.faces),
        tuple(range(len(view.faces))),
        tuple(unused_record(time_s, unused) for unused in view.unused),
        view.inlier_ratio,
        tuple(m.shared for m in measurements) if observer.noise.is_there else (),
    )


def view_of_comparison(
    frame: Frame, comparison: Comparison, lever_m: float, observer: ObserverPose
) -> FrameView:
    """A frame compared with the rendered view."""
    faces = comparison.faces
    own = None if comparison.motion is None else comparison.motion.own
    reference = PoseReference(comparison.T_cam_model, observer, own)
    named = [k for k, face in enumerate(faces) if face.rectangle is not None]
    if own is None:
        each = PoseMeasurement.of_each(reference, [face.joint for face in faces], lever_m)
    else:
        each = [
            PoseMeasurement.from_information(
                *(reference, *face.joint, lever_m), evidence_of_twist(comparison.seen, face)
            )
            for face in faces
        ]
    measurements = tuple(
        measurement.considering(face.joint.information, face.by_unweighed, lever_m)
        for measurement, face in zip(each, faces, strict=True)
    )
    return FrameView(
        frame,
        comparison.labels,
        measurements,
        tuple(_records(frame.time_s, [faces[k] for k in named], comparison.T_cam_model)),
        tuple(named),
        (),
        comparison.agreement.inlier_ratio,
        tuple(m.shared for m in measurements if m.shared is not None),
        comparison,
    )


def _face_record(time_s: float, face: MeasuredFace) -> RectangleRecord:
    return RectangleRecord(
        time_s=time_s,
        rectangle=face.rectangle.name,
        length_m=face.length_m,
        width_m=face.width_m,
        T_cam_rect=face.T_cam_rect,
        sd=np.where(face.known, np.sqrt(np.diag(face.covariance)), np.inf),
        case=str(face.case),
        outcome="",
    )


def unused_record(time_s: float, unused: Unused) -> RectangleRecord:
    """A segment that gives no measurement."""
    observation = unused.seen.observation
    return RectangleRecord(
        time_s=time_s,
        rectangle="",
        length_m=observation.length_m,
        width_m=observation.width_m,
        T_cam_rect=observation.T_cam_rect,
        sd=np.sqrt(np.diag(observation.covariance)[:6]),
        case="",
        outcome=unused.reason,
    )


def _records(
    time_s: float, faces: Sequence[FaceEvidence], T_cam_model: FloatArray
) -> Iterator[RectangleRecord]:
    """The poses that faces, each alone, would give, in the axes of their rectangles.

    They are worked out together: of one, the calls take longer than the work.
    """
    rectangles = [face.rectangle for face in faces if face.rectangle is not None]
    assert len(rectangles) == len(faces), "only faces on the catalogue have a record"
    if not faces:
        return
    T_model_rect = np.stack([rectangle.T_model_rect for rectangle in rectangles])
    R_model_rect = T_model_rect[:, :3, :3]
    # About the rectangle's own centre, where shifts and turns are told apart best: the model origin
    # moves by -theta x p when the body turns about it.
    to_model = np.zeros((len(faces), 6, 6))
    to_model[:, :3, :3] = T_cam_model[:3, :3] @ R_model_rect
    to_model[:, :3, 3:] = T_cam_model[:3, :3] @ skew(T_model_rect[:, :3, 3]) @ R_model_rect
    to_model[:, 3:, 3:] = R_model_rect
    from_model = np.swapaxes(to_model, 1, 2)
    information = np.stack([face.information for face in faces])
    vector = np.stack([face.vector for face in faces])[..., None]
    prior = np.eye(6) / _UNKNOWN_SD**2
    covariance = np.linalg.inv(from_model @ information @ to_model + prior)
    error_rect = covariance @ (from_model @ vector)
    errors = (to_model @ error_rect)[..., 0]
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    known = sd < 0.5 * _UNKNOWN_SD
    worst = np.argmax(np.where(known, np.abs(error_rect[..., 0]) / sd, -1.0), axis=1).tolist()
    stated, is_some = np.where(known, sd, np.inf), np.any(known, axis=1).tolist()
    for k, rectangle in enumerate(rectangles):
        yield RectangleRecord(
            time_s=time_s,
            rectangle=rectangle.name,
            length_m=rectangle.length_m,
            width_m=rectangle.width_m,
            T_cam_rect=moved_pose(T_cam_model, errors[k]) @ rectangle.T_model_rect,
            sd=stated[k],
            case="I",
            outcome="",
            worst_axis=AXES[worst[k]] if is_some[k] else "",
        )
