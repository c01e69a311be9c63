"""The covariance of the pose in the camera, from that of the state a run stores."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION
from pcnav.dynamics.orbit import R_hill_world
from pcnav.runs.export.content import Export


def pose_covariances(export: Export) -> FloatArray | None:
    """(n, 6, 6) of T_cam_model, nan without an estimate: the order of ROS's PoseWithCovariance.

    Position x, y, z (m), then rotation about the camera's fixed x, y, z (rad). From
    ``p_cam = R_cam_hill r - R_cam_body com`` and ``R_cam_body exp(theta)``. None where the run has
    no such state, or the orbit of its recording is not known.
    """
    motion = export.run.trajectory
    layout, P, poses = motion.layout, motion.covariance, motion.T_cam_target
    if P is None or poses is None or export.recording is None:
        return None
    if not all(block in layout for block in (POSITION, ATTITUDE, CENTRE)):
        return None
    rate = export.recording.info.mean_motion_rad_s
    R_cam_body = poses[:, :3, :3]
    R_cam_world = R_cam_body @ np.swapaxes(motion[ATTITUDE], 1, 2)
    R_world_hill = np.stack([R_hill_world(t, rate).T for t in motion.time_s.tolist()])
    jacobian = np.zeros((len(motion), 6, layout.size))
    jacobian[:, :3, layout.slice_of(POSITION)] = R_cam_world @ R_world_hill
    jacobian[:, :3, layout.slice_of(CENTRE)] = -R_cam_body
    jacobian[:, :3, layout.slice_of(ATTITUDE)] = R_cam_body @ skew(motion[CENTRE])
    jacobian[:, 3:, layout.slice_of(ATTITUDE)] = R_cam_body
    return np.asarray(jacobian @ P @ np.swapaxes(jacobian, 1, 2))
