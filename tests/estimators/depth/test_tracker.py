"""The tracker on rendered sequences: how good it is, and what it says of itself."""

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.config.depth import Measurements
from pcnav.config.pipeline_file import read_pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import rotation_angle
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.depth.measuring import AGREES
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.runs.estimate import Estimate
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.records import ACCEPTED
from pcnav.runs.status import Status
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import load_target
from tests.estimators.depth.tracked_boxsat import (
    FRAMES,
    SIGMA_M,
    Recording,
    note,
    recorded,
    shortened,
    track,
    tracker_of,
)

BLIND = range(20, 24)
"""Frames without returns in the second sequence."""
GAP = range(9, 19)
"""... and in the one with a longer gap, while the rate is not yet known well."""


@pytest.fixture(scope="module")
def estimates(recording: Recording) -> list[Estimate]:
    return track(recording, recording.frames)


def emptied(frame: Frame) -> Frame:
    return replace(frame, depth_m=np.zeros_like(frame.depth_m))


def index_of(recording: Recording, estimate: Estimate) -> int:
    """The frame of the recording."""
    return int(np.searchsorted(recording.motion.truth.time_s, estimate.time_s))


def state_of(estimate: Estimate) -> NavigationState:
    """What was estimated."""
    return NavigationState(*(estimate[block] for block in MASS_CENTRE_LAYOUT.blocks))


def pose_errors(recording: Recording, estimates: list[Estimate]) -> FloatArray:
    """(n, 2) position (m) and angle (rad) of the frames with an estimate."""
    rows = []
    for estimate in estimates:
        if estimate.T_cam_target is not None:
            truth = recording.motion.truth.poses[index_of(recording, estimate)]
            shift = np.linalg.norm(truth[:3, 3] - estimate.T_cam_target[:3, 3])
            turn = rotation_angle(truth[:3, :3].T @ estimate.T_cam_target[:3, :3])
            rows.append([shift, turn])
    return np.array(rows)


def test_locks_within_five_frames_without_a_prior_and_stays(
    estimates: list[Estimate],
) -> None:
    words = [estimate.status for estimate in estimates]
    first = words.index(Status.LOCKED)
    assert 2 <= first < 5
    assert set(words[:first]) == {Status.ACQUIRING}
    assert set(words[first:]) == {Status.LOCKED}
    for estimate in estimates[:first]:
        assert not estimate.values and estimate.covariance is None
        assert estimate.T_cam_target is None and estimate.notes["n_rectangles"] == 0


@pytest.mark.parametrize("measurements", [Measurements.RECTANGLES, Measurements.BOTH])
def test_other_measurements_lock_and_track_as_well(
    recording: Recording, estimates: list[Estimate], measurements: Measurements
) -> None:
    """Refined ones are the default: what is true of it holds of the others, but for the noise."""
    others = track(recording, recording.frames[:20], measurements)
    words = [estimate.status for estimate in others]
    first = words.index(Status.LOCKED)
    assert first < 5
    assert words == [Status.ACQUIRING] * first + [Status.LOCKED] * (20 - first)
    errors = pose_errors(recording, others)
    assert np.max(errors[5:, 0]) < 3e-3
    assert np.max(errors[5:, 1]) < np.deg2rad(0.1)
    for estimate in others[first:]:
        assert note(estimate, "n_rectangles") >= 2
        assert note(estimate, "inlier_ratio") > 0.95
    # Both are refined ones, filtered alike, and faces of the planes that RANSAC found as a check.
    one, other = others[-1].covariance, estimates[19].covariance
    assert one is not None and other is not None
    assert np.array_equal(one, other) == (measurements is Measurements.BOTH)
    records = [record for estimate in others for record in estimate.records]
    checks = [record for record in records if record.outcome.startswith("check: ")]
    assert bool(checks) == (measurements is Measurements.BOTH)
    if checks:
        assert sum(record.outcome == AGREES for record in checks) > 0.5 * len(checks)


def test_pose_is_better_than_a_millimetre_and_hundredths_of_a_degree(
    recording: Recording, estimates: list[Estimate]
) -> None:
    errors = pose_errors(recording, estimates)
    assert len(errors) >= FRAMES - 4
    median = np.median(errors[10:], axis=0)
    assert median[0] < 1e-3
    assert median[1] < np.deg2rad(0.03)
    assert np.max(errors[10:, 0]) < 3e-3
    assert np.max(errors[10:, 1]) < np.deg2rad(0.1)


