"""CCSDS AEM 1.0 (504.0-B-1): how the target is turned."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.runs.export.ccsds import epochs, header, numbers, object_name, relative_frame
from pcnav.runs.export.content import Export, Files

ABOUT = (
    "Attitude ephemeris message in KVN: quaternions, scalar last, that carry the axes of "
    "REF_FRAME_A (RTN of the chaser, or WORLD in a laboratory) into the target's body axes "
    "(SC_BODY_1, parallel to the model's), UTC: v_A = R(q) v_B."
)


def write_aem(export: Export) -> Files:
    """Raises `InputError` for a run without attitudes, an orbit or an epoch."""
    frames = np.flatnonzero(export.shown)
    if not len(frames):
        raise InputError(export.source, "states", "expected an estimate in at least one frame")
    axes, stamps = relative_frame(export), epochs(export, frames)
    times = export.run.time_s[frames].tolist()
    R_frame_world = np.stack([axes.R_frame_world(time_s) for time_s in times])
    quaternions = xyzw_from_rotation(R_frame_world @ _attitudes(export)[frames])
    for k in range(1, len(quaternions)):
        # Readers interpolate: the sign must not jump.
        if quaternions[k] @ quaternions[k - 1] < 0.0:
            quaternions[k] *= -1.0
    comments = (*axes.comments, "SC_BODY_1: axes of the target's mesh at its mass centre")
    lines = [
        *header("AEM", "1.0"),
        "META_START",
        *(f"COMMENT {comment}" for comment in comments),
        f"OBJECT_NAME = {object_name(export)}",
        "OBJECT_ID = UNKNOWN",
        f"REF_FRAME_A = {axes.name}",
        "REF_FRAME_B = SC_BODY_1",
        "ATTITUDE_DIR = A2B",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {stamps[0]}",
        f"STOP_TIME = {stamps[-1]}",
        "ATTITUDE_TYPE = QUATERNION",
        "QUATERNION_TYPE = LAST",
        "META_STOP",
        "",
        "DATA_START",
        *(f"{stamp} {numbers(q)}" for stamp, q in zip(stamps, quaternions, strict=True)),
        "DATA_STOP",
    ]
    return {"": ("\n".join(lines) + "\n").encode()}


def _attitudes(export: Export) -> FloatArray:
    """(n, 3, 3) R_world_body: as estimated, or of poses seen from known cameras."""
    motion, recording = export.run.trajectory, export.recording
    if ATTITUDE in motion:
        return motion[ATTITUDE]
    if motion.T_cam_target is None or recording is None or len(recording) != len(motion):
        raise InputError(export.source, "states", "expected a run that estimates attitudes")
    R_world_cam = np.swapaxes(recording.T_cam_world[:, :3, :3], 1, 2)
    return np.asarray(R_world_cam @ motion.T_cam_target[:, :3, :3])
