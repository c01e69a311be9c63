"""A result folder: the track of estimates over time, what was measured, and how to read it back.

The layout is DESIGN's; `result_writer` writes it. Numbers are stored with the fewest digits
that read back to the same float64; an empty field means "no value".
"""

import csv
import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform, rotation_from_xyzw, transform_points
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
)
from pcnav.files.csv_table import read_csv
from pcnav.recordings.truth import STATE_COLUMNS
from pcnav.runs.result_files import COVARIANCES_FILE as COVARIANCES_FILE
from pcnav.runs.result_files import KNOWLEDGE_FILE as KNOWLEDGE_FILE
from pcnav.runs.result_files import MEASUREMENTS_FILE as MEASUREMENTS_FILE
from pcnav.runs.result_files import METRICS_FILE as METRICS_FILE
from pcnav.runs.result_files import PIPELINE_FILE as PIPELINE_FILE
from pcnav.runs.result_files import POSES_FILE as POSES_FILE
from pcnav.runs.result_files import REPORT_FILE as REPORT_FILE
from pcnav.runs.result_files import STATES_FILE as STATES_FILE

ACCEPTED = "accepted"
"""The outcome of a rectangle that the filter used."""
NIS_WINDOW_FRAMES = 20
"""`FrameEstimate.window_nis` is taken over so many frames with an accepted measurement: enough to
tell a covariance off by half from chance, few enough to follow a run."""

_Q = ("q_x", "q_y", "q_z", "q_w")
_THETA = ("theta_x_rad", "theta_y_rad", "theta_z_rad")
_ERROR_NAMES = (*STATE_COLUMNS[1:7], *_THETA, *STATE_COLUMNS[11:])

SD_COLUMNS = tuple(f"sd_{name}" for name in _ERROR_NAMES)
"""The attitude has three standard deviations, about the body axes, for its four numbers."""
TRACK_COLUMNS = (
    *(*STATE_COLUMNS, *SD_COLUMNS, "status"),
    *("nis", "nis_dof", "window_nis", "inlier_ratio", "n_rectangles"),
)
POSE_COLUMNS = ("p_x_m", "p_y_m", "p_z_m", *_Q)
MEASUREMENT_COLUMNS = (
    "time_s",
    "rectangle",
    "length_m",
    "width_m",
    *POSE_COLUMNS,
    *(f"sd_{name}" for name in ("x_m", "y_m", "z_m", *_THETA)),
    "case",
    "outcome",
)
_TUM_FIELDS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_NORM_TOLERANCE = 1e-3
SD_ORDER: IntArray = np.r_[R_HILL, V_HILL, THETA_BODY, OMEGA_BODY, COM_MODEL, INERTIA_RATIOS]
"""Error-state index of each of `SD_COLUMNS`: the file lists the attitude before the mass centre."""


@dataclass(frozen=True)
class RectangleRecord:
    """One rectangle seen in one frame and what became of it: a row of measurements.csv."""

    time_s: float
    rectangle: str
    """Name in the catalogue; empty when it was not recognised."""
    length_m: float
    width_m: float
    T_cam_rect: FloatArray
    """(4, 4) measured pose of the rectangle frame, the ambiguity resolved as `case` says."""
    sd: FloatArray
    """(6,) standard deviations in rectangle axes: x, y, z (m), rotation about x, y, z (rad).
    Infinite where the measurement says nothing."""
    case: str
    """Which of the four proper rotations was chosen: I, X, Y or Z; empty when undecided."""
    outcome: str
    """`accepted`, or the reason why it was not."""

    @property
    def corners_cam(self) -> FloatArray:
        """(4, 3) corners in the camera frame, m: x along the width, y along the length."""
        x, y = 0.5 * self.width_m, 0.5 * self.length_m
        p_rect = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return transform_points(self.T_cam_rect, p_rect)


@dataclass(frozen=True)
class FrameEstimate:
    """What a run says after one frame.

    State, covariance and pose are there together or not at all; anything else raises
    ``ValueError``.
    """

    index: int
    time_s: float
    state: NavigationState | None
    """None while there is no estimate."""
    covariance: FloatArray | None
    """(20, 20), error-state order of DESIGN."""
    T_cam_model: FloatArray | None
    """(4, 4) estimated pose."""
    status: str
    nis: float
    """Normalised innovation squared of this frame's accepted measurements; nan without any."""
    nis_dof: int
    n_rectangles: int
    """Rectangles accepted."""
    records: tuple[RectangleRecord, ...]
    inlier_ratio: float = float("nan")
    """Share of the frame's evidence that the estimated pose explains, 0 to 1; nan when nothing
    was rendered to compare it with."""
    window_nis: float = float("nan")
    """Sum of the NIS over the sum of its degrees of freedom in the last `NIS_WINDOW_FRAMES` frames
    of the track with an accepted measurement, this one included; nan when there is none."""

    def __post_init__(self) -> None:
        absent = [value is None for value in (self.state, self.covariance, self.T_cam_model)]
        if any(absent) and not all(absent):
            raise ValueError(
                f"frame {self.index}: state, covariance and T_cam_model must be given together"
            )


