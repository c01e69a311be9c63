"""What CCSDS messages have in common: epochs, numbers, frames, headers."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.dynamics.orbit import R_hill_world
from pcnav.runs.export.content import Export

CHASER = "CHASER"
_R_RTN_HILL = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Radial is zenith, transverse along-track, normal the orbit's: x is along-track, y minus orbit
normal, z nadir in Hill axes."""
_MICROSECONDS = 1000


@dataclass(frozen=True)
class RelativeFrame:
    """The axes about the chaser that a message speaks in."""

    name: str
    """As REF_FRAME."""
    R_frame_hill: FloatArray
    """(3, 3)"""
    mean_motion_rad_s: float
    comments: tuple[str, ...]

    def R_frame_world(self, time_s: float) -> FloatArray:
        """(3, 3) at a time of the run."""
        return np.asarray(self.R_frame_hill @ R_hill_world(time_s, self.mean_motion_rad_s))


def relative_frame(export: Export) -> RelativeFrame:
    """RTN of the chaser on an orbit, WORLD in a laboratory.

    Raises `InputError` where the recording does not tell which of them.
    """
    if export.recording is None:
        expected = "expected the recording, which knows the orbit; --sequence says where it is"
        raise InputError(export.source, "recording", expected)
    rate = export.recording.info.mean_motion_rad_s
    if rate == 0.0:
        said = (
            "WORLD: axes of the laboratory, at rest, origin at the chaser (the camera's world)",
            "no standard frame: agreed upon by this comment",
        )
        return RelativeFrame("WORLD", np.eye(3), 0.0, said)
    said = (
        "RTN of the chaser, origin at its mass centre: R zenith, T along-track, N orbit normal",
        f"the axes turn with the chaser's circular orbit, mean motion {rate!r} rad/s",
    )
    return RelativeFrame("RTN", _R_RTN_HILL, rate, said)


def epochs(export: Export, frames: IntArray) -> list[str]:
    """UTC to a microsecond of frames. Raises `InputError` where no epoch is known."""
    zero_ns = export.zero_ns()
    if zero_ns is None:
        expected = "expected --epoch, UTC of time 0: the recording's time stamps are of no epoch"
        raise InputError(export.source, "epoch", expected)
    texts = [_epoch(zero_ns, time_s) for time_s in export.run.time_s[frames].tolist()]
    if len(set(texts)) < len(texts):
        expected = "expected frames at least a microsecond apart, as the message counts"
        raise InputError(export.source, "time_s", expected)
    return texts


def header(kind: str, version: str, comments: Sequence[str] = ()) -> list[str]:
    """The lines before the first META_START."""
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    said = [f"COMMENT {comment}" for comment in comments]
    first = f"CCSDS_{kind}_VERS = {version}"
    return [first, *said, f"CREATION_DATE = {created}", "ORIGINATOR = PCNAV", ""]


def object_name(export: Export) -> str:
    """The target's, in the letters that a message allows."""
    pipeline = export.run.pipeline
    mesh = None if pipeline is None else pipeline.target_mesh
    stem = "TARGET" if mesh is None else re.split(r"[\\/]", mesh)[-1].split(".")[0]
    return re.sub(r"[^A-Z0-9]+", "_", stem.upper()).strip("_") or "TARGET"


def numbers(values: FloatArray) -> str:
    """Sixteen digits each, as many as a message may have."""
    return " ".join(f"{value:.15e}" for value in values.ravel().tolist())


def _epoch(zero_ns: int, time_s: float) -> str:
    # Summed as integers: an epoch leaves no microseconds to a sum of floats.
    microseconds = (zero_ns + round(time_s * 1e9) + _MICROSECONDS // 2) // _MICROSECONDS
    seconds, rest = divmod(microseconds, 10**6)
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%S") + f".{rest:06d}"
