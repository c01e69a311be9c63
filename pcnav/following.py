"""A run on frames that arrive: each is answered within a budget, and written at once.

A result folder appears with the first answer and is whole from then on, however the process ends.
A run that is there already is gone on with: its frames are taken from the recording again, beside
it, and what stands in its place from the moment on that it is caught up with is the new one.
"""

import logging
import shlex
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import FrameType

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.core.errors import InputError
from pcnav.files.new_folder import refuse_unless_replaceable
from pcnav.files.owned import in_use
from pcnav.navigation import Inputs, Navigation, RunSummary, Truth
from pcnav.pipeline import OnEstimate, OnStart
from pcnav.recordings.arriving import Arrival, Arriving
from pcnav.recordings.given_frames import DepthRecording
from pcnav.recordings.intake import skipped_frames_csv
from pcnav.recordings.sequence import Sequence
from pcnav.runs.places import located
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import (
    PIPELINE_FILE,
    SKIPPED_FRAMES_FILE,
    STATES_FILE,
    TIMING_FILE,
)
from pcnav.runs.timing import AnswerTime, Timing, TimingFile, read_timing, timing_sentences
from pcnav.runs.writer import RunWriter

_LOG = logging.getLogger("pcnav")
_LOOK_EVERY_S = 0.005
_SAID_AT = {10**k for k in range(9)}
"""Late frames are said when there are so many."""


@dataclass(frozen=True)
class Pace:
    """How frames that arrive are answered."""

    budget_s: float = 0.1
    """A frame that is answered later than so long after it came is late."""
    idle_s: float | None = None
    """The run ends when no frame came for so long; None waits for an end mark."""
    drops_late: bool = False
    """Whether a frame that has waited for longer than the budget is passed over for a later one;
    else all are answered, in order, however late."""


@dataclass(frozen=True)
class Earlier:
    """The run that is gone on with."""

    times_s: frozenset[float] = frozenset()
    """Of the frames that it answered."""
    timing: dict[float, Timing] = field(default_factory=dict)

    @property
    def last_s(self) -> float:
        """Time of its last frame."""
        return max(self.times_s, default=-float("inf"))


def follow(
    source: Arriving,
    out: Path,
    inputs_of: Callable[[DepthRecording], Inputs],
    pace: Pace,
    *,
    overwrite: bool = False,
    report: bool = True,
    on_start: OnStart | None = None,
    on_estimate: OnEstimate | None = None,
) -> RunSummary:
    """Answer frames as they arrive and leave the result folder of a run.

    It ends by the source's end mark, when nothing came for the pace's idle time, or by the first
    Ctrl-C; a second one ends it as it is. ``inputs_of`` says what is run on the recording once it
    can be read. Raises `InputError` as `pcnav.pipeline.run` does, and where the run that is there
    is another one; what was answered by then stays.
    """
    resumes = not overwrite and (out / TIMING_FILE).is_file()
    refuse_unless_replaceable(out.resolve(), overwrite or resumes, STATES_FILE)
    if in_use(out):
        raise InputError(out, "folder", "expected one that no other process writes into")
    with _interrupts() as asked_to_end:
        if not source.look() and source.recording is None:
            _LOG.info("waiting for frames")
        if not _wait(source, pace, time.monotonic(), asked_to_end) or source.recording is None:
            expected = "expected at least one frame that can be read"
            raise source.why_not or InputError(out, "frames", expected)
        inputs = inputs_of(source.recording)
        earlier = _earlier(out, inputs) if resumes else Earlier()
        navigation = Navigation(inputs)
        with RunWriter(out, navigation.estimator.output, overwrite or resumes) as writer:
            navigation.begin(writer)
            if on_start is not None:
                on_start(inputs.as_run, navigation.estimator.output)
            with TimingFile(writer.staging) as timing:
                answering = _Answering(navigation, writer, timing, pace, earlier, on_estimate)
                answering.all_of(source, asked_to_end)
            return _completed(navigation, writer, source, (answering.rows, pace), report)


