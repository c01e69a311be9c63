"""Clouds without the rows and columns of a pinhole camera, as scans.

What is known of such a cloud is its returns alone: no beam is known that returned nothing. The
pixels are those of a camera in the sensor, over the directions in which the first clouds have
returns and as far beyond them again.
"""

import logging
from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcnav.config.recording import RecordingTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.recordings.assembling import Parts, assembled
from pcnav.recordings.cloud import Cloud, has_returned, times_of_scan
from pcnav.recordings.cloud_axes import CloudAxes
from pcnav.recordings.depth_camera import DepthCamera
from pcnav.recordings.depth_image import ImageSize, StoredDepth
from pcnav.recordings.scan import Scan, grid_of, grid_over
from pcnav.recordings.sequence import Sequence

_LOG = logging.getLogger("pcnav")
_MIN_POINTS = 100
_MIN_COSINE = 0.17
"""To the camera's axis: what lies more than 80 degrees off is left out."""
_MAX_SLOPE = 2.75
"""Of the field of view: 70 degrees to each side."""
_MAX_SIDE = 2048


@dataclass(frozen=True)
class CloudScans:
    """How the clouds of a sensor become scans."""

    axes: CloudAxes
    camera: PinholeCamera
    unit_m: float
    lasts_s: float
    """Of the first cloud; 0 where its points have no times."""

    @staticmethod
    def of(
        path: Path, clouds: Many[Cloud], stated: CloudAxes | None, unit_m: float | None
    ) -> "CloudScans":
        """By the first clouds of a recording, which a doubt about them is said of.

        Raises `InputError` where these have hardly any return before the sensor.
        """
        points = [cloud.points[has_returned(cloud.points)] for cloud in clouds]
        points = [each for each in points if len(each) >= _MIN_POINTS]
        if not points:
            expected = f"expected at least {_MIN_POINTS} points in one of the first clouds"
            raise InputError(path, "points", expected)
        axes = stated or CloudAxes.guessed(np.concatenate(points))
        rays = [_seen(each @ axes.R_cam_cloud.T)[0] for each in points]
        many = max(rays, key=len)
        if len(many) < _MIN_POINTS:
            expected = f'expected points before the sensor with axes = "{axes}"'
            raise InputError(path, "sensor.axes", expected)
        if stated is None:
            said = "%s: the axes of the clouds are taken for those of a %s ([sensor] axes says it)"
            _LOG.warning(said, path, axes)
        pitch = 1.0 / grid_of(many[None]).fx
        camera = grid_over(np.concatenate(rays)[:, :2], pitch, _MAX_SLOPE, _MAX_SIDE)
        lasts = [_times(path, cloud).max(initial=0.0) for cloud in clouds]
        return CloudScans(axes, camera, unit_m or 1.0, float(max(lasts)))

    @property
    def depth_camera(self) -> DepthCamera:
        """The pixels that they are laid over."""
        camera = self.camera
        size = ImageSize(camera.width, camera.height)
        return DepthCamera((camera.fx, camera.fy, camera.cx, camera.cy), size, None)

    def scan(self, path: Path, cloud: Cloud) -> Scan:
        """One cloud. Raises `InputError`, which names the path, for times that are none."""
        returned = has_returned(cloud.points)
        points = self.unit_m * cloud.points[returned] @ self.axes.R_cam_cloud.T
        rays, range_m, ahead = _seen(points)
        return Scan(rays, range_m, _times(path, cloud)[returned.ravel()][ahead])


def scans_assembled(
    parts: Parts,
    target_mesh: Path | None,
    table: RecordingTable,
    skip_bad_frames: bool,
    scans: CloudScans,
    read: Callable[[Path], Cloud],
) -> Sequence:
    """The recording whose clouds are read so; see `assembled`. Raises `InputError`."""

    def read_scan(path: Path) -> Scan:
        return scans.scan(path, read(path))

    def read_image(path: Path) -> StoredDepth:
        return read_scan(path).on(scans.camera).image

    imaged = replace(parts, read_image=read_image)
    found = assembled(imaged, target_mesh, table, skip_bad_frames)
    info = replace(found.info, scan_s=scans.lasts_s, row_readout_s=0.0)
    return replace(found, info=info, read_scan=read_scan)


def _times(path: Path, cloud: Cloud) -> FloatArray:
    """(n,) from the time of the cloud, that of its first point, on."""
    n = cloud.points.shape[0] * cloud.points.shape[1]
    if cloud.time is None:
        return np.zeros(n)
    returned = has_returned(cloud.points).ravel()
    time = cloud.time.ravel()
    if not returned.any():
        return np.zeros(n)
    if not np.isfinite(time[returned]).all():
        raise InputError(path, "time", "expected a finite one of every point")
    try:
        found, _ = times_of_scan(np.where(returned, time, time[returned].min()))
    except ValueError as error:
        raise InputError(path, "time", str(error)) from error
    return found


def _seen(points: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Rays (k, 3), z = 1, and ranges (k,) of those of points (n, 3) that lie ahead, and which these
    are."""
    range_m = np.linalg.norm(points, axis=1)
    ahead = np.flatnonzero(points[:, 2] > _MIN_COSINE * range_m)
    rays = points[ahead] / points[ahead, 2:]
    return rays, range_m[ahead], ahead
