"""A run on attitudes: rotation and inertia ratios over time, and the table of its result folder.

Numbers are stored with all their digits; an empty field means "no value".
"""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.inertia_parameters import ratios_from_parameters, ratios_jacobian
from pcnav.estimators.attitude_inertia.rotation_model import INERTIA, SIZE, RotationState
from pcnav.runs.results import STATES_FILE
from pcnav.runs.status import Status

RATIO_NAMES = ("i_yy", "i_zz", "i_xy", "i_xz", "i_yz")
"""Over Ixx, as in every result folder."""
_STATE_COLUMNS = ("q_x", "q_y", "q_z", "q_w", "w_x_rad_s", "w_y_rad_s", "w_z_rad_s", *RATIO_NAMES)
_ERROR_NAMES = ("theta_x_rad", "theta_y_rad", "theta_z_rad", *_STATE_COLUMNS[4:])
ATTITUDE_STATES_COLUMNS = (
    "time_s",
    *_STATE_COLUMNS,
    *(f"sd_{name}" for name in _ERROR_NAMES),
    *("status", "nis", "nis_dof", "sd_measured_rad"),
)


@dataclass(frozen=True)
class AttitudeTrack:
    """A run's estimates, one row per frame; nan in frames without one."""

    time_s: FloatArray
    """(n,)"""
    R_world_body: FloatArray
    """(n, 3, 3)"""
    omega_body: FloatArray
    """(n, 3) rad/s"""
    inertia_ratios: FloatArray
    """(n, 5) Iyy, Izz, Ixy, Ixz, Iyz over Ixx."""
    covariance: FloatArray
    """(n, 11, 11) of attitude (body axes, rad), rate and ratios."""
    status: tuple[str, ...]
    nis: FloatArray
    """(n,) nan in frames without an innovation."""
    measured_sd: FloatArray
    """(n,) of the attitudes taken in, root mean square about an axis, rad; nan without one."""
    axes: tuple[tuple[int, FloatArray], ...] = ()
    """Frames from which on the body axes are new, and R_world_body (3, 3) there: those of images of
    one camera are the run's own. Empty where the attitudes came with axes of their own."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_estimate(self) -> BoolArray:
        """(n,) whether the frame has an estimate."""
        return np.asarray(np.isfinite(self.omega_body[:, 0]))

    @property
    def sd(self) -> FloatArray:
        """(n, 11) standard deviations."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))


@dataclass(frozen=True)
class AttitudeFrame:
    """What a run knows at one time."""

    time_s: float
    status: Status
    R_world_body: FloatArray
    """(3, 3), nan as all of the estimate where there is none."""
    omega_body: FloatArray
    """(3,) rad/s"""
    inertia_ratios: FloatArray
    """(5,) over Ixx."""
    covariance: FloatArray
    """(11, 11) of attitude (body axes, rad), rate and ratios."""
    nis: float
    measured_sd: float
    """Of the attitude taken in, root mean square about an axis, rad; nan without one."""

    @property
    def sd(self) -> FloatArray:
        """(11,) standard deviations."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))


_NOTHING = (
    *(np.full((3, 3), np.nan), np.full(3, np.nan)),
    *(np.full(5, np.nan), np.full((SIZE, SIZE), np.nan)),
)


def attitude_frame(
    time_s: float,
    estimate: tuple[RotationState, FloatArray] | None,
    noise: FloatArray | None,
    nis: float = float("nan"),
    accepted: bool = True,
) -> AttitudeFrame:
    """One frame of a run.

    Args:
        time_s: of the frame.
        estimate: state (of one body) and covariance (11, 11) of its errors.
        noise: (3, 3) of the attitude taken in, rad^2; None without one.
        nis: of its innovation.
        accepted: whether it passed the gate.
    """
    rms = np.nan if noise is None else float(np.sqrt(np.trace(noise) / 3.0))
    if estimate is None:
        status, told = Status.ACQUIRING, _NOTHING
    else:
        measured = noise is not None and accepted
        status = Status.LOCKED if measured else Status.COASTING
        told = _told(*estimate)
    return AttitudeFrame(time_s, status, *told, nis, rms)


def attitude_track(
    frames: Sequence[AttitudeFrame], axes: Sequence[tuple[int, FloatArray]] = ()
) -> AttitudeTrack:
    """All frames of a run, at least one; see `AttitudeTrack.axes`."""
    return AttitudeTrack(
        time_s=np.array([frame.time_s for frame in frames]),
        R_world_body=np.stack([frame.R_world_body for frame in frames]),
        omega_body=np.stack([frame.omega_body for frame in frames]),
        inertia_ratios=np.stack([frame.inertia_ratios for frame in frames]),
        covariance=np.stack([frame.covariance for frame in frames]),
        status=tuple(str(frame.status) for frame in frames),
        nis=np.array([frame.nis for frame in frames]),
        measured_sd=np.array([frame.measured_sd for frame in frames]),
        axes=tuple(axes),
    )


def _told(
    state: RotationState, covariance: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Attitude, rate, ratios over Ixx and the covariance of all three."""
    parameters = state.parameters.reshape(5)
    change = np.eye(SIZE)
    change[INERTIA, INERTIA] = ratios_jacobian(parameters)
    told = change @ covariance @ change.T
    ratios = ratios_from_parameters(parameters)
    return state.R_world_body.reshape(3, 3), state.omega_body.reshape(3), ratios, told


def write_states(folder: Path, track: AttitudeTrack) -> None:
    """Write states.csv of a track."""
    known, xyzw = track.has_estimate, np.full((len(track), 4), np.nan)
    if known.any():
        xyzw[known] = xyzw_from_rotation(track.R_world_body[known])
    numbers = np.hstack([xyzw, track.omega_body, track.inertia_ratios, track.sd])
    with (folder / STATES_FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(ATTITUDE_STATES_COLUMNS)
        for k, time_s in enumerate(track.time_s.tolist()):
            values = ["" if np.isnan(value) else value for value in numbers[k].tolist()]
            nis = float(track.nis[k])
            ends = ["", 0] if np.isnan(nis) else [nis, 3]
            sd = float(track.measured_sd[k])
            writer.writerow([time_s, *values, track.status[k], *ends, "" if np.isnan(sd) else sd])
