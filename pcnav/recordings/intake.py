"""The frames of a recording on their way into an estimator: restricted, and blind where they must.

An image that is damaged or missing, where that is allowed, says nothing: the estimator gets a frame
of which nothing is known, and coasts. One that came under two times is given as it is: whether the
target can have stood still is for the estimator to judge; but it is said.
"""

import csv
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import StringIO

import numpy as np

from pcnav.config.region import RegionTable
from pcnav.core.arrays import DepthImage
from pcnav.core.errors import InputError
from pcnav.recordings.read_ahead import Read, read_ahead
from pcnav.recordings.region import restricted
from pcnav.recordings.region_files import region_of
from pcnav.recordings.sequence import Frame, Sequence

_MAX_LISTED = 10


@dataclass(frozen=True)
class SkippedFrame:
    """A frame that could not be read."""

    index: int
    """Position in the recording, from 0."""
    time_s: float
    fault: str
    """What was wrong with it, in words."""


class Intake:
    """The frames of one recording, one by one and once; then, what there is to say of them."""

    def __init__(self, sequence: Sequence, region: RegionTable, skip_bad_frames: bool) -> None:
        """Raises `InputError` for a region whose files are not there."""
        self._sequence, self._skip = sequence, skip_bad_frames
        self._table, self._region = region, region_of(region, sequence)
        self._before: DepthImage | None = None
        self._skipped: list[SkippedFrame] = []
        self._repeated: list[int] = []
        self._differing = 0

    def __len__(self) -> int:
        return len(self._sequence)

    @property
    def skipped(self) -> tuple[SkippedFrame, ...]:
        """Frames that could not be read so far."""
        return tuple(self._skipped)

    @property
    def repeated(self) -> tuple[int, ...]:
        """Indices of frames that brought the image of the one before, to the bit.

        Images without noise are alike where nothing moves: none counts where no two differ.
        """
        return tuple(self._repeated) if self._differing else ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What is to be said of the frames, a sentence each."""
        skipped = [frame.index for frame in self._skipped]
        said = (
            (skipped, "could not be read and were coasted over"),
            (self.repeated, "brought the image of the frame before once more"),
        )
        counted = ((found, f"{len(found)} of {len(self)} frames {words}") for found, words in said)
        return tuple(f"{sentence}: {_listed(found)}" for found, sentence in counted if found)

    def __iter__(self) -> Iterator[Frame]:
        """Raises `InputError` for a frame that is bad where none may be, and when all are."""
        with read_ahead(self._sequence) as read:
            yield from self._all(read)

    def _all(self, read: Read) -> Iterator[Frame]:
        for index in range(len(self)):
            try:
                yield self._given(read(index))
            except InputError as error:
                if not self._skip:
                    hint = "; --skip-bad-frames coasts over it"
                    raise InputError(error.file, error.field, error.expected + hint) from error
                blind = self.skip(index, error)
                if len(self._skipped) == len(self):
                    expected = f"expected at least one good frame; of the last: {error}"
                    raise InputError(self._sequence.path, "frames", expected) from error
                yield blind

    def read(self, index: int) -> Frame:
        """One frame, of those that are read in their order. Raises `InputError` for a bad one."""
        return self._given(self._sequence.frame(index))

    def _given(self, frame: Frame) -> Frame:
        index = frame.index
        given = restricted(frame, self._region.of(self._sequence, index))
        if self._before is not None and frame.depth_m.any():
            if np.array_equal(frame.depth_m, self._before):
                self._repeated.append(index)
            else:
                self._differing += 1
        self._before = frame.depth_m
        return given

    def skip(self, index: int, why: InputError) -> Frame:
        """What is given in place of a bad frame: one of which nothing is known."""
        time_s = float(self._sequence.times_s[index])
        self._skipped.append(SkippedFrame(index, time_s, str(why)))
        return self._sequence.blind_frame(index)

    def extend(self, sequence: Sequence) -> None:
        """More of the recording is there. Raises `InputError` as the making does."""
        if self._table.masks is not None:
            self._region = region_of(self._table, sequence)
        self._sequence = sequence


def skipped_frames_csv(skipped: Iterable[SkippedFrame]) -> str:
    """The table of frames that could not be read."""
    text = StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(("frame", "time_s", "fault"))
    table.writerows((frame.index, frame.time_s, frame.fault) for frame in skipped)
    return text.getvalue()


def _listed(indices: Iterable[int]) -> str:
    words = [str(index) for index in indices]
    more = f" and {len(words) - _MAX_LISTED} more" if words[_MAX_LISTED:] else ""
    return ", ".join(words[:_MAX_LISTED]) + more