def test_motion_and_mass_centre_come_out(recording: Recording, estimates: list[Estimate]) -> None:
    state, truth = state_of(estimates[-1]), recording.motion.state(-1)
    assert np.linalg.norm(state.omega_body - truth.omega_body) < np.deg2rad(0.05)
    assert np.linalg.norm(state.v_hill - truth.v_hill) < 5e-3
    before = np.linalg.norm(recording.target.com_model - truth.com_model)
    assert np.linalg.norm(state.com_model - truth.com_model) < 0.5 * before


def test_covariance_covers_the_error(recording: Recording, estimates: list[Estimate]) -> None:
    nees = []
    for estimate in estimates:
        if estimate.covariance is None:
            continue
        P = estimate.covariance
        assert np.array_equal(P, P.T)
        assert np.linalg.eigvalsh(P)[0] > 0.0
        truth = recording.motion.state(index_of(recording, estimate))
        error = state_of(estimate).ratio_error(truth)
        nees.append(error @ np.linalg.solve(P, error))
    # One run: successive errors are far from independent, so only gross overconfidence shows.
    assert np.median(nees) < 3.0 * STATE_SIZE


def test_innovations_are_as_large_as_stated(estimates: list[Estimate]) -> None:
    nis = np.array([estimate.nis for estimate in estimates])
    dof = np.array([estimate.nis_dof for estimate in estimates])
    used = np.isfinite(nis)
    assert used.sum() > 30
    assert np.all(dof[used] >= 3)
    ratio = nis[used].sum() / dof[used].sum()
    low, high = chi2.ppf([1e-6, 1 - 1e-6], dof[used].sum()) / dof[used].sum()
    assert 0.5 * low < ratio < 2.0 * high
    for estimate in estimates:
        accepted = sum(record.outcome == ACCEPTED for record in estimate.records)
        assert accepted == note(estimate, "n_rectangles")


def test_two_runs_are_the_same_bit_for_bit(recording: Recording, estimates: list[Estimate]) -> None:
    again = track(recording, recording.frames[:15])
    for one, other in zip(estimates, again, strict=False):
        assert one.status == other.status
        assert (one.T_cam_target is None) == (other.T_cam_target is None)
        if one.T_cam_target is not None and one.covariance is not None:
            np.testing.assert_array_equal(one.T_cam_target, other.T_cam_target)
            np.testing.assert_array_equal(one.covariance, other.covariance)


def test_frames_without_returns_are_coasted_through(recording: Recording) -> None:
    frames = [emptied(f) if f.index in BLIND else f for f in recording.frames[:30]]
    estimates = track(recording, frames)
    words = [estimate.status for estimate in estimates]
    assert [words[k] for k in BLIND] == [Status.COASTING] * len(BLIND)
    assert words[BLIND.stop :] == [Status.LOCKED] * (30 - BLIND.stop)
    errors = pose_errors(recording, estimates[BLIND.start :])
    assert np.max(errors[:, 0]) < 30e-3
    assert np.max(errors[:, 1]) < np.deg2rad(1.0)
    trace = [np.trace(e.covariance) for e in estimates[19:24] if e.covariance is not None]
    assert len(trace) == 5 and np.all(np.diff(trace) > 0.0)


@pytest.mark.parametrize("measurements", [None, Measurements.RECTANGLES])
def test_a_track_goes_on_after_a_gap_with_what_it_had_learnt(
    recording: Recording, measurements: Measurements | None
) -> None:
    frames = [emptied(f) if f.index in GAP else f for f in recording.frames[:26]]
    estimates = track(recording, frames, measurements)
    words = [estimate.status for estimate in estimates]
    assert [words[k] for k in GAP] == [Status.COASTING] * len(GAP)
    assert words[GAP.start - 1] == Status.LOCKED
    assert words[GAP.stop :] == [Status.LOCKED] * (26 - GAP.stop)
    errors = pose_errors(recording, estimates[GAP.stop :])
    assert np.max(errors[:, 0]) < 3e-3
    assert np.max(errors[:, 1]) < np.deg2rad(0.1)
    sd = np.array([np.sqrt(np.diag(e.covariance)) for e in estimates if e.covariance is not None])
    from_before_the_gap = sd[GAP.start - 1 - len(estimates) :]
    com, ratios = from_before_the_gap[:, COM_MODEL], from_before_the_gap[:, INERTIA_RATIOS]
    for block in (com, ratios):
        before = block[0]
        # The mass does not change while nobody looks, and a gap makes nobody forget it. The ratios'
        # deviations are those of the parameters where the estimate is, which may move a little.
        np.testing.assert_allclose(block[1 : 1 + len(GAP)], np.tile(before, (len(GAP), 1)))
        assert np.all(block[1 + len(GAP) :] < 1.1 * before)
    # What is seen over the longer arc tells more.
    assert np.all(com[-1] < 0.7 * com[0])


