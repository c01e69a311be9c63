"""Where the beams of simulated scans look, and when."""

from dataclasses import dataclass

import numpy as np

from pcnav.config.scan import ScanPattern, ScanTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays


@dataclass(frozen=True)
class Pattern:
    """The beams of every scan of a sensor, in rows and columns."""

    rays: FloatArray
    """(rows, columns, 3) camera frame, z = 1."""
    time_s: FloatArray
    """(rows, columns) from the time of the frame on."""


def pattern_of(table: ScanTable, camera: PinholeCamera) -> Pattern:
    """The pattern of a table, over the field of view of a camera."""
    if table.pattern is ScanPattern.ROSETTE:
        return _rosette(table, camera)
    if table.pattern is ScanPattern.RINGS:
        return _rings(table, camera)
    rays = pixel_rays(camera)
    n = camera.height * camera.width
    time_s = np.zeros(rays.shape[:2])
    if table.pattern is ScanPattern.RASTER:
        time_s = table.duration_s * (np.arange(n) / max(n - 1, 1) - 0.5).reshape(time_s.shape)
    return Pattern(rays, time_s)


def _rosette(table: ScanTable, camera: PinholeCamera) -> Pattern:
    """Two prisms that bend by the same angle: their deflections add up as vectors."""
    n = table.beams
    share = (np.arange(n) + 0.5) / n
    reach = 0.5 * camera.width / camera.fx
    first, second = (2.0 * np.pi * turns * share for turns in table.prism_turns)
    x = 0.5 * reach * (np.cos(first) + np.cos(second))
    y = 0.5 * reach * (np.sin(first) + np.sin(second))
    rays = np.stack([x, y, np.ones(n)], axis=-1)[None]
    return Pattern(rays, table.duration_s * (share - 0.5)[None])


def _rings(table: ScanTable, camera: PinholeCamera) -> Pattern:
    """A spinning sensor whose axis is image down; clockwise as seen from above."""
    half = np.arctan(0.5 * camera.width / camera.fx)
    step = np.deg2rad(table.azimuth_step_deg)
    columns = int(half / step)
    azimuth = step * np.arange(-columns, columns + 1)
    span = 0.5 * np.deg2rad(table.ring_fov_deg)
    elevation = np.linspace(-span, span, table.rings) if table.rings > 1 else np.zeros(1)
    x = np.broadcast_to(np.tan(azimuth), (table.rings, len(azimuth)))
    y = np.tan(elevation)[:, None] / np.cos(azimuth)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1)
    time_s = table.duration_s * azimuth / (2.0 * np.pi)
    return Pattern(rays, np.broadcast_to(time_s, x.shape).copy())


def cone_about(rays: FloatArray, divergence_rad: float, rings: int = 2) -> list[FloatArray]:
    """Rays (..., 3), z = 1, that share a beam evenly: its middle, and ``rings`` circles in it."""
    x, y, z = (rays[..., k] for k in range(3))
    length = np.sqrt(x * x + y * y + z * z)
    unit = rays / length[..., None]
    # Two directions across each ray.
    across = np.cross(unit, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    down = np.cross(unit, across)
    found = [rays]
    # Areas alike: 1 in the middle, 6 k on the k-th of the circles of equal width about it.
    width = 0.5 * divergence_rad / (rings + 0.5)
    for k in range(1, rings + 1):
        for j in range(6 * k):
            angle = 2.0 * np.pi * j / (6 * k)
            off = k * width * (np.cos(angle) * across + np.sin(angle) * down)
            there = unit + off
            found.append(there / there[..., 2:])
    return found
