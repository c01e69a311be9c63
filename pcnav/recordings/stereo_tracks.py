"""A recording of feature tracks of a stereo rig as a folder.

tracks.csv           time_s, feature, u_left, v_left, u_right, v_right, see
                     `pcnav.recordings.tracks`
rig.toml             [rig], [orbit] and, for a rig fixed in Hill axes, [pointing]
camera_attitude.csv  optional, of the left camera, see `pcnav.recordings.attitudes`; replaces
                     [pointing]
truth.csv            optional, see `pcnav.recordings.truth`
truth_features.csv   optional: feature, x_m, y_m, z_m in the true body axes from the mass centre
"""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
import tomli_w
from pydantic import Field, Strict

from pcnav.config.table import Direction, Pixels, Positive, StrictTable, Vector2
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import R_cam_hill
from pcnav.core.errors import InputError
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.csv_table import read_csv, write_csv
from pcnav.files.new_folder import new_folder
from pcnav.files.toml_file import read_toml_model
from pcnav.recordings.attitudes import (
    CAMERA_ATTITUDE_FILE,
    has_camera_attitudes,
    read_camera_attitudes,
    write_camera_attitudes,
)
from pcnav.recordings.tracks import (
    TRACKS_FILE,
    StereoTracks,
    TrackFrame,
    attitudes_of,
    frames_of,
    tracks_folder,
    write_track_table,
)
from pcnav.recordings.truth import write_truth

RIG_FILE = "rig.toml"
TRUTH_FEATURES_FILE = "truth_features.csv"

_TRACK_COLUMNS = ("time_s", "feature", "u_left", "v_left", "u_right", "v_right")
_POINT_COLUMNS = ("feature", "x_m", "y_m", "z_m")


class _RigTable(StrictTable):
    baseline_m: Positive
    focal_px: Positive
    centre_px: Vector2
    size_px: Annotated[tuple[Pixels, Pixels], Strict(False)]
    pixel_sigma_px: Positive


class _OrbitTable(StrictTable):
    mean_motion_rad_s: Annotated[float, Field(ge=0.0)] = 0.0
    eccentricity: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    true_anomaly_deg: float = 0.0


class _PointingTable(StrictTable):
    boresight_hill: Direction


class _RigFile(StrictTable):
    rig: _RigTable
    orbit: _OrbitTable = _OrbitTable()
    pointing: _PointingTable | None = None


def read_stereo_tracks(path: Path) -> StereoTracks:
    """Read a recording from its folder or its tracks.csv.

    Raises `InputError`, which names the file and line, for missing files and columns, numbers that
    are not finite, times out of order, a feature twice at a time, disparities that are not
    positive and a rig without attitude.
    """
    folder = tracks_folder(path)
    if folder is None:
        raise InputError(path, "folder", f"expected a folder with {TRACKS_FILE}, or that file")
    content = read_toml_model(folder / RIG_FILE, _RigFile)
    anomaly = float(np.deg2rad(content.orbit.true_anomaly_deg))
    orbit = KeplerOrbit(content.orbit.mean_motion_rad_s, content.orbit.eccentricity, anomaly)
    table = read_csv(folder / TRACKS_FILE, _TRACK_COLUMNS)
    times_s, seen = frames_of(table, _TRACK_COLUMNS)
    disparity = -np.diff(table.numbers(("u_left", "u_right")), axis=1)[:, 0]
    positive = np.isnan(disparity) | (disparity > 0.0)
    table.require(positive, "expected a positive disparity u_left - u_right", "u_right")
    attitudes = _attitudes(folder, orbit, content.pointing, times_s)
    frames = tuple(
        TrackFrame(time_s, R, *features)
        for time_s, R, features in zip(times_s.tolist(), attitudes, seen, strict=True)
    )
    rig = StereoRig(**dict(content.rig))
    return StereoTracks(folder.resolve().name, rig, orbit, frames, folder)


def read_truth_features(folder: Path) -> dict[int, FloatArray] | None:
    """True points (3,) by feature, body axes, m; None where the recording has none.

    Raises `InputError`.
    """
    path = folder / TRUTH_FEATURES_FILE
    if not path.is_file():
        return None
    table = read_csv(path, _POINT_COLUMNS)
    numbers, points = table.counts("feature"), table.numbers(_POINT_COLUMNS[1:])
    table.require(np.asarray(np.isfinite(points).all(axis=1)), "expected finite numbers")
    if len(np.unique(numbers)) != len(numbers):
        raise InputError(path, "feature", "expected each feature once")
    return dict(zip(numbers.tolist(), points, strict=True))


def write_stereo_tracks(
    out: Path,
    tracks: StereoTracks,
    truth: Trajectory | None = None,
    points: FloatArray | None = None,
    overwrite: bool = False,
) -> None:
    """Write a recording; the folder appears, whole, at the end.

    ``points`` (N, 3) are the true features, numbered from 0, where known. Raises `InputError` for a
    folder that must not be replaced.
    """
    orbit = {
        "mean_motion_rad_s": tracks.orbit.mean_motion_rad_s,
        "eccentricity": tracks.orbit.eccentricity,
        "true_anomaly_deg": float(np.rad2deg(tracks.orbit.true_anomaly_rad)),
    }
    with new_folder(out, overwrite, TRACKS_FILE) as folder:
        # Without [pointing]: the attitude of every frame is stored beside it.
        text = tomli_w.dumps({"rig": asdict(tracks.rig), "orbit": orbit})
        (folder / RIG_FILE).write_text(text, encoding="utf-8")
        write_track_table(folder, _TRACK_COLUMNS, tracks)
        write_camera_attitudes(folder, *attitudes_of(tracks))
        write_truth(folder, truth)
        if points is not None:
            rows = ([i, *point] for i, point in enumerate(points.tolist()))
            write_csv(folder / TRUTH_FEATURES_FILE, _POINT_COLUMNS, rows)


def _attitudes(
    folder: Path, orbit: KeplerOrbit, pointing: _PointingTable | None, time_s: FloatArray
) -> FloatArray:
    """(n, 3, 3) R_cam_world at the times of the frames."""
    if has_camera_attitudes(folder):
        return read_camera_attitudes(folder, time_s)
    if pointing is None:
        expected = "expected boresight_hill of a rig fixed in Hill axes"
        expected += f", or a file {CAMERA_ATTITUDE_FILE}"
        raise InputError(folder / RIG_FILE, "pointing", expected)
    R_rig_hill = R_cam_hill(np.array(pointing.boresight_hill))
    return np.stack([R_rig_hill @ orbit.R_hill_world(float(t)) for t in time_s])