def test_explained_is_the_share_of_the_frame_that_the_pose_shows(
    recording: Recording, estimates: list[Estimate]
) -> None:
    renderer = DepthRenderer(recording.target.mesh, recording.frames[0].camera)
    checked = 0
    for frame, estimate in zip(recording.frames, estimates, strict=True):
        if estimate.T_cam_target is None:
            assert np.isnan(note(estimate, "inlier_ratio"))
            continue
        shown = renderer.render(estimate.T_cam_target).depth_m
        either = (shown > 0.0) | (frame.depth_m > 0.0)
        close = np.abs(shown - frame.depth_m) < 4.0 * SIGMA_M
        # A pixel at the rim without a return counts for neither there.
        assert note(estimate, "inlier_ratio") == pytest.approx(np.mean(close[either]), abs=0.02)
        assert 0.97 < note(estimate, "inlier_ratio") <= 1.0
        checked += 1
    assert checked > 30


def test_window_nis_is_that_of_the_last_frames(recording: Recording) -> None:
    frames = [emptied(f) if f.index in BLIND else f for f in recording.frames[:30]]
    estimates = track(recording, frames)
    updates: list[tuple[float, int]] = []
    for estimate in estimates:
        if np.isfinite(estimate.nis):
            updates.append((estimate.nis, estimate.nis_dof))
        last = updates[-NIS_WINDOW_FRAMES:]
        expected = sum(nis for nis, _ in last) / sum(dof for _, dof in last) if last else np.nan
        assert estimate.window_nis == pytest.approx(expected, rel=1e-9, nan_ok=True)
    assert np.isnan([note(estimates[k], "inlier_ratio") for k in BLIND]).all()
    assert len(updates) > 20
    assert 0.5 < (estimates[-1].window_nis or 0.0) < 1.5


def test_a_symmetric_target_is_called_ambiguous_and_its_group_told(
    repository: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pipeline = shortened(read_pipeline(repository / "pipelines" / "twinwing.toml"), 8)
    twinwing = recorded(load_target(repository / "meshes" / "twinwing.obj"), pipeline)
    stated = pipeline.orbit.mean_motion_rad_s, pipeline.noise.range_sigma_m
    info = SequenceInfo("twinwing", *stated, None, calibration=EXACT)
    caplog.set_level(logging.INFO, logger="pcnav")
    tracker = tracker_of(twinwing.target, info)
    words = [tracker.step(frame).status for frame in twinwing.frames]
    first = words.index(Status.AMBIGUOUS)
    assert first < 5
    assert words == [Status.ACQUIRING] * first + [Status.AMBIGUOUS] * (8 - first)
    (line,) = [r.getMessage() for r in caplog.records if "->" in r.getMessage()]
    change = f"frame {first}: acquiring -> ambiguous, symmetry group C2 about z"
    assert re.fullmatch(change + r" \(inlier ratio \d+%(, .*)?\)", line)


def test_a_target_without_symmetry_has_no_group_to_tell(
    recording: Recording, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, logger="pcnav")
    track(recording, recording.frames[:5])
    (line,) = [r.getMessage() for r in caplog.records if "->" in r.getMessage()]
    assert "acquiring -> locked (" in line


def test_a_sequence_that_starts_empty_is_acquired_later(recording: Recording) -> None:
    frames = [emptied(f) if f.index < 4 else f for f in recording.frames[:10]]
    words = [estimate.status for estimate in track(recording, frames)]
    assert words[:6] == [Status.ACQUIRING] * 6
    assert words[-1] == Status.LOCKED
