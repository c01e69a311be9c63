"""A folder of depth frames that is still being written, in any format that a folder may have.

It is opened anew by its own reader whenever there is more in it. A frame counts as whole when its
file rests and can be read; one that cannot be, or is missing while later ones are there, is waited
for a while and then taken for a bad one.
"""

import os
import stat
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from pcnav.config.region import RegionTable
from pcnav.core.errors import InputError
from pcnav.recordings.arriving import END_FILE, Arrival, unheard
from pcnav.recordings.depth_image import SUFFIXES
from pcnav.recordings.intake import Intake, SkippedFrame
from pcnav.recordings.sequence import Frame, Sequence

_SETTLED_S = 0.005
"""A file that was not touched for so long is worth a try."""
_PATIENCE_S = 1.0
"""One that cannot be read and was not touched for so long never will be."""
_SUBFOLDERS = ("", "depth")
_CLOCK_STEP_NS = 100_000_000
"""Longer than the step in which a file system counts time."""

Stamp = tuple[int, int]
"""Size and time of the last change of a file."""


@dataclass(frozen=True)
class Look:
    """What a folder holds; differs when there are other images, or another file was written."""

    images: frozenset[str] = frozenset()
    """Names."""
    others: frozenset[tuple[Path, int, int]] = frozenset()
    """With sizes and times of the last change."""


class GrowingFolder:
    """The frames of one folder, in order, each once."""

    def __init__(
        self,
        path: Path,
        opened: Callable[[], Sequence],
        region: RegionTable,
        max_frames: int | None = None,
        with_more: Callable[[Sequence, list[str]], Sequence | None] = lambda *_: None,
    ) -> None:
        """``opened`` reads what there is now, images that are missing or damaged among it.

        ``max_frames`` ends it. ``with_more`` adds images of some names to what was read, where that
        is possible, so that a long recording is not read again for each of its frames.
        """
        self._with_more, self._looking = with_more, _Looking(path)
        self._path, self._open, self._region = path, opened, region
        self._max_frames = max_frames
        self._sequence: Sequence | None = None
        self._intake: Intake | None = None
        self._seen: Look | None = None
        self._queue: deque[int] = deque()
        self._known: set[str] = set()
        self._taken, self._overtaken = 0, 0
        self._last_s = -float("inf")
        self._began_s = time.monotonic()
        self._there = self._looking.at().images
        self._resting = _Resting()
        self._later: tuple[str, float] | None = None
        self._ready: Frame | None = None
        self._failure: InputError | None = None
        self._has_ended = False

    @property
    def recording(self) -> Sequence | None:
        """All that was there at the last look."""
        return self._sequence

    @property
    def why_not(self) -> InputError | None:
        """What the reader misses."""
        return self._failure

    @property
    def has_ended(self) -> bool:
        """By its end mark, or because as many frames as are wanted were taken."""
        return self._taken == self._max_frames or self._has_ended

    @property
    def skipped(self) -> tuple[SkippedFrame, ...]:
        """Frames that could not be read."""
        return () if self._intake is None else self._intake.skipped

    @property
    def remarks(self) -> tuple[str, ...]:
        """Of frames that were bad, repeated, or came after later ones."""
        said = () if self._intake is None else self._intake.remarks
        if not self._overtaken:
            return said
        return (*said, f"{self._overtaken} frames came after later ones and were left out")

    def look(self) -> bool:
        """Whether a frame is ready."""
        if self._ready is None and self._taken != self._max_frames:
            # Looked for first: what was written before it is then seen.
            is_marked = (self._path / END_FILE).exists()
            if not self._queue:
                self._refresh()
            self._try_next()
            self._has_ended = is_marked and self._ready is None and self._first_there() is None
        return self._ready is not None

    def take(self) -> Arrival:
        """The frame that is ready."""
        frame, sequence = self._ready, self._sequence
        assert frame is not None and sequence is not None, "look() found one"
        name = sequence.files[self._queue.popleft()]
        self._ready, self._last_s = None, frame.time_s
        self._taken += 1
        return Arrival(frame, self._came_s(name), Path(name).name in self._there)

    def _refresh(self) -> None:
        """Open the folder anew where there is something new in it."""
        now = self._looking.at()
        if now == self._seen:
            return
        try:
            sequence = self._extended(now) or self._opened()
        except InputError as error:
            # What cannot be read may be half-written: a later look tells.
            self._failure = error
            return
        self._failure, self._seen = None, now
        self._accept(sequence)

    def _opened(self) -> Sequence:
        with unheard():
            sequence = self._open()
        # Whatever it says of the recording is said once.
        return self._open() if self._sequence is None else sequence

    def _extended(self, now: Look) -> Sequence | None:
        if self._seen is None or self._sequence is None or now.others != self._seen.others:
            return None
        names = [name for name in now.images if name not in self._seen.images]
        is_told = all((self._sequence.images / name).is_file() for name in names)
        return self._with_more(self._sequence, names) if names and is_told else None

    def _accept(self, sequence: Sequence) -> None:
        if self._sequence is None or self._intake is None:
            self._intake = Intake(sequence, self._region, skip_bad_frames=True)
        else:
            # Times count from the same zero, whatever came first by now.
            zero_s = self._sequence.info.time_zero_s
            shift_s = sequence.info.time_zero_s - zero_s
            if shift_s:
                info = replace(sequence.info, time_zero_s=zero_s)
                sequence = replace(sequence, info=info, times_s=sequence.times_s + shift_s)
            self._intake.extend(sequence)
        self._sequence = sequence
        new = [k for k, name in enumerate(sequence.files) if name not in self._known]
        self._known.update(sequence.files[k] for k in new)
        self._queue.extend(k for k in new if sequence.times_s[k] > self._last_s)
        self._overtaken += sum(bool(sequence.times_s[k] <= self._last_s) for k in new)

    def _try_next(self) -> None:
        """Read the next frame, if it is whole."""
        if not self._queue or self._sequence is None or self._intake is None:
            return
        index = self._queue[0]
        path = self._sequence.images / self._sequence.files[index]
        rests_s = self._resting.of(path)
        if rests_s is None:
            if self._is_given_up():
                expected = "expected the image, there are later ones"
                self._ready = self._intake.skip(index, InputError(path, "file", expected))
            return
        if rests_s < _SETTLED_S:
            return
        try:
            self._ready = self._intake.read(index)
        except InputError as error:
            if rests_s > _PATIENCE_S:
                self._ready = self._intake.skip(index, error)

    def _is_given_up(self) -> bool:
        """Whether a later frame is there for so long that the next one never comes."""
        later = self._first_there()
        if later is None:
            self._later = None
        elif self._later is None or self._later[0] != later:
            self._later = (later, time.monotonic())
        return self._later is not None and time.monotonic() - self._later[1] > _PATIENCE_S

    def _first_there(self) -> str | None:
        """The first frame that waits and has a file, whole or not."""
        sequence = self._sequence
        if sequence is None:
            return None
        names = (sequence.files[k] for k in self._queue)
        return next((name for name in names if (sequence.images / name).exists()), None)

    def _came_s(self, name: str) -> float:
        assert self._sequence is not None, "a frame of it was read"
        now, path = time.monotonic(), self._sequence.images / name
        try:
            # Unlike the time of the content, this is none that was copied with the file.
            age_s = time.time() - path.stat().st_ctime
        except OSError:
            return now
        return min(max(now - age_s, self._began_s), now)


