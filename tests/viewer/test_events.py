"""What happened in a run is found at the frames where it was put."""

from dataclasses import replace

import numpy as np

from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import ATTITUDE, RATE, Layout
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.run import Run
from pcnav.viewer.events import Kind, events_of, neighbour

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
    assert found == [(1, Kind.LOCK), (3, Kind.LOSS), (5, Kind.LOCK)]
    assert events_of(run, {})[2].text.startswith("found again")


def test_a_flip_is_a_jump_that_the_rate_does_not_explain() -> None:
    run = made_up_run(["locked"] * 8, flip_at=5)
    flips = [event for event in events_of(run, {}) if event.kind is Kind.FLIP]
    assert [event.frame for event in flips] == [5]
    assert "180 deg" in flips[0].text
    steady = events_of(made_up_run(["locked"] * 8), {})
    assert not [event for event in steady if event.kind is Kind.FLIP]


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


def test_neighbours_are_strictly_before_and_after() -> None:
    events = events_of(made_up_run(["acquiring", "locked", "coasting", "locked"]), {})
    assert [event.frame for event in events] == [1, 2, 3]
    after, before = neighbour(events, 1, 1, None), neighbour(events, 2, -1, Kind.LOCK)
    assert after is not None and after.frame == 2
    assert before is not None and before.frame == 1
    assert neighbour(events, 3, 1, None) is None
    assert neighbour(events, 3, -1, Kind.FLIP) is None


def test_frames_without_an_estimate_are_no_flip() -> None:
    run = made_up_run(["locked"] * 6)
    run.trajectory[ATTITUDE][2:4] = np.nan
    assert not [event for event in events_of(run, {}) if event.kind is Kind.FLIP]


def test_a_run_of_poses_alone_has_no_flips() -> None:
    run = made_up_run(["locked"] * 8, flip_at=5)
    trajectory = Trajectory(run.time_s, Layout(()), {}, T_cam_target=np.tile(np.eye(4), (8, 1, 1)))
    found = events_of(replace(run, trajectory=trajectory), {})
    assert [event.kind for event in found] == [Kind.LOCK]
