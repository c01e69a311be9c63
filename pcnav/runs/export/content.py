"""What is exported of a run, whatever the format, and where it comes from."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.recording import truth_folder
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.time_line import EPOCH_S
from pcnav.recordings.truth import read_truth, truth_of
from pcnav.runs.reader import read_run
from pcnav.runs.run import Run
from pcnav.runs.status import CLAIMED

Files = Mapping[str, bytes]
"""Content of the file asked for, under "", and of those beside it, by the word in their name."""
_TIME_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Export:
    """A run and what is known beside it."""

    run: Run
    time_zero_s: float
    """Time stamp of the recording that is time 0 of the run."""
    truth: Trajectory | None = None
    """None where the recording has none, or is not there."""
    recording: Sequence | None = None
    """Of depth frames; None where it is not there, or of another kind."""
    epoch: datetime | None = None
    """UTC of time 0 of the run, where it was given."""
    only_claimed: bool = False
    """Whether poses that were merely predicted are left out."""

    @property
    def source(self) -> Path:
        """What an `InputError` names."""
        return self.run.folder or Path(self.run.name)

    @property
    def shown(self) -> BoolArray:
        """(n,) frames whose estimate is written."""
        has = self.run.has_estimate
        if not self.only_claimed:
            return has
        return np.asarray(has & np.isin(self.run.status, list(CLAIMED)))

    def poses(self) -> tuple[IntArray, FloatArray]:
        """(m,) frames with an estimate and their (m, 4, 4) T_cam_model.

        Raises `InputError` for a run without poses.
        """
        poses = self.run.trajectory.T_cam_target
        if poses is None:
            expected = "expected a run with poses; this one tells attitudes alone"
            raise InputError(self.source, "poses", expected)
        frames = np.flatnonzero(self.shown)
        if not len(frames):
            raise InputError(self.source, "poses", "expected a pose in at least one frame")
        return frames, poses[frames]

    def stamps_s(self, time_s: FloatArray) -> FloatArray:
        """Stamps as the recording has them of times of the run."""
        return np.asarray(time_s + self.time_zero_s)

    def zero_ns(self) -> int | None:
        """Unix time of time 0, ns: as given, or as the recording is stamped; None if unknown."""
        if self.epoch is not None:
            since = self.epoch.astimezone(UTC) - datetime(1970, 1, 1, tzinfo=UTC)
            return ((since.days * 86400 + since.seconds) * 10**6 + since.microseconds) * 1000
        return round(self.time_zero_s * 1e9) if abs(self.time_zero_s) > EPOCH_S else None

    def true_poses(self) -> tuple[FloatArray, FloatArray] | None:
        """(m,) times of the run and (m, 4, 4) true T_cam_model; None where they are not known."""
        if self.truth is None or self.truth.T_cam_target is None:
            return None
        return self.truth.time_s, self.truth.T_cam_target

    def true_poses_at(self, frames: IntArray) -> FloatArray | None:
        """(m, 4, 4) the true poses in frames of the run, nan where unknown; None without any."""
        found = self.true_poses()
        if found is None:
            return None
        time_s, poses = found
        asked = self.run.time_s[frames]
        rows = np.minimum(np.searchsorted(time_s, asked - _TIME_TOLERANCE_S), len(time_s) - 1)
        known = np.abs(time_s[rows] - asked) <= _TIME_TOLERANCE_S
        return np.where(known[:, None, None], poses[rows], np.nan)


def exported(
    folder: Path,
    *,
    recording: Path | None = None,
    epoch: datetime | None = None,
    only_claimed: bool = False,
) -> tuple[Export, tuple[str, ...]]:
    """What there is to export of a result folder, and what is missing, a sentence each.

    ``recording`` replaces the one that the run names. Raises `InputError` for a folder that is no
    result, and for a recording given that cannot be read.
    """
    run = read_run(folder, with_covariance=True)
    zero_s = 0.0 if run.pipeline is None else run.pipeline.time_zero_s
    found = Export(run, zero_s, epoch=epoch, only_claimed=only_claimed)
    named = None if run.pipeline is None else run.pipeline.sequence
    path = recording or (None if named is None else Path(named))
    if path is None or (recording is None and not path.exists()):
        where = "not named in it" if path is None else f"not at {path}"
        return found, (f"the recording of {folder} is {where}: no truth and no camera poses",)
    try:
        sequence = _sequence_of(path, run)
        truth = read_truth(truth_folder(path)) if sequence is None else truth_of(sequence)
    except InputError as error:
        if recording is not None:
            raise
        return found, (f"the recording of {folder} cannot be read ({error})",)
    return replace(found, truth=truth, recording=sequence), ()


def pose_numbers(T: FloatArray) -> FloatArray:
    """(n, 7) x, y, z, m, and the scalar-last quaternion of poses (n, 4, 4)."""
    return np.column_stack([T[:, :3, 3], xyzw_from_rotation(T[:, :3, :3])])


def _sequence_of(path: Path, run: Run) -> Sequence | None:
    """The depth frames of a run; None of a run on anything else."""
    if run.pipeline is None or run.pipeline.target_mesh is None:
        return None
    mesh, skip = Path(run.pipeline.target_mesh), run.pipeline.skip_bad_frames
    return open_sequence(path, mesh, skip, run.pipeline.recording)
