"""Frames of the pipelines that do not answer in `Estimate` yet, for the view."""

from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.dynamics.blocks import (
    ATTITUDE,
    ATTITUDE_LAYOUT,
    MASS_CENTRE_LAYOUT,
    MOTION_LAYOUT,
    RATE,
    ROTATION_LAYOUT,
)
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.recordings.tracks import StereoTracks, TrackFrame
from pcnav.runs.attitude_results import AttitudeFrame
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.feature_estimate import FeatureEstimate
from pcnav.runs.feature_results import pose_in_rig
from pcnav.runs.image_results import image_status
from pcnav.runs.records import RectangleRecord
from pcnav.runs.results import FrameEstimate

DEPTH = Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True)
FEATURES = Output(MOTION_LAYOUT, notes=("n_used",), has_features=True)
IMAGES = Output(ATTITUDE_LAYOUT, (RATE,), notes=("agreeing",), has_nis=False)
ATTITUDES = Output(ROTATION_LAYOUT, notes=("sd_measured_rad",))


def of_recording(pipeline: Pipeline, recording: Path) -> Pipeline:
    """The pipeline as run."""
    return pipeline.model_copy(update={"sequence": str(recording.resolve())})


def depth_estimate(estimate: FrameEstimate) -> Estimate:
    """A frame of a run on depth frames."""
    state = estimate.state
    values = {}
    if state is not None:
        values = {
            "r_hill": state.r_hill,
            "v_hill": state.v_hill,
            "com_model": state.com_model,
            "theta_body": state.R_world_body,
            "omega_body": state.omega_body,
            "inertia_ratios": state.inertia_ratios,
        }
    return Estimate(
        time_s=estimate.time_s,
        status=estimate.status,
        values=values,
        covariance=estimate.covariance,
        T_cam_target=estimate.T_cam_model,
        nis=estimate.nis,
        nis_dof=estimate.nis_dof,
        window_nis=estimate.window_nis,
        notes={
            "inlier_ratio": float(estimate.inlier_ratio),
            "n_rectangles": estimate.n_rectangles,
        },
        records=tuple(RectangleRecord(**vars(record)) for record in estimate.records),
    )


def feature_estimate(
    tracks: StereoTracks, frame: TrackFrame, estimate: FeatureEstimate
) -> Estimate:
    """A frame of a run on stereo tracks."""
    motion = estimate.motion
    answer = Estimate(
        time_s=frame.time_s,
        status=str(estimate.status),
        nis=estimate.nis,
        nis_dof=estimate.nis_dof,
        notes={"n_used": len(estimate.used)},
    )
    if motion is None:
        return answer
    values = {
        "r_hill": motion.r_hill,
        "v_hill": motion.v_hill,
        "theta_body": motion.R_world_body,
        "omega_body": motion.omega_body,
        "inertia_ratios": motion.inertia_ratios,
    }
    known = {"values": values, "covariance": motion.covariance}
    pose = pose_in_rig(frame, tracks.orbit, motion)
    return Estimate(**{**vars(answer), **known, "T_cam_target": pose})


def image_estimate(frame: ChainFrame, measured: set[int]) -> Estimate:
    """A frame of a run on images; see `image_status`. Rates are found when it has ended."""
    known = frame.R_world_body is not None and frame.covariance is not None
    return Estimate(
        time_s=frame.time_s,
        status=image_status(frame, measured),
        values={ATTITUDE.name: frame.R_world_body} if frame.R_world_body is not None else {},
        covariance=frame.covariance if known else None,
        notes={"agreeing": frame.agreeing},
    )


def attitude_estimate(frame: AttitudeFrame) -> Estimate:
    """A frame of a run on attitudes."""
    known = bool(np.isfinite(frame.omega_body[0]))
    values = {
        "theta_body": frame.R_world_body,
        "omega_body": frame.omega_body,
        "inertia_ratios": frame.inertia_ratios,
    }
    return Estimate(
        time_s=frame.time_s,
        status=str(frame.status),
        values=values if known else {},
        covariance=frame.covariance if known else None,
        nis=frame.nis,
        nis_dof=3 if np.isfinite(frame.nis) else 0,
        notes={"sd_measured_rad": frame.measured_sd},
    )
