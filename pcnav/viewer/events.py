"""What happened in a run, and at which frames: what one wants to jump to."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcnav.core.spatial import exp_rotation, rotation_angle
from pcnav.dynamics.blocks import ATTITUDE, RATE
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.run import Run
from pcnav.runs.status import Status

_FOLLOWED = {Status.LOCKED, Status.AMBIGUOUS}
_FLIP_RAD = np.radians(20.0)
"""An attitude that turns by more than this beyond what its rate says has flipped."""
_MAX_RATE_STEP_RAD = np.radians(60.0)
"""Over a longer turn between two frames a rate does not tell the attitude."""


class Kind(StrEnum):
    """What may happen."""

    LOCK = "lock"
    LOSS = "loss"
    FLIP = "flip"
    REJECTED = "rejected"


@dataclass(frozen=True)
class Event:
    """Something that happened at a frame."""

    frame: int
    kind: Kind
    text: str


def events_of(run: Run, records: Mapping[float, tuple[RectangleRecord, ...]]) -> tuple[Event, ...]:
    """All events of a run in the order of time.

    A status that begins to follow the target is a lock, one that ends it a loss. A flip is a jump
    of the attitude between two estimates that the rate does not explain. A rejection is a named
    rectangle that was not accepted; frames in a row that reject it for one reason are one event.
    """
    found = [*_status_changes(run), *_flips(run), *_rejections(run, records)]
    return tuple(sorted(found, key=lambda event: event.frame))


def neighbour(events: tuple[Event, ...], frame: int, step: int, kind: Kind | None) -> Event | None:
    """The next event after a frame (step 1) or the last before it (step -1); None for none."""
    wanted = [event for event in events if kind is None or event.kind is kind]
    if step > 0:
        return next((event for event in wanted if event.frame > frame), None)
    return next((event for event in reversed(wanted) if event.frame < frame), None)


def _status_changes(run: Run) -> list[Event]:
    found, followed, ever = [], False, False
    for k, status in enumerate(run.status):
        if status in _FOLLOWED and not followed:
            found.append(Event(k, Kind.LOCK, f"{'found again' if ever else 'found'}: {status}"))
        elif followed and status not in _FOLLOWED:
            found.append(Event(k, Kind.LOSS, f"no longer followed: {status}"))
        followed = status in _FOLLOWED
        ever = ever or followed
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
