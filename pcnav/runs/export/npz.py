"""NPZ: every array of a run in one file of NumPy."""

import io

import numpy as np
import numpy.typing as npt

from pcnav.runs.export.content import Export, Files
from pcnav.runs.export.pose_covariance import pose_covariances

ABOUT = (
    "Every array of the run, frames first: time_s, stamp_s, status, T_cam_model (4 x 4, m), the "
    "states by name (r_hill, v_hill, theta_body as R_world_body, omega_body, com_model, "
    "inertia_ratios), covariance and sd in the order of `layout`, pose_covariance (position, then "
    "rotation about the camera's axes), nis, the estimator's own notes, T_cam_world, and the truth "
    "as true_... where there is one. nan where a frame has no value."
)


def write_npz(export: Export) -> Files:
    """All there is; only what was estimated in any frame has an array."""
    run, motion = export.run, export.run.trajectory
    arrays: dict[str, npt.NDArray[np.generic]] = {
        "time_s": run.time_s,
        "stamp_s": export.stamps_s(run.time_s),
        "status": np.array(run.status),
        "layout": np.array([name for b in motion.layout.blocks for name in b.error_columns]),
        "nis": run.nis,
        "nis_dof": run.nis_dof,
        "window_nis": run.window_nis,
        **motion.values,
        **run.notes,
        **{name: np.array(words) for name, words in run.words.items()},
    }
    optional = {
        "T_cam_model": motion.T_cam_target,
        "sd": motion.sd,
        "covariance": motion.covariance,
        "pose_covariance": pose_covariances(export),
        "true_T_cam_model": export.true_poses_at(np.arange(len(run))),
    }
    recording, truth = export.recording, export.truth
    if recording is not None:
        optional |= {"T_cam_world": recording.T_cam_world, "recording_time_s": recording.times_s}
    if truth is not None:
        optional |= {"true_time_s": truth.time_s}
        optional |= {f"true_{name}": values for name, values in truth.values.items()}
    arrays |= {name: array for name, array in optional.items() if array is not None}
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    return {"": stream.getvalue()}
