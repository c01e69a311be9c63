"""A scan beside the view of a target: when and where each of its pixels looks."""

from functools import lru_cache

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.beams import Beams
from pcnav.core.camera import PinholeCamera
from pcnav.perception.outline_frame import OutlineFrame
from pcnav.target.row_motion import Exposure, Readout

_KEPT = 8


@lru_cache(maxsize=_KEPT)
def strided_beams(beams: Beams, stride: int) -> Beams:
    """`Beams.strided`, kept for the scans last asked about."""
    return beams.strided(stride)


def exposure_of_scan(
    beams: Beams, camera: PinholeCamera, T_cam_model: FloatArray, motion: Readout | None
) -> Exposure:
    """Of the pixels of a scan that shows a target at a pose (4, 4) and moving so; at rest where
    that is not known."""
    times_s = beams.slice_times_s
    if motion is None:
        poses = np.broadcast_to(T_cam_model, (len(times_s), 4, 4))
    else:
        poses = motion.poses(T_cam_model, times_s)
    return Exposure(poses, beams.slice_image, _image_rays(beams, camera), times_s=times_s)


@lru_cache(maxsize=_KEPT)
def _image_rays(beams: Beams, camera: PinholeCamera) -> FloatArray:
    rays = beams.image_rays(camera)
    rays.flags.writeable = False
    return rays


def outline_of_scan(
    beams: Beams, camera: PinholeCamera, depth_m: DepthImage, found: OutlineFrame | None
) -> OutlineFrame | None:
    """What the outline is read in: nowhere, where the beams are no grid or in no order."""
    if _shows_outline(beams, camera):
        return found
    return OutlineFrame(depth_m, np.ones(depth_m.shape, dtype=np.bool_))


@lru_cache(maxsize=_KEPT)
def _shows_outline(beams: Beams, camera: PinholeCamera) -> bool:
    return beams.shows_outline(camera)
