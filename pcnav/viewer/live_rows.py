"""What the view is told of a run that goes on: what is known at its start, and every frame."""

from collections.abc import Mapping

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
)
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.tracks import TrackFrame, Tracks
from pcnav.runs.attitude_results import AttitudeFrame
from pcnav.runs.feature_estimate import FeatureEstimate
from pcnav.runs.feature_results import pose_in_rig, with_known_mass_centre
from pcnav.runs.image_results import image_status
from pcnav.runs.results import FrameEstimate
from pcnav.target.satellite import Target, load_target
from pcnav.viewer.frames import FrameStore
from pcnav.viewer.live import LiveRow, empty_track
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.other_runs import attitude_run, feature_run, image_run, shown_pose

_Values = Mapping[str, FloatArray | float]


def starting_depth_run(
    name: str, sequence: Sequence, target: Target, pipeline: Pipeline
) -> LoadedRun:
    """Of a run on depth frames that begins.

    The sequence is opened and the target loaded anew: readers and ray caster of the run are not
    shared with threads that draw.
    """
    own_target = load_target(target.mesh_path)
    own_sequence = open_sequence(sequence.path, target.mesh_path)
    return LoadedRun(
        name=name,
        track=empty_track(),
        counted="rectangles",
        records={},
        frames=FrameStore(own_sequence, own_target, pipeline.perception, pipeline.seed),
        target=own_target,
        orbit=KeplerOrbit(sequence.info.mean_motion_rad_s),
        evaluation=None,
        verdicts={},
    )


def starting_feature_run(name: str, tracks: Tracks) -> LoadedRun:
    """Of a run on stereo tracks that begins."""
    return feature_run(name, empty_track(), tracks.orbit)


def starting_image_run(name: str) -> LoadedRun:
    """Of a run on images of one camera that begins."""
    return image_run(name, empty_track())


def starting_attitude_run(name: str) -> LoadedRun:
    """Of a run on attitudes that begins."""
    return attitude_run(name, empty_track())


def depth_row(estimate: FrameEstimate) -> LiveRow:
    """A frame of a run on depth frames."""
    values: _Values = {
        "nis": estimate.nis,
        "nis_dof": float(estimate.nis_dof),
        "window_nis": estimate.window_nis,
        "inlier_ratio": estimate.inlier_ratio,
        "n_rectangles": float(estimate.n_rectangles),
    }
    state, P, T = estimate.state, estimate.covariance, estimate.T_cam_model
    if state is not None and P is not None and T is not None:
        values = {
            **values,
            "r_hill": state.r_hill,
            "v_hill": state.v_hill,
            "com_model": state.com_model,
            "R_world_body": state.R_world_body,
            "omega_body": state.omega_body,
            "inertia_ratios": state.inertia_ratios,
            "sd": _deviations(P),
            "T_cam_model": T,
            "position_covariance": P[R_HILL, R_HILL],
            "com_covariance": P[COM_MODEL, COM_MODEL],
        }
    return LiveRow(estimate.time_s, estimate.status, values, estimate.records)


def feature_row(tracks: Tracks, frame: TrackFrame, estimate: FeatureEstimate) -> LiveRow:
    """A frame of a run on stereo tracks."""
    values: _Values = {
        "nis": estimate.nis,
        "nis_dof": float(estimate.nis_dof),
        "n_rectangles": float(len(estimate.used)),
    }
    motion = estimate.motion
    if motion is not None:
        values = {
            **values,
            "r_hill": motion.r_hill,
            "v_hill": motion.v_hill,
            "com_model": np.zeros(3),
            "R_world_body": motion.R_world_body,
            "omega_body": motion.omega_body,
            "inertia_ratios": motion.inertia_ratios,
            "sd": with_known_mass_centre(_deviations(motion.covariance)),
            "T_cam_model": pose_in_rig(frame, tracks.orbit, motion),
            "position_covariance": motion.covariance[:3, :3],
        }
    return LiveRow(frame.time_s, str(estimate.status), values)


def image_row(frame: ChainFrame, measured: set[int]) -> LiveRow:
    """A frame of a run on images; see `image_status`. Rates are found when it has ended."""
    values: _Values = {"n_rectangles": float(frame.agreeing)}
    if frame.R_world_body is not None and frame.covariance is not None:
        sd = np.full(STATE_SIZE, np.nan)
        sd[THETA_BODY] = _deviations(frame.covariance)
        values = {**values, **_turned(frame.R_world_body, frame.R_cam_world), "sd": sd}
    return LiveRow(frame.time_s, image_status(frame, measured), values)


def attitude_row(frame: AttitudeFrame) -> LiveRow:
    """A frame of a run on attitudes."""
    values: _Values = {
        "nis": frame.nis,
        "nis_dof": 3.0 if np.isfinite(frame.nis) else 0.0,
        "n_rectangles": float(np.isfinite(frame.measured_sd)),
    }
    if np.isfinite(frame.omega_body[0]):
        sd = np.full(STATE_SIZE, np.nan)
        sd[THETA_BODY], sd[OMEGA_BODY], sd[INERTIA_RATIOS] = np.split(frame.sd, [3, 6])
        values = {
            **values,
            **_turned(frame.R_world_body, np.eye(3)),
            "omega_body": frame.omega_body,
            "inertia_ratios": frame.inertia_ratios,
            "sd": sd,
        }
    return LiveRow(frame.time_s, str(frame.status), values)


def _turned(R_world_body: FloatArray, R_cam_world: FloatArray) -> _Values:
    """Of a target whose place nobody knows: it is drawn before the camera."""
    return {
        "r_hill": np.zeros(3),
        "v_hill": np.zeros(3),
        "com_model": np.zeros(3),
        "R_world_body": R_world_body,
        "T_cam_model": shown_pose(R_cam_world @ R_world_body),
    }


def _deviations(covariance: FloatArray) -> FloatArray:
    return np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
