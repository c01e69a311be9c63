"""The depth filter as a subject: what a view of the target tells of its pose, view by view."""

import numpy as np

from pcnav.config.depth import PerceptionTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import STATE_SIZE, NavigationState
from pcnav.estimators.depth.first_state import start_covariance
from pcnav.estimators.depth.mass import prior_belief
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.pose_measurement import ObserverPose, PoseMeasurement, PoseReference
from pcnav.evaluation.observability.reported import DEPTH
from pcnav.evaluation.observability.subjects import Linearised, Subject, TargetMotion, timing_of
from pcnav.perception.render_compare import RenderComparer
from pcnav.recordings.sequence import SequenceInfo
from pcnav.target.satellite import Target

_SAME_ASPECT_RAD = 0.25
_SAME_RANGE = 0.15
"""Views this close to one that was compared tell as much of the pose; the range is relative."""
_SHARP_POSE = np.diag([1e-4] * 3 + [1e-4] * 3) ** 2
"""(6, 6) with which a pose is predicted by a track that has settled, m and rad."""


class Views:
    """Information (6, 6) of a depth frame about the pose it shows, by rendered views.

    A view is rendered and compared with itself (`pcnav.perception.render_compare`): what that would
    tell of an error of the pose is what a frame would. Aspects that are alike share one.
    """

    def __init__(
        self, target: Target, camera: PinholeCamera, range_sigma_m: float, table: PerceptionTable
    ) -> None:
        self.target = target
        self._comparer = RenderComparer(target, camera, range_sigma_m, modalities=table.modalities)
        self.lever_m = self._comparer.lever_m
        self._poses: list[FloatArray] = []
        self._known: list[FloatArray] = []

    def information(self, T_cam_model: FloatArray) -> FloatArray:
        """(6, 6) about the error of a pose (4, 4), as `FaceEvidence` has it."""
        if self._poses:
            poses = np.stack(self._poses)
            trace = np.einsum("kij,ij->k", poses[:, :3, :3], T_cam_model[:3, :3])
            shift = np.linalg.norm(poses[:, :3, 3] - T_cam_model[:3, 3], axis=1)
            near = shift < _SAME_RANGE * np.linalg.norm(T_cam_model[:3, 3])
            alike = np.where(near, trace, -np.inf)
            best = int(np.argmax(alike))
            if alike[best] > 1.0 + 2.0 * np.cos(_SAME_ASPECT_RAD):
                return self._known[best]
        found = self._comparer.compare_with_itself(T_cam_model, _SHARP_POSE)
        information = sum((face.information for face in found.faces), np.zeros((6, 6)))
        self._poses.append(T_cam_model)
        self._known.append(information)
        return information


def depth_subject(
    title: str,
    pipeline: Pipeline,
    about: SequenceInfo,
    views: Views,
    motion: TargetMotion,
    times_s: FloatArray,
    R_cam_hill: FloatArray,
) -> Subject[NavigationState]:
    """Of the depth filter.

    Args:
        title: of what is judged.
        pipeline: settings of the filter.
        about: orbit and prior knowledge of the recording.
        views: of the target and the camera.
        motion: the target at one time.
        times_s: (n,) of the frames.
        R_cam_hill: (3, 3) of a camera at the chaser's mass centre.
    """
    n, filtering = about.mean_motion_rad_s, pipeline.filter
    model = MassCentreModel(
        n, filtering.acceleration_psd_m2_s3, filtering.angular_acceleration_psd_rad2_s3
    )
    timing = timing_of(times_s, motion.state.omega_body)
    belief = prior_belief(views.target, about.initial, filtering)
    prior = start_covariance(
        motion.state.omega_body, belief.com_covariance_m2, belief.parameter_covariance
    )

    def sensor(seen: NavigationState, k: int) -> FloatArray:
        hill = R_hill_world(float(timing.times_s[k]), n)
        observer = ObserverPose(make_transform(R_cam_hill @ hill, np.zeros(3)), hill)
        pose = seen.T_cam_model(observer.T_cam_world, hill)
        information = views.information(pose)
        if not information.any():
            return np.zeros((0, STATE_SIZE))
        reference = PoseReference(pose, observer)
        measured = PoseMeasurement.from_information(
            reference, information, np.zeros(6), views.lever_m
        )
        return measured.jacobian(seen)

    linearised = Linearised(
        estimator="depth",
        reported=DEPTH,
        state=motion.state,
        propagate=model.propagate,
        sensor=sensor,
        prior=lambda state: prior,
        omega_body=lambda state: state.omega_body,
        inertia=motion.state.inertia,
        note="Every frame is compared with the rendered view; the camera keeps its direction in "
        "Hill axes.",
    )
    return Subject.of(title, motion.time_s, timing, linearised)
