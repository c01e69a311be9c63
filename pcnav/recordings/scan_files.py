"""Scans in the recordings we write: the beams of all of them once, and files of ranges.

scan.npz              rays (n, 3), z = 1, camera frame · time_s (n,) · camera: width, height, fx,
                      fy, cx, cy (px) of the grid that they are laid over
depth/000000.npy      ranges (n,), m, floats; 0 = no return
depth/000000.npz      of a scan with beams of its own: rays, time_s, range_m
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.recordings.array_files import ArrayFile
from pcnav.recordings.frame_checks import checked_camera
from pcnav.recordings.scan import Scan
from pcnav.recordings.sequence import Frame

SCAN_FILE = "scan.npz"
_MAX_BEAMS, _MAX_PIXELS = 20_000_000, 16_777_216
_SUFFIXES = (".npy", ".npz")


@dataclass(frozen=True)
class ScanTable:
    """What scan.npz holds."""

    rays: FloatArray
    """(n, 3) z = 1."""
    time_s: FloatArray
    """(n,) from the time of a scan on."""
    camera: PinholeCamera

    @property
    def lasts_s(self) -> float:
        """From the first beam to the last."""
        return float(np.ptp(self.time_s)) if len(self.time_s) else 0.0

    def read(self, path: Path) -> Scan:
        """One scan. Raises `InputError`."""
        arrays = ArrayFile(path)
        if path.suffix.lower() == ".npz":
            rays = _rays(path, arrays)
            return Scan(rays, _ranges(path, arrays, "range_m", len(rays)), _times(path, arrays))
        return Scan(self.rays, _ranges(path, arrays, "array", len(self.rays)), self.time_s)


def read_scan_table(path: Path) -> ScanTable:
    """Raises `InputError` for a file that is not what it should be."""
    arrays = ArrayFile(path)
    rays, time_s = _rays(path, arrays), _times(path, arrays)
    if len(time_s) != len(rays):
        raise InputError(path, "time_s", f"expected {len(rays)} numbers, one a ray")
    numbers = _floats(path, arrays, "camera")
    if (
        numbers.shape != (6,)
        or not np.isfinite(numbers).all()
        or (numbers[:2] < 1.0).any()
        or (numbers[2:4] <= 0.0).any()
    ):
        raise InputError(path, "camera", "expected width, height, fx, fy, cx, cy")
    if numbers[0] * numbers[1] > _MAX_PIXELS:
        raise InputError(path, "camera", f"expected at most {_MAX_PIXELS:,} pixels")
    width, height = numbers[:2].astype(int).tolist()
    camera = PinholeCamera(width, height, *numbers[2:].tolist())
    checked_camera(str(path), camera)
    return ScanTable(rays, time_s, camera)


def scan_of(folder: Path, stem: str, present: set[str]) -> str | None:
    """Name of the one file of a scan among the files of a folder; None where there is none."""
    found = [stem + suffix for suffix in _SUFFIXES if stem + suffix in present]
    if len(found) > 1:
        raise InputError(folder, stem, f"expected one file of each scan, got {' and '.join(found)}")
    return found[0] if found else None


class ScanWriter:
    """Writes the scans of a recording: their beams once, as far as they are the same."""

    def __init__(self, folder: Path) -> None:
        """``folder`` is that of the recording."""
        self._folder = folder
        self._table: tuple[Scan, PinholeCamera] | None = None

    def write(self, frame: Frame, path_without_suffix: Path) -> None:
        """One scan."""
        assert frame.beams is not None, "it is a scan"
        scan = Scan.of(frame.beams)
        if self._table is None:
            self._table = scan, frame.camera
            camera = frame.camera
            numbers = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]
            np.savez_compressed(
                self._folder / SCAN_FILE, rays=scan.rays, time_s=scan.time_s, camera=numbers
            )
        ranges = scan.range_m.astype(np.float32)
        first = self._table[0]
        if np.array_equal(first.rays, scan.rays) and np.array_equal(first.time_s, scan.time_s):
            np.save(path_without_suffix.with_suffix(".npy"), ranges)
            return
        path = path_without_suffix.with_suffix(".npz")
        np.savez_compressed(path, rays=scan.rays, time_s=scan.time_s, range_m=ranges)


def _floats(path: Path, arrays: ArrayFile, name: str) -> FloatArray:
    headers: Mapping[str, object] = arrays.headers
    if name not in headers:
        have = ", ".join(sorted(headers))[:200] or "nothing"
        raise InputError(path, name, f"expected an array of this name, got {have}")
    found = arrays.whole(name)
    if found.dtype.kind not in "uif" or found.size > 3 * _MAX_BEAMS:
        raise InputError(path, name, f"expected numbers, got {found.dtype} {found.shape}")
    return np.asarray(found, dtype=np.float64)


def _rays(path: Path, arrays: ArrayFile) -> FloatArray:
    rays = _floats(path, arrays, "rays")
    if rays.ndim != 2 or rays.shape[1] != 3 or not len(rays) or not np.isfinite(rays).all():
        raise InputError(path, "rays", f"expected finite (n, 3), got {rays.shape}")
    if (rays[:, 2] <= 0.0).any():
        raise InputError(path, "rays", "expected rays with z above 0")
    return rays / rays[:, 2:]


def _times(path: Path, arrays: ArrayFile) -> FloatArray:
    time_s = _floats(path, arrays, "time_s")
    if time_s.ndim != 1 or not np.isfinite(time_s).all():
        raise InputError(path, "time_s", f"expected finite numbers (n,), got {time_s.shape}")
    return time_s


def _ranges(path: Path, arrays: ArrayFile, name: str, n: int) -> FloatArray:
    found = _floats(path, arrays, name).ravel()
    if len(found) != n:
        raise InputError(path, name, f"expected {n} ranges, one a beam, got {len(found)}")
    return np.where(np.isfinite(found) & (found > 0.0), found, 0.0)