class _Answering:
    """Takes in frames and writes their answers."""

    def __init__(
        self,
        navigation: Navigation,
        writer: RunWriter,
        timing: TimingFile,
        pace: Pace,
        earlier: Earlier,
        on_estimate: OnEstimate | None,
    ) -> None:
        self._navigation, self._writer, self._timing = navigation, writer, timing
        self._pace, self._earlier, self._on_estimate = pace, earlier, on_estimate
        self._is_behind, self._done, self._late = True, 0, 0
        self.rows: list[Timing] = []

    def all_of(self, source: Arriving, asked_to_end: threading.Event) -> None:
        """Until the source ends, is idle for too long, or somebody wants an end."""
        came_s = time.monotonic()
        while not asked_to_end.is_set() and _wait(source, self._pace, came_s, asked_to_end, self):
            self._take(source.take(), source)
            came_s = time.monotonic()
        self._writer.appear()

    def waits(self) -> None:
        """Told that no frame is ready: those that had been there are all answered."""
        self._is_behind = False

    def _take(self, arrival: Arrival, source: Arriving) -> None:
        time_s, pace = arrival.frame.time_s, self._pace
        again = time_s <= self._earlier.last_s
        if again and time_s not in self._earlier.times_s:
            # It was passed over then, or came after later ones.
            passed = self._earlier.timing.get(time_s)
            if passed is not None:
                self._add(passed)
            return
        waited_s = time.monotonic() - arrival.came_s
        if pace.drops_late and not again and waited_s > pace.budget_s and source.look():
            self._add(Timing(time_s, AnswerTime.PASSED_OVER))
            return
        before_s = time.process_time()
        estimate = self._writer.add(self._navigation.step(arrival.frame))
        self._writer.flush()
        if not again:
            # Here is more than in what stood in its place so far.
            self._writer.appear()
        cost_s, delay_s = time.process_time() - before_s, time.monotonic() - arrival.came_s
        row = Timing(time_s, self._word(arrival, delay_s), delay_s, cost_s)
        if arrival.was_there:
            row = replace(row, delay_s=float("nan"))
        self._add(self._earlier.timing.get(time_s, row) if again else row)
        self._done += 1
        if self._on_estimate is not None:
            recording = source.recording
            self._on_estimate(estimate, self._done, max(self._done, len(recording or ())))

    def _word(self, arrival: Arrival, delay_s: float) -> AnswerTime:
        if arrival.was_there:
            return AnswerTime.EARLIER
        if delay_s <= self._pace.budget_s:
            return AnswerTime.IN_TIME
        if self._is_behind:
            return AnswerTime.BEHIND
        self._late += 1
        if self._late in _SAID_AT:
            text = "frame %d: answered %.3f s after it came, the budget is %g s; %d late so far"
            _LOG.warning(text, arrival.frame.index, delay_s, self._pace.budget_s, self._late)
        return AnswerTime.LATE

    def _add(self, row: Timing) -> None:
        self.rows.append(row)
        self._timing.add(row)


def _wait(
    source: Arriving,
    pace: Pace,
    since_s: float,
    asked_to_end: threading.Event,
    answering: _Answering | None = None,
) -> bool:
    """Wait for a frame; whether there is one. None within the idle time is the end."""
    while not source.look():
        if answering is not None:
            answering.waits()
        is_idle = pace.idle_s is not None and time.monotonic() - since_s > pace.idle_s
        if source.has_ended or is_idle or asked_to_end.is_set():
            return False
        time.sleep(_LOOK_EVERY_S)
    return True


def _completed(
    navigation: Navigation,
    writer: RunWriter,
    source: Arriving,
    answers: tuple[list[Timing], Pace],
    report: bool,
) -> RunSummary:
    """Add to the answers what is told of all of them."""
    recording, (rows, pace) = source.recording, answers
    assert recording is not None, "frames of it were answered"
    navigation.inputs = replace(navigation.inputs, recording=recording)
    if source.skipped:
        writer.write_text(SKIPPED_FRAMES_FILE, skipped_frames_csv(source.skipped))
    told, warned = timing_sentences(rows, pace.budget_s)
    _LOG.info("%s", told)
    return navigation.complete(
        writer,
        _truth_of(recording),
        (*source.remarks, *warned),
        command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        report=report,
    )


def _truth_of(recording: DepthRecording) -> Truth:
    """As far as it is there by now."""
    if not isinstance(recording, Sequence):
        return Truth()
    try:
        return Truth.of(recording)
    except InputError as error:
        # All frames are answered: a fault in what nobody needs must not cost them.
        _LOG.warning("without truth: %s", error)
        return Truth()


def _earlier(out: Path, inputs: Inputs) -> Earlier:
    """What the run that is there answered. Raises `InputError` for one of something else."""
    if inputs.recording.path is None:
        expected = (
            "expected a new folder: of a stream nothing is left to go on from; or --overwrite"
        )
        raise InputError(out, "folder", expected)
    before = located(read_pipeline(out / PIPELINE_FILE), out)
    theirs, ours = _comparable(before), _comparable(inputs.as_run)
    for table in sorted(theirs.keys() | ours.keys()):
        if theirs.get(table) != ours.get(table):
            expected = "expected that of the run that is there, to go on with it; or --overwrite"
            raise InputError(out / PIPELINE_FILE, table, expected)
    try:
        times_s = frozenset(read_run(out).time_s.tolist())
        timing = dict(read_timing(out))
    except InputError as error:
        _LOG.warning("begun anew: %s", error)
        return Earlier()
    _LOG.info("%s: its %d frames are taken from the recording again first", out, len(times_s))
    return Earlier(times_s, timing)


def _comparable(pipeline: Pipeline) -> dict[str, object]:
    return pipeline.model_copy(update={"written_to": None}).stated(of_a_run=True)


@contextmanager
def _interrupts() -> Iterator[threading.Event]:
    """Set by the first Ctrl-C or termination: the frame at hand is answered, and all completed."""
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    names = (getattr(signal, name, None) for name in ("SIGINT", "SIGTERM", "SIGHUP"))
    before = {number: signal.getsignal(number) for number in names if number is not None}

    def ask(number: int, frame: FrameType | None) -> None:
        event.set()
        for each, handler in before.items():
            signal.signal(each, handler)

    for number, handler in before.items():
        if handler is not signal.SIG_IGN:
            signal.signal(number, ask)
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
