"""A run on images of one camera: its attitudes over time, and the table of its result folder.

Numbers are stored with all their digits; an empty field means "no value".
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.config.image_motion import ImageMotionTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.estimators.image_motion.rates import continuous_xyzw, rotation_history
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.runs.results import STATES_FILE

ACQUIRING, LOCKED, COASTING = "acquiring", "locked", "coasting"

SD_COLUMNS = ("sd_theta_x_rad", "sd_theta_y_rad", "sd_theta_z_rad")
IMAGE_STATES_COLUMNS = (
    *("time_s", "q_x", "q_y", "q_z", "q_w", "w_x_rad_s", "w_y_rad_s", "w_z_rad_s"),
    *SD_COLUMNS,
    *("status", "outcome", "segment", "reference", "features", "matches", "agreeing"),
)

_WORDS = {
    Outcome.MEASURED: "measured",
    Outcome.FIRST: "first frame of a segment",
    Outcome.NO_CONSENSUS: "most matches agree with no one motion",
    Outcome.NO_MOTION: "nothing moved in the image",
    Outcome.NO_PARALLAX: "a turn of the camera alone explains the matches",
    Outcome.PLANAR: "points of one plane explain the matches",
    Outcome.AMBIGUOUS: "two motions explain the matches alike",
    Outcome.UNEXPECTED: "far from what the rate promises",
    Outcome.IMPRECISE: "the turn is too uncertain",
}


@dataclass(frozen=True)
class ImageTrack:
    """A run's attitudes, one row per frame; nan in frames without one."""

    time_s: FloatArray
    """(n,)"""
    R_world_body: FloatArray
    """(n, 3, 3) as the chain has them; at the first frame of a segment the camera's axes."""
    omega_body: FloatArray
    """(n, 3) rad/s, inertial; from the attitudes of several frames."""
    covariance: FloatArray
    """(n, 3, 3) of theta in ``R_world_body = R_hat exp(theta)``, rad^2."""
    status: tuple[str, ...]
    outcome: tuple[str, ...]
    """In words."""
    is_first: BoolArray
    """(n,) whether a frame begins a segment."""
    segment: IntArray
    """(n,) each has body axes of its own."""
    reference: tuple[int | None, ...]
    """Number of the frame each was compared with."""
    n_features: IntArray
    """(n,) features seen."""
    n_matches: IntArray
    """(n,) of them seen in the reference."""
    n_agreeing: IntArray
    """(n,) of these in agreement with the motion found."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_attitude(self) -> BoolArray:
        """(n,) whether the frame has an attitude."""
        return np.asarray(np.isfinite(self.R_world_body[:, 0, 0]))

    @property
    def sd(self) -> FloatArray:
        """(n, 3) standard deviations of theta, rad."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    @property
    def xyzw(self) -> FloatArray:
        """(n, 4) quaternions of R_world_body, without jumps of sign within a segment."""
        values = np.full((len(self), 4), np.nan)
        known = self.has_attitude
        if known.any():
            values[known] = continuous_xyzw(self.R_world_body[known], self.segment[known])
        return values


def image_track(
    frames: Sequence[ChainFrame], n_features: Sequence[int], settings: ImageMotionTable
) -> ImageTrack:
    """All frames of a chain, at least one, and how many features each saw."""
    n = len(frames)
    R, P = np.full((n, 3, 3), np.nan), np.full((n, 3, 3), np.nan)
    for k, frame in enumerate(frames):
        if frame.R_world_body is not None and frame.covariance is not None:
            R[k], P[k] = frame.R_world_body, frame.covariance
    history = rotation_history(frames, settings)
    omega = np.full((n, 3), np.nan)
    omega[history.frames] = history.omega_body
    return ImageTrack(
        time_s=np.array([frame.time_s for frame in frames]),
        R_world_body=R,
        omega_body=omega,
        covariance=P,
        status=_status(frames),
        outcome=tuple(outcome_in_words(frame.outcome, settings) for frame in frames),
        is_first=np.array([frame.outcome is Outcome.FIRST for frame in frames]),
        segment=np.array([frame.segment for frame in frames], dtype=np.intp),
        reference=tuple(frame.reference for frame in frames),
        n_features=np.array(n_features, dtype=np.intp),
        n_matches=np.array([frame.matches for frame in frames], dtype=np.intp),
        n_agreeing=np.array([frame.agreeing for frame in frames], dtype=np.intp),
    )


def write_states(folder: Path, track: ImageTrack) -> None:
    """Write states.csv of a track."""
    with (folder / STATES_FILE).open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(IMAGE_STATES_COLUMNS)
        writer.writerows(_rows(track))


def _rows(track: ImageTrack) -> Iterator[list[object]]:
    numbers = np.hstack([track.xyzw, track.omega_body, track.sd])
    for k, time_s in enumerate(track.time_s.tolist()):
        values = ["" if np.isnan(value) else value for value in numbers[k].tolist()]
        reference = track.reference[k]
        yield [
            *(time_s, *values, track.status[k], track.outcome[k], int(track.segment[k])),
            "" if reference is None else reference,
            *(int(count[k]) for count in (track.n_features, track.n_matches, track.n_agreeing)),
        ]


def _status(frames: Sequence[ChainFrame]) -> tuple[str, ...]:
    """Locked where measured; before that in a segment acquiring, afterwards coasting."""
    measured: set[int] = set()
    return tuple(image_status(frame, measured) for frame in frames)


def image_status(frame: ChainFrame, measured: set[int]) -> str:
    """Of the frame after those whose measured segments are given; its own is added to them."""
    if frame.outcome is Outcome.MEASURED:
        measured.add(frame.segment)
        return LOCKED
    return COASTING if frame.segment in measured else ACQUIRING


def outcome_in_words(outcome: Outcome, settings: ImageMotionTable) -> str:
    """What became of a frame."""
    if outcome is Outcome.FEW_MATCHES:
        return f"fewer than {settings.min_matches} matches"
    return _WORDS[outcome]
