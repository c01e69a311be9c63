"""The parts of the tracking study: faults, and how runs are judged."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT, POSITION, RATIOS
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.errors import Errors
from pcnav.runs.run import Run
from pcnav.simulation.random_truth import satellite
from pcnav.target.mesh import mesh_diameter
from studies.blocks import BLOCKS
from studies.following import JudgedRun, status_sequence, status_shares
from studies.tracking import faults
from studies.tracking.blackouts import Blackout, Phases
from studies.tracking.starts import Outcome, run_start, start_figures


def judged_run(
    status: tuple[str, ...],
    position_m: FloatArray | None = None,
    sd_m: FloatArray | None = None,
) -> JudgedRun:
    """A run of so many frames that is off along x only, with the deviations given."""
    n = len(status)
    error, sd = np.zeros((n, 3)), np.ones(n) if sd_m is None else sd_m
    error[:, 0] = 0.0 if position_m is None else position_m
    trajectory = Trajectory(
        np.arange(0.0, 0.5 * n, 0.5),
        MASS_CENTRE_LAYOUT,
        {RATIOS.name: np.tile([1.0, 1.0, 0.0, 0.0, 0.0], (n, 1))},
        sd=np.tile(sd[:, None], MASS_CENTRE_LAYOUT.size),
        covariance=np.eye(MASS_CENTRE_LAYOUT.size) * sd[:, None, None] ** 2,
    )
    said = Run(
        name="",
        folder=None,
        estimator="depth",
        pipeline=None,
        trajectory=trajectory,
        status=status,
        nis=np.full(n, 6.0),
        nis_dof=np.full(n, 6, dtype=np.intp),
        window_nis=np.full(n, 1.0),
    )
    state = {block.name: np.zeros((n, block.size)) for block in MASS_CENTRE_LAYOUT.blocks}
    state[POSITION.name] = error
    return JudgedRun(
        said,
        Errors(state, error, np.zeros((n, 3)), trajectory),
        seconds=np.full(n, 0.01),
        pose_covariance=np.eye(6) * sd[:, None, None] ** 2,
    )


def test_statuses_are_told_in_order_and_in_shares() -> None:
    words = ("acquiring", "acquiring", "locked", "coasting", "locked", "locked")
    assert status_sequence(words) == "acquiring 2, locked 1, coasting 1, locked 2"
    run = judged_run(words)
    assert run.lock == 2 and run.claims.tolist() == [False, False, True, False, True, True]
    assert status_shares([run.said]) == "locked 50.0%, acquiring 33.3%, coasting 16.7%"
    assert judged_run(("acquiring",)).lock is None


def test_nees_of_pose_and_blocks() -> None:
    run = judged_run(("locked",) * 3, np.array([0.0, 0.5, 3.0]), np.array([1.0, 0.5, 1.0]))
    np.testing.assert_allclose(run.pose_nees, [0.0, 1.0, 9.0])
    np.testing.assert_allclose(run.nees(BLOCKS["position"]), [0.0, 1.0, 9.0])
    np.testing.assert_allclose(run.nees(BLOCKS["mass centre"]), 0.0)


def test_a_blackout_ends_with_a_right_lock_and_keeps_what_was_known() -> None:
    phases = Phases(before=2, after=4)
    words = ("acquiring", "locked", *["coasting"] * 10, "coasting", "locked", "locked", "locked")
    position = np.zeros(16)
    position[13] = 2.0  # the first lock is a wrong one
    sd = np.concatenate([[2.0, 1.0], np.ones(10), [1.0, 1.0, 0.9, 0.8]])
    blackout = Blackout(5, 7, phases, judged_run(words, position, sd))
    assert (blackout.last_seen, blackout.last_blind) == (1, 11)
    assert blackout.relocked == 3
    np.testing.assert_allclose(blackout.growth, 0.9)
    lost = Blackout(5, 7, phases, judged_run(("locked", "locked", *["lost"] * 14)))
    assert lost.relocked is None and np.isnan(lost.growth).all()


def test_silent_wrong_frames_are_those_called_locked() -> None:
    words = ("locked", "ambiguous", "coasting", "locked", "locked", "acquiring")
    far = np.array([0.1, 0.6, 0.6, 0.6, 0.6, 0.6])  # 5 % of 10 m is 0.5 m
    run = faults.FaultRun("none", 1, judged_run(words, far))
    assert run.silent.tolist() == [0, 1, 0, 1, 1, 0] and run.longest_silent == 2
    other = faults.FaultRun(faults.WRONG_TARGET, 1, judged_run(words))
    assert other.silent.tolist() == [1, 1, 0, 1, 1, 0]


def test_the_box_adds_its_volume_on_the_bus() -> None:
    target = satellite("boxsat").target
    boxed = faults.with_box(target)
    assert boxed.volume - target.mesh.volume == pytest.approx(0.5 * 0.4 * 0.3)
    extra = np.array(boxed.vertices)[len(target.mesh.vertices) :]
    assert extra[:, 0].min() == pytest.approx(0.8) and extra[:, 0].max() == pytest.approx(1.1)
    assert np.all(np.abs(extra[:, 1:]) < [0.9, 1.1])
    assert np.sort(np.ptp(extra, axis=0)) == pytest.approx([0.3, 0.4, 0.5])


def test_the_panel_turns_about_its_root_and_nothing_else_moves() -> None:
    target = satellite("boxsat").target
    before, after = (
        np.array(target.mesh.vertices),
        np.array(faults.with_bent_panel(target).vertices),
    )
    moved = np.linalg.norm(after - before, axis=1)
    panel = (before[:, 1] > 1.2 - 1e-9) & (np.abs(before[:, 2] - 0.25) > 0.7)
    assert panel.sum() == 8 and np.all(moved[~panel] == 0.0)
    tip, root = panel & (before[:, 1] > 5.0), panel & (before[:, 1] < 1.3)
    # The front is hinged; the back, 40 mm behind it, swings by 2 mm.
    assert moved[tip].max() == pytest.approx(2.0 * 4.0 * np.sin(np.deg2rad(1.5)), rel=1e-3)
    assert sorted(moved[root]) == pytest.approx([0, 0, 0.04 * 0.05236, 0.04 * 0.05236], abs=1e-5)
    assert faults.with_bent_panel(target).volume == pytest.approx(target.mesh.volume)
    both = faults.with_box_and_bent_panel(target)
    np.testing.assert_array_equal(np.array(both.vertices)[: len(after)], after)
    assert both.volume == pytest.approx(target.mesh.volume + 0.06)


def test_another_satellite_is_as_large() -> None:
    target = satellite("boxsat").target
    other = faults.another_satellite(target)
    assert mesh_diameter(other) == pytest.approx(target.diameter_m)
    assert len(other.vertices) != len(target.mesh.vertices)


def test_a_cold_start_is_judged_by_the_truth() -> None:
    start = run_start("boxsat", 2557970329)
    assert start.outcome in set(Outcome) and start.seconds > 0.0 and 1 <= start.frames <= 5
    locked = start.status in {"locked", "ambiguous"}
    assert locked == (start.outcome is not Outcome.NOT_YET)
    assert np.isfinite(start.attitude_rad) == np.isfinite(start.position_fraction) == locked
    if locked:
        near = start.attitude_rad < np.deg2rad(5.0) and start.position_fraction < 0.05
        assert near == (start.outcome is Outcome.RIGHT)
    assert 9.0 < start.range_m < 32.0 and start.rate_deg_s <= 20.0


def test_figures_stand_satellites_without_locks() -> None:
    """One start of four and none."""
    start = run_start("boxsat", 2557970329)
    none = replace(start, outcome=Outcome.NOT_YET, frames=5, attitude_rad=np.nan)
    for found in ({"a": [start, none, none, none], "b": [none]}, {"b": [none]}):
        assert all(figure.svg.startswith(b"<?xml") for figure in start_figures(found))
