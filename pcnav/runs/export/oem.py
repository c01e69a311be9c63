"""CCSDS OEM 2.0 (502.0-B-3): where the target's mass centre is, and how fast it moves."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import POSITION, VELOCITY
from pcnav.runs.export.ccsds import (
    CHASER,
    RelativeFrame,
    epochs,
    header,
    numbers,
    object_name,
    relative_frame,
)
from pcnav.runs.export.content import Export, Files

ABOUT = (
    "Orbit ephemeris message in KVN: the target's mass centre from the chaser's, km, and its rate "
    "of change as seen in the turning frame, km/s, UTC, with covariances. REF_FRAME is RTN of the "
    "chaser (CENTER_NAME), or WORLD in a laboratory."
)
_KM = 1e-3


def write_oem(export: Export) -> Files:
    """Raises `InputError` for a run without position and velocity, an orbit or an epoch."""
    motion = export.run.trajectory
    if POSITION not in motion or VELOCITY not in motion:
        expected = "expected a run that estimates position and velocity"
        raise InputError(export.source, "states", expected)
    frames = np.flatnonzero(export.shown)
    if not len(frames):
        raise InputError(export.source, "states", "expected an estimate in at least one frame")
    axes, stamps = relative_frame(export), epochs(export, frames)
    turned = (motion[block][frames] @ axes.R_frame_hill.T for block in (POSITION, VELOCITY))
    rows = _KM * np.column_stack(list(turned))
    comments = (*axes.comments, "velocity as seen in the frame that turns")
    lines = [
        *header("OEM", "2.0"),
        "META_START",
        *(f"COMMENT {comment}" for comment in comments),
        f"OBJECT_NAME = {object_name(export)}",
        "OBJECT_ID = UNKNOWN",
        f"CENTER_NAME = {CHASER}",
        f"REF_FRAME = {axes.name}",
        "TIME_SYSTEM = UTC",
        f"START_TIME = {stamps[0]}",
        f"STOP_TIME = {stamps[-1]}",
        "META_STOP",
        "",
        *(f"{stamp} {numbers(row)}" for stamp, row in zip(stamps, rows, strict=True)),
        "",
    ]
    P = _covariances(export, axes)
    if P is not None:
        lines.append("COVARIANCE_START")
        for stamp, each in zip(stamps, P[frames], strict=True):
            lines += [f"EPOCH = {stamp}", f"COV_REF_FRAME = {axes.name}"]
            lines += [numbers(each[row, : row + 1]) for row in range(6)]
        lines.append("COVARIANCE_STOP")
    return {"": ("\n".join(lines) + "\n").encode()}


def _covariances(export: Export, axes: RelativeFrame) -> FloatArray | None:
    """(n, 6, 6) of position and velocity, km and km/s; None where they are not known."""
    motion = export.run.trajectory
    if motion.covariance is None or POSITION not in motion.layout or VELOCITY not in motion.layout:
        return None
    places = np.arange(motion.layout.size)
    own = np.concatenate([places[motion.layout.slice_of(b)] for b in (POSITION, VELOCITY)])
    turn = np.kron(np.eye(2), axes.R_frame_hill)
    return np.asarray(_KM**2 * turn @ motion.covariance[:, own[:, None], own] @ turn.T)
