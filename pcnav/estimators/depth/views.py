"""One frame as the tracker used it: measurements of the filter, and records for the result."""

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
        used = tuple(
            replace(record, outcome=ACCEPTED if accepted[face] else GATED)
            for record, face in zip(self.records, self.face_of_record, strict=True)
        )
        if result is not None and len(result.gates) == len(self.measurements):
            used = tuple(
                replace(record, squared_distance=result.nis[face], gate=result.gates[face])
                for record, face in zip(used, self.face_of_record, strict=True)
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
    measurements = tuple(
        PoseMeasurement.from_information(
            *(reference, *face.joint, lever_m),
            None if own is None else evidence_of_twist(comparison.seen, face),
        )
        for face in faces
    )
    return FrameView(
        frame,
        comparison.labels,
        measurements,
        tuple(_evidence_record(frame.time_s, faces[k], comparison.T_cam_model) for k in named),
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


def _evidence_record(time_s: float, face: FaceEvidence, T_cam_model: FloatArray) -> RectangleRecord:
    """The pose that one face alone would give, in the axes of its rectangle."""
    rectangle = face.rectangle
    assert rectangle is not None, "only faces on the catalogue have a record"
    # About the rectangle's own centre, where shifts and turns are told apart best.
    R_cam_rect = T_cam_model[:3, :3] @ rectangle.T_model_rect[:3, :3]
    p = rectangle.T_model_rect[:3, 3]
    to_model = np.zeros((6, 6))
    R_model_rect = rectangle.T_model_rect[:3, :3]
    to_model[:3, :3] = R_cam_rect
    # The model origin moves by -theta x p when the body turns about the rectangle's centre.
    to_model[:3, 3:] = T_cam_model[:3, :3] @ skew(p) @ R_model_rect
    to_model[3:, 3:] = R_model_rect
    prior = np.eye(6) / _UNKNOWN_SD**2
    covariance = np.linalg.inv(to_model.T @ face.information @ to_model + prior)
    error_rect = covariance @ (to_model.T @ face.vector)
    error = to_model @ error_rect
    sd = np.sqrt(np.diag(covariance))
    known = sd < 0.5 * _UNKNOWN_SD
    return RectangleRecord(
        time_s=time_s,
        rectangle=rectangle.name,
        length_m=rectangle.length_m,
        width_m=rectangle.width_m,
        T_cam_rect=moved_pose(T_cam_model, error) @ rectangle.T_model_rect,
        sd=np.where(known, sd, np.inf),
        case="I",
        outcome="",
        worst_axis=AXES[int(np.argmax(np.where(known, np.abs(error_rect) / sd, -1.0)))]
        if known.any()
        else "",
    )