class _Resting:
    """For how long a file has not been touched, by one's own clock: that of a server is another."""

    def __init__(self) -> None:
        self._watched: tuple[Path, Stamp, float] | None = None

    def of(self, path: Path) -> float | None:
        """Seconds; None of a file that is missing or empty."""
        try:
            found = path.stat()
        except OSError:
            return None
        if not found.st_size:
            return 0.0
        now, stamp = time.monotonic(), (found.st_size, found.st_mtime_ns)
        if self._watched is None or self._watched[:2] != (path, stamp):
            # What was there for long need not be watched first, to be tried.
            is_old = time.time() - found.st_ctime > _PATIENCE_S
            self._watched = (path, stamp, now - 2.0 * _SETTLED_S if is_old else now)
        return now - self._watched[2]


class _Looking:
    """Looks into a folder, at its images again only where their folder has changed."""

    def __init__(self, path: Path) -> None:
        self._folders = [path / below for below in _SUBFOLDERS]
        self._last: tuple[list[int], Look] | None = None

    def at(self) -> Look:
        """What is there now."""
        changed, now_ns = [], time.time_ns()
        for folder in self._folders:
            with suppress(OSError):
                changed.append(folder.stat().st_mtime_ns)
        if self._last is not None and self._last[0] == changed:
            look = self._last[1]
            # Two changes within the clock's step leave one time.
            if all(abs(now_ns - each) > _CLOCK_STEP_NS for each in changed):
                return replace(look, others=frozenset(map(_stamped, _paths(look.others))))
        images, others = set(), set()
        for folder in self._folders:
            # It may not be there yet.
            with suppress(OSError):
                for name in os.listdir(folder):  # noqa: PTH208 (paths of many files take long)
                    if name.lower().endswith(SUFFIXES) and not name.startswith("."):
                        images.add(name)
                    elif not name.startswith("."):
                        others.add(_stamped(folder / name))
        look = Look(frozenset(images), frozenset(others))
        self._last = (changed, look)
        return look


def _stamped(path: Path) -> tuple[Path, int, int]:
    try:
        found = path.stat()
    except OSError:
        return path, -1, -1
    if stat.S_ISDIR(found.st_mode):
        # What is in it is looked at by itself.
        return path, 0, 0
    return path, found.st_size, found.st_mtime_ns


def _paths(others: frozenset[tuple[Path, int, int]]) -> Iterator[Path]:
    return (path for path, *_ in others)