@dataclass(frozen=True)
class Track:
    """A run's estimates over time, one row per frame; nan in frames without an estimate."""

    time_s: FloatArray
    """(n,)"""
    r_hill: FloatArray
    """(n, 3) target mass centre from the chaser's, Hill axes, m."""
    v_hill: FloatArray
    """(n, 3) m/s."""
    com_model: FloatArray
    """(n, 3) mass centre in the model frame, m."""
    R_world_body: FloatArray
    """(n, 3, 3)"""
    omega_body: FloatArray
    """(n, 3) rad/s."""
    inertia_ratios: FloatArray
    """(n, 5) Iyy, Izz, Ixy, Ixz, Iyz over Ixx."""
    sd: FloatArray
    """(n, 20) standard deviations in error-state order, SI and rad."""
    T_cam_model: FloatArray
    """(n, 4, 4)"""
    status: tuple[str, ...]
    """n words."""
    nis: FloatArray
    """(n,) nan in frames without an accepted measurement."""
    nis_dof: IntArray
    """(n,)"""
    window_nis: FloatArray
    """(n,) NIS per degree of freedom over the last frames, as in `FrameEstimate`; nan without."""
    inlier_ratio: FloatArray
    """(n,) share of the frame's evidence that the pose explains, 0 to 1; nan when unknown."""
    n_rectangles: IntArray
    """(n,) rectangles accepted."""
    covariance: FloatArray | None = None
    """(n, 20, 20) in error-state order; None unless it was asked for."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_estimate(self) -> BoolArray:
        """(n,) whether the frame has an estimate."""
        return np.asarray(np.isfinite(self.r_hill[:, 0]))

    def state(self, index: int) -> NavigationState | None:
        """The state of one frame, None where there is no estimate."""
        if not self.has_estimate[index]:
            return None
        return NavigationState(
            r_hill=self.r_hill[index],
            v_hill=self.v_hill[index],
            com_model=self.com_model[index],
            R_world_body=self.R_world_body[index],
            omega_body=self.omega_body[index],
            inertia_ratios=self.inertia_ratios[index],
        )


def read_track(run_folder: Path, *, with_covariance: bool = False) -> Track:
    """The track stored in a result folder.

    ``with_covariance`` also loads the (20, 20) covariances, 3 kB a frame; without it only their
    diagonals, as standard deviations. Raises `InputError` when a file is missing or damaged.
    """
    path = run_folder / STATES_FILE
    table = read_csv(path, TRACK_COLUMNS, ("status",))
    state = table.numbers(STATE_COLUMNS[1:])
    sd = np.empty((len(state), STATE_SIZE))
    sd[:, SD_ORDER] = table.numbers(SD_COLUMNS)
    known = np.isfinite(np.hstack([state, sd]))
    partial = np.flatnonzero(known.any(axis=1) & ~known.all(axis=1))
    if partial.size:
        raise InputError(path, f"line {partial[0] + 2}", "expected all of the state or none of it")
    has_estimate = known[:, 0] if len(known) else np.zeros(0, dtype=np.bool_)
    time_s = table.times()
    covariance = None
    if with_covariance:
        covariance = _read_covariances(run_folder / COVARIANCES_FILE, time_s, has_estimate)
    return Track(
        time_s=time_s,
        r_hill=state[:, 0:3],
        v_hill=state[:, 3:6],
        R_world_body=_rotations(path, state[:, 6:10]),
        omega_body=state[:, 10:13],
        com_model=state[:, 13:16],
        inertia_ratios=state[:, 16:21],
        sd=sd,
        T_cam_model=read_poses(run_folder / POSES_FILE, time_s, has_estimate),
        status=table.words("status"),
        nis=table.numbers(("nis",))[:, 0],
        nis_dof=table.counts("nis_dof"),
        window_nis=table.numbers(("window_nis",))[:, 0],
        inlier_ratio=table.numbers(("inlier_ratio",))[:, 0],
        n_rectangles=table.counts("n_rectangles"),
        covariance=covariance,
    )


def read_measurements(run_folder: Path) -> tuple[RectangleRecord, ...]:
    """All rectangle records of a result folder, in the order seen. Raises `InputError`."""
    path = run_folder / MEASUREMENTS_FILE
    table = read_csv(path, MEASUREMENT_COLUMNS, ("rectangle", "case", "outcome"))
    poses = table.numbers(POSE_COLUMNS)
    T_cam_rect = make_transform(_rotations(path, poses[:, 3:7]), poses[:, 0:3])
    sizes = table.numbers(("length_m", "width_m"))
    sd = table.numbers(MEASUREMENT_COLUMNS[11:17])
    rows = zip(
        table.times().tolist(),
        table.words("rectangle"),
        sizes.tolist(),
        T_cam_rect,
        sd,
        table.words("case"),
        table.words("outcome"),
        strict=True,
    )
    return tuple(
        RectangleRecord(time_s, name, length_m, width_m, T, deviations, case, outcome)
        for time_s, name, (length_m, width_m), T, deviations, case, outcome in rows
    )


def count_outcomes(run_folder: Path) -> Counter[tuple[str, str]]:
    """How often each (rectangle, outcome) occurs in a result folder, read line by line.

    The rectangle is empty where a segment was not recognised. Raises `InputError`.
    """
    path = run_folder / MEASUREMENTS_FILE
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return Counter((row["rectangle"], row["outcome"]) for row in csv.DictReader(file))
    except OSError as error:
        raise InputError(path, "file", f"expected a readable file ({error.strerror})") from error
    except (KeyError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(path, "file", f"expected the columns of a run ({error})") from error


def _rotations(path: Path, quaternions_xyzw: FloatArray, first_line: int = 2) -> FloatArray:
    """(n, 3, 3) rotations, nan where the quaternion is nan."""
    R = np.full((len(quaternions_xyzw), 3, 3), np.nan)
    known = np.isfinite(quaternions_xyzw).all(axis=1)
    lengths = np.linalg.norm(quaternions_xyzw[known], axis=1)
    wrong = np.abs(lengths - 1.0) > _NORM_TOLERANCE
    if wrong.any():
        line = np.flatnonzero(known)[np.argmax(wrong)] + first_line
        raise InputError(path, f"line {line}", "expected a unit quaternion in q_x, q_y, q_z, q_w")
    if known.any():
        R[known] = rotation_from_xyzw(quaternions_xyzw[known])
    return R


def read_poses(path: Path, time_s: FloatArray, has_estimate: BoolArray) -> FloatArray:
    """(n, 4, 4) poses of the frames with an estimate, whose timestamps the file must repeat."""
    T_cam_model = np.full((len(time_s), 4, 4), np.nan)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [[float(word) for word in line.split()] for line in lines if line[:1] != "#"]
    except OSError as error:
        raise InputError(path, "file", f"expected a readable file ({error.strerror})") from error
    except ValueError as error:
        raise InputError(path, "file", f"expected rows of numbers ({error})") from error
    if any(len(row) != len(_TUM_FIELDS) for row in rows):
        raise InputError(path, "file", f"expected {' '.join(_TUM_FIELDS)} in every line")
    values = np.array(rows).reshape(-1, len(_TUM_FIELDS))
    if not np.array_equal(values[:, 0], time_s[has_estimate]):
        expected = f"expected the times of the {has_estimate.sum()} estimates in {STATES_FILE}"
        raise InputError(path, "timestamp", expected)
    if len(values):
        R = _rotations(path, values[:, 4:], first_line=1)
        T_cam_model[has_estimate] = make_transform(R, values[:, 1:4])
    return T_cam_model


def _read_covariances(path: Path, time_s: FloatArray, has_estimate: BoolArray) -> FloatArray:
    """(n, 20, 20) covariances, nan in frames without an estimate."""
    count = int(has_estimate.sum())
    expected = f"expected ({count}, {STATE_SIZE}, {STATE_SIZE}) at the times of {STATES_FILE}"
    covariance = np.full((len(time_s), STATE_SIZE, STATE_SIZE), np.nan)
    try:
        with np.load(path, allow_pickle=False) as stored:
            if not np.array_equal(stored["time_s"], time_s[has_estimate]):
                raise InputError(path, "P", expected)
        with zipfile.ZipFile(path) as folder, folder.open("P.npy") as file:
            blocks = _matrices(file)
            # Block by block: a long run is not held twice.
            for rows in np.array_split(np.flatnonzero(has_estimate), max(1, count // 512)):
                covariance[rows] = blocks(len(rows))
            if file.read(1):
                raise InputError(path, "P", expected)
    except FileNotFoundError as error:
        raise InputError(path, "file", "expected a readable file") from error
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(path, "file", f"expected the arrays P and time_s ({error})") from error
    return covariance


def _matrices(file: IO[bytes]) -> Callable[[int], FloatArray]:
    """Reads the (n, 20, 20) of an open .npy file by so many matrices a call."""
    version = np.lib.format.read_magic(file)
    if version != (1, 0):
        raise ValueError(f"array format {version}")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
    if shape[1:] != (STATE_SIZE, STATE_SIZE) or fortran or dtype != np.float64:
        raise ValueError(f"P is {shape} {dtype}")

    def read(n: int) -> FloatArray:
        size = n * STATE_SIZE * STATE_SIZE
        data = file.read(8 * size)
        if len(data) != 8 * size:
            raise ValueError("P ends early")
        return np.frombuffer(data).reshape(n, STATE_SIZE, STATE_SIZE)

    return read
