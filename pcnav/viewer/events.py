"""What happened in a run, and at which frames: what one wants to jump to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from types import MappingProxyType

import numpy as np

from pcnav.core.arrays import IntArray
from pcnav.core.spatial import exp_rotation, rotation_angle
from pcnav.dynamics.blocks import ATTITUDE, RATE
from pcnav.runs.feature_outcomes import FeatureOutcomes, is_rejected
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.run import Run
from pcnav.runs.status import CLAIMED, Status

_FLIP_RAD = np.radians(20.0)
"""An attitude that turns by more than this beyond what its rate says has flipped."""
_MAX_NAMED = 6
_MAX_RATE_STEP_RAD = np.radians(60.0)
"""Over a longer turn between two frames a rate does not tell the attitude."""


class Kind(StrEnum):
    """What may happen."""

    LOCK = "lock"
    LOSS = "loss"
    FLIP = "flip"
    STATUS = "status"
    """Any other change of the status."""
    REJECTED = "rejected"


@dataclass(frozen=True)
class Event:
    """Something that happened at a frame."""

    frame: int
    kind: Kind
    text: str
    run: int = 0
    """Of which of the runs that are shown."""


def events_of(
    run: Run,
    records: Mapping[float, tuple[RectangleRecord, ...]],
    outcomes: Mapping[float, FeatureOutcomes] = MappingProxyType({}),
) -> tuple[Event, ...]:
    """All events of a run in the order of time.

    A status that begins to follow the target is a lock, one that ends it or gives the target up a
    loss, any other change a status. A flip is a jump
    of the attitude between two estimates that the rate does not explain. A rejection is a named
    rectangle that was not accepted; frames in a row that reject it for one reason are one event.
    Features that are rejected in one frame for one reason, and were not in the frame before, are
    one, too.
    """
    found = [*_status_changes(run), *_flips(run), *_rejections(run, records)]
    found += _feature_rejections(run, outcomes)
    return tuple(sorted(found, key=lambda event: event.frame))


def merged(events: Sequence[Sequence[Event]], frames: Sequence[IntArray]) -> tuple[Event, ...]:
    """The events of all runs in the order of time, at frames of the first run.

    ``frames`` tells for each run the frame of the first (n,) that shows each of its own.
    """
    moved = [
        replace(event, frame=int(at[event.frame]), run=k)
        for k, (own, at) in enumerate(zip(events, frames, strict=True))
        for event in own
    ]
    return tuple(sorted(moved, key=lambda event: event.frame))


def neighbour(
    events: tuple[Event, ...], frame: int, visited: int | None, step: int, kind: Kind | None
) -> int | None:
    """Index of the next event (step 1) or the one before (step -1); None for none.

    ``visited`` is the index of the event that was jumped to last, if the frame is still its own:
    of several events at one frame each has its turn. Without one, those of the frame come first.
    """
    wanted = [k for k, event in enumerate(events) if kind is None or event.kind is kind]
    at = -1 if visited is None or events[visited].frame != frame else visited
    if step > 0:
        after = (k for k in wanted if (events[k].frame, k) > (frame, at))
        return next(after, None)
    before = (k for k in reversed(wanted) if (events[k].frame, k) < (frame, at if at >= 0 else 1e9))
    return next(before, None)


def _status_changes(run: Run) -> list[Event]:
    found, before, ever = [], "", False
    reasons = run.words.get("outcome", ())
    for k, status in enumerate(run.status):
        followed, was_followed = status in CLAIMED, before in CLAIMED
        if followed and not was_followed:
            found.append(Event(k, Kind.LOCK, f"{'found again' if ever else 'found'}: {status}"))
        elif was_followed and not followed:
            why = f" ({reasons[k]})" if reasons else ""
            found.append(Event(k, Kind.LOSS, f"no longer followed: {status}{why}"))
        elif status == Status.LOST and before not in ("", status):
            found.append(Event(k, Kind.LOSS, f"given up after {before}: {status}"))
        elif before not in ("", status):
            found.append(Event(k, Kind.STATUS, f"{before}, now {status}"))
        before, ever = status, ever or followed
    return found


def _flips(run: Run) -> list[Event]:
    trajectory, known = run.trajectory, np.flatnonzero(run.has_estimate)
    if known.size < 2 or ATTITUDE not in trajectory or RATE not in trajectory:
        return []
    before, after = known[:-1], known[1:]
    turn = trajectory[RATE][before] * (run.time_s[after] - run.time_s[before])[:, None]
    R = trajectory[ATTITUDE]
    predicted = R[before] @ exp_rotation(turn)
    jump = rotation_angle(np.swapaxes(predicted, -1, -2) @ R[after])
    told = np.linalg.norm(turn, axis=1) < _MAX_RATE_STEP_RAD
    return [
        Event(int(after[k]), Kind.FLIP, f"attitude jumps by {np.rad2deg(jump[k]):.0f} deg")
        for k in np.flatnonzero(told & (jump > _FLIP_RAD))
    ]


def _rejections(run: Run, records: Mapping[float, tuple[RectangleRecord, ...]]) -> list[Event]:
    found: list[Event] = []
    last: set[tuple[str, str]] = set()
    for k, time_s in enumerate(run.time_s.tolist()):
        rejected = {
            (record.rectangle, record.outcome)
            for record in records.get(time_s, ())
            if record.rectangle and record.outcome != ACCEPTED
        }
        found += [
            Event(k, Kind.REJECTED, f"{name}: {reason}") for name, reason in sorted(rejected - last)
        ]
        last = rejected
    return found


def _feature_rejections(run: Run, outcomes: Mapping[float, FeatureOutcomes]) -> list[Event]:
    found: list[Event] = []
    last: dict[int, str] = {}
    for k, time_s in enumerate(run.time_s.tolist()):
        told, rejected = outcomes.get(time_s), dict[int, str]()
        if told is not None:
            pairs = zip(told.feature.tolist(), told.outcome, strict=True)
            rejected = {number: outcome for number, outcome in pairs if is_rejected(outcome)}
        new = {number: why for number, why in rejected.items() if last.get(number) != why}
        for why in sorted(set(new.values())):
            names = [str(number) for number, reason in new.items() if reason == why]
            more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
            of_what = "feature" if len(names) == 1 else "features"
            text = f"{of_what} {', '.join(names[:_MAX_NAMED])}{more}: {why}"
            found.append(Event(k, Kind.REJECTED, text))
        last = rejected
    return found
