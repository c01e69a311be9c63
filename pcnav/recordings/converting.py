"""A recording of depth frames of any format, written as one of our own."""

import logging
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT, POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.depth_form import DepthIs
from pcnav.recordings.sequence import Frame, Sequence
from pcnav.recordings.truth import truth_of
from pcnav.recordings.writer import depth_step, write_sequence

OnFrame = Callable[[int, int], None]
"""Told how many frames are done, and of how many."""
_TIME_TOLERANCE_S = 1e-6
_LOG = logging.getLogger("pcnav")


def convert(
    sequence: Sequence,
    out: Path,
    *,
    step_m: float | None = None,
    skip_bad_frames: bool = False,
    overwrite: bool = False,
    on_frame: OnFrame | None = None,
) -> float:
    """Write a recording, with its truth, in our own format; the metres of a stored unit.

    Integers keep the unit that they have; floats, and ranges, which become z-depths, are stored in
    the finest of tenths of millimetres whose 16 bits reach as far as they do, unless ``step_m``
    says another. With ``skip_bad_frames`` those that cannot be read are left out. Raises
    `InputError`, and for a depth that does not fit.
    """
    truth = truth_of(sequence)
    step_m = step_m or _step_m(sequence, skip_bad_frames)
    written: list[int] = []
    frames = _frames(sequence, skip_bad_frames, written, on_frame)
    if skip_bad_frames:
        # Which of them can be read is known only when all were.
        good = list(_good_rows(sequence))
        truth = _at(truth, sequence, np.array(good, dtype=np.intp))
    else:
        truth = _at(truth, sequence, np.arange(len(sequence)))
    write_sequence(out, sequence.info, step_m, frames, truth, overwrite)
    if len(written) < len(sequence):
        left = len(sequence) - len(written)
        _LOG.warning("%s: %d frames that cannot be read were left out", sequence.path, left)
    return step_m


def _frames(
    sequence: Sequence, skip_bad: bool, written: list[int], on_frame: OnFrame | None
) -> Iterator[Frame]:
    for index in range(len(sequence)):
        try:
            frame = sequence.frame(index)
        except InputError:
            if not skip_bad:
                raise
            continue
        written.append(index)
        yield frame
        if on_frame is not None:
            on_frame(index + 1, len(sequence))


def _good_rows(sequence: Sequence) -> Iterator[int]:
    for index in range(len(sequence)):
        try:
            sequence.frame(index)
        except InputError:
            continue
        yield index


def _step_m(sequence: Sequence, skip_bad: bool) -> float:
    """The unit that the images have, where they are integers that stay what they are."""
    if sequence.read_scan is not None:
        # Ranges of scans are floats.
        return 0.001
    steps = np.unique(sequence.depth_step_m)
    stored_z = sequence.form.depth_is is DepthIs.Z
    first = next(_frames(sequence, skip_bad, [], None), None)
    if first is None:
        raise InputError(sequence.path, "frames", "expected at least one that can be read")
    path = sequence.images / sequence.files[first.index]
    if len(steps) == 1 and stored_z and sequence.read_image(path).dtype.kind in "ui":
        return float(steps[0])
    step_m = depth_step(_frames(sequence, skip_bad, [], None))
    _LOG.info("%s: depths are stored in steps of %g mm", sequence.path, 1000.0 * step_m)
    return step_m


def _at(
    truth: Trajectory | None, sequence: Sequence, rows: "np.ndarray[tuple[int], np.dtype[np.intp]]"
) -> Trajectory | None:
    """The truth at frames; its states only where they are known at all of them."""
    if truth is None or not len(truth):
        return None
    asked = sequence.times_s[rows]
    places = np.searchsorted(truth.time_s, asked - _TIME_TOLERANCE_S).clip(0, len(truth) - 1)
    known = np.abs(truth.time_s[places] - asked) <= _TIME_TOLERANCE_S
    at = replace(truth.at(places), time_s=asked)
    if known.all() and at.layout == MASS_CENTRE_LAYOUT and at.T_cam_target is not None:
        return at
    if at.T_cam_target is None:
        _LOG.warning("%s: its truth has no poses and is left out", sequence.path)
        return None
    poses = np.where(known[:, None, None], at.T_cam_target, np.nan)
    return Trajectory(asked, POSE_LAYOUT, T_cam_target=poses)
