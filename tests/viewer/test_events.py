"""What happened in a run is found at the frames where it was put."""

from dataclasses import replace

import numpy as np

from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import ATTITUDE, RATE, Layout
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.feature_outcomes import BEHIND, GATED, TRACKED, FeatureOutcomes
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.run import Run
from pcnav.viewer.events import Event, Kind, events_of, merged, neighbour

_SPIN = np.array([0.0, 0.0, 0.1])


def made_up_run(status: list[str], flip_at: int | None = None) -> Run:
    """A target that turns about z at 0.1 rad/s, seen once a second."""
    n = len(status)
    time_s = np.arange(n, dtype=float)
    R = exp_rotation(time_s[:, None] * _SPIN)
    if flip_at is not None:
        R[flip_at:] = R[flip_at:] @ np.diag([1.0, -1.0, -1.0])
    values = {ATTITUDE.name: R, RATE.name: np.tile(_SPIN, (n, 1))}
    return Run(
        name="made up",
        folder=None,
        estimator="",
        pipeline=None,
        trajectory=Trajectory(time_s, Layout((ATTITUDE, RATE)), values),
        status=tuple(status),
        nis=np.full(n, np.nan),
        nis_dof=np.zeros(n, dtype=np.intp),
        window_nis=np.full(n, np.nan),
    )


def record(time_s: float, name: str, outcome: str) -> RectangleRecord:
    return RectangleRecord(time_s, name, 1.0, 1.0, np.eye(4), np.ones(6), "I", outcome)


def test_lock_and_loss_are_where_the_status_changes() -> None:
    run = made_up_run(["acquiring", "locked", "locked", "coasting", "lost", "ambiguous"])
    found = [(event.frame, event.kind) for event in events_of(run, {})]
    assert found == [(1, Kind.LOCK), (3, Kind.LOSS), (4, Kind.LOSS), (5, Kind.LOCK)]
    assert events_of(run, {})[2].text == "given up after coasting: lost"
    assert events_of(run, {})[3].text.startswith("found again")


def test_every_change_of_the_status_is_an_event() -> None:
    status = ["acquiring", "ambiguous", "locked", "coasting", "lost", "acquiring", "acquiring"]
    run = made_up_run(status)
    assert [event.frame for event in events_of(run, {})] == [1, 2, 3, 4, 5]


def test_a_flip_is_a_jump_that_the_rate_does_not_explain() -> None:
    run = made_up_run(["locked"] * 8, flip_at=5)
    flips = [event for event in events_of(run, {}) if event.kind is Kind.FLIP]
    assert [event.frame for event in flips] == [5]
    assert "180 deg" in flips[0].text
    steady = events_of(made_up_run(["locked"] * 8), {})
    assert not [event for event in steady if event.kind is Kind.FLIP]


def test_features_are_rejected_together_and_once() -> None:
    run = made_up_run(["locked"] * 4)
    names, none = np.array([5, 3, 8]), np.full(3, np.nan)
    words = (
        (ACCEPTED, TRACKED, ACCEPTED),
        (GATED, ACCEPTED, GATED),
        (GATED, BEHIND, GATED),
        (ACCEPTED, ACCEPTED, GATED),
    )
    outcomes = {float(k): FeatureOutcomes(names, each, none) for k, each in enumerate(words)}
    found = [(event.frame, event.kind, event.text) for event in events_of(run, {}, outcomes)]
    assert found[0][1] is Kind.LOCK
    assert found[1:] == [
        (1, Kind.REJECTED, f"features 5, 8: {GATED}"),
        (2, Kind.REJECTED, f"feature 3: {BEHIND}"),
    ]


def test_a_loss_says_what_the_estimator_says_of_the_frame() -> None:
    run = made_up_run(["locked", "coasting"])
    run = replace(run, words={"outcome": ("measured", "nothing moved in the image")})
    assert events_of(run, {})[1].text == "no longer followed: coasting (nothing moved in the image)"


def test_frames_in_a_row_reject_once() -> None:
    run = made_up_run(["locked"] * 6)
    records = {
        0.0: (record(0.0, "a", ACCEPTED),),
        1.0: (record(1.0, "a", "gated"), record(1.0, "", "too small")),
        2.0: (record(2.0, "a", "gated"), record(2.0, "b", "gated")),
        4.0: (record(4.0, "a", "gated"),),
    }
    rejected = [event for event in events_of(run, records) if event.kind is Kind.REJECTED]
    assert [(event.frame, event.text) for event in rejected] == [
        (1, "a: gated"),
        (2, "b: gated"),
        (4, "a: gated"),
    ]


def walked(events: tuple[Event, ...], frame: int, step: int) -> list[int]:
    """The events that one meets by asking for the next again and again."""
    met: list[int] = []
    at = neighbour(events, frame, None, step, None)
    while at is not None:
        met.append(at)
        at = neighbour(events, events[at].frame, at, step, None)
    return met


def test_every_event_is_reached_both_ways_also_several_at_one_frame() -> None:
    kinds = (Kind.REJECTED, Kind.REJECTED, Kind.LOSS, Kind.LOCK, Kind.REJECTED)
    events = tuple(
        Event(frame, kind, str(k))
        for k, (frame, kind) in enumerate(zip((0, 3, 3, 3, 7), kinds, strict=True))
    )
    assert walked(events, 0, 1) == [0, 1, 2, 3, 4]
    assert walked(events, 7, -1) == [4, 3, 2, 1, 0]
    assert neighbour(events, 3, 1, 1, Kind.LOCK) == 3
    assert neighbour(events, 3, 1, -1, None) == 0
    # The user has gone elsewhere since: what was visited does not count.
    assert neighbour(events, 1, 4, 1, None) == 1
    assert neighbour(events, 7, 4, 1, None) is None
    assert neighbour(events, 7, None, -1, Kind.FLIP) is None


def test_events_of_a_second_run_are_met_at_the_frames_of_the_first() -> None:
    first, second = (events_of(made_up_run(s), {}) for s in (["locked"] * 4, ["lost", "locked"]))
    found = merged((first, second), (np.arange(4), np.array([1, 3])))
    assert [(event.frame, event.run, event.kind) for event in found] == [
        (0, 0, Kind.LOCK),
        (3, 1, Kind.LOCK),
    ]


def test_frames_without_an_estimate_are_no_flip() -> None:
    run = made_up_run(["locked"] * 6)
    run.trajectory[ATTITUDE][2:4] = np.nan
    assert not [event for event in events_of(run, {}) if event.kind is Kind.FLIP]


def test_a_run_of_poses_alone_has_no_flips() -> None:
    run = made_up_run(["locked"] * 8, flip_at=5)
    trajectory = Trajectory(run.time_s, Layout(()), {}, T_cam_target=np.tile(np.eye(4), (8, 1, 1)))
    found = events_of(replace(run, trajectory=trajectory), {})
    assert [event.kind for event in found] == [Kind.LOCK]
