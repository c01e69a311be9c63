"""The estimator on tracks: finds inertia and motion, and lives with what real tracks do."""

import numpy as np
import pytest

from pcnav.config.inertia_bank import BankEstimate, InertiaBankTable
from pcnav.core.errors import InputError
from pcnav.core.spatial import log_rotation, xyzw_from_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.estimators.inertia_bank.estimator import InertiaBankEstimator
from pcnav.recordings.tracks import TrackFrame
from studies.segal2011 import paper
from tests.estimators.reported import motion_of

RIG = StereoRig(1.0, 1000.0, (512.0, 512.0), (1024, 1024), 0.02)
TRUE = (96.0, 104.0, 133.0, 43.0, 20.0, 10.0)
WRONG = ((1.0, 1.0, 1.0, 0.0, 0.0, 0.0), (133.0, 104.0, 96.0, -43.0, 20.0, 10.0))
TABLE = InertiaBankTable(
    hypotheses=(WRONG[0], TRUE, WRONG[1]),
    attitude_xyzw=tuple(xyzw_from_rotation(paper.R_HILL_PAPER).tolist()),
    attitude_sd_deg=1.0,
)
IB_MOTION = paper.true_motion(omega_body=5.0 * paper.OMEGA_0, duration_s=160.0, interval_s=2.0)


def frames(rng, points, count=80):
    made = []
    for k in range(count):
        t = float(IB_MOTION.times_s[k])
        p_rig = (IB_MOTION.r_hill[k] + points @ IB_MOTION.R_hill_body[k].T) @ paper.R_RIG_HILL.T
        pixels = RIG.project(p_rig) + RIG.pixel_sigma_px * rng.normal(size=(len(points), 4))
        R_cam_world = paper.R_RIG_HILL @ paper.ORBIT.R_hill_world(t)
        made.append(TrackFrame(t, R_cam_world, np.arange(len(points)), pixels))
    return made


def some(frame, kept):
    return TrackFrame(
        frame.time_s, frame.R_cam_world, frame.features[kept], frame.pixels[kept].copy()
    )


def points_of(rng, count=8):
    return rng.uniform(-1.5, 1.5, (count, 3))


def normalised_square(estimate, k):
    motion = motion_of(estimate)
    R_hill_world = paper.ORBIT.R_hill_world(float(IB_MOTION.times_s[k]))
    error = np.concatenate(
        [
            IB_MOTION.r_hill[k] - motion.r_hill,
            IB_MOTION.v_hill[k] - motion.v_hill,
            log_rotation((R_hill_world @ motion.R_world_body).T @ IB_MOTION.R_hill_body[k]),
            IB_MOTION.omega_body[k] - motion.omega_body,
        ]
    )
    return error @ np.linalg.solve(motion.covariance[:12, :12], error)


@pytest.mark.parametrize("kind", list(BankEstimate))
def test_finds_the_true_inertia_and_motion(kind):
    rng = np.random.default_rng(0)
    points = points_of(rng)
    estimator = InertiaBankEstimator(
        RIG, paper.ORBIT, TABLE.model_copy(update={"estimate": kind}), seed=0
    )
    estimates = [estimator.step(frame) for frame in frames(rng, points)]
    last = estimates[-1]
    assert last.status == "locked"
    assert last.notes["hypothesis"] == 2.0
    assert last.notes["weight_2"] == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(
        motion_of(last).inertia_ratios, np.array([104.0, 133.0, 43.0, 20.0, 10.0]) / 96.0, rtol=1e-6
    )
    # Far outside with probability 1e-6 for 12 components; the errors at two frames correlate.
    assert all(normalised_square(estimates[k], k) < 50.0 for k in (20, 50, 79))
    assert np.linalg.norm(motion_of(last).r_hill - IB_MOTION.r_hill[79]) < 0.3
    point_errors = [
        np.linalg.norm(motion_of(last).points[i].p_body - points[i]) for i in range(len(points))
    ]
    assert np.sqrt(np.mean(np.square(point_errors))) < 0.3
    np.testing.assert_allclose(motion_of(last).covariance, motion_of(last).covariance.T, atol=1e-12)
    assert last.nis_dof == 24


def test_lost_new_and_wrongly_matched_points():
    rng = np.random.default_rng(1)
    points = points_of(rng, 9)
    estimator = InertiaBankEstimator(RIG, paper.ORBIT, TABLE)
    for k, frame in enumerate(frames(rng, points)):
        kept = np.arange(8) if k < 30 else np.arange(2, 9)  # the last one comes late
        kept = kept[:0] if 40 <= k < 45 else kept
        seen = some(frame, kept)
        if k == 0:
            seen.pixels[3] = seen.pixels[6]  # wrong from the start
        if k in (10, 50):
            seen.pixels[4] = seen.pixels[1]
        estimate = estimator.step(seen)
        if k in (10, 50):
            assert estimate.features.rejected == (int(kept[4]),)
        if 1 <= k <= TABLE.max_rejections:
            assert 3 in estimate.features.rejected
        if 40 <= k < 45:
            assert estimate.status == "coasting"
            assert np.isnan(estimate.nis)
    assert estimate.notes["hypothesis"] == 2.0
    assert estimate.features.rejected == ()
    assert sorted(motion_of(estimate).points) == list(range(9))
    assert normalised_square(estimate, k) < 50.0
    for i in range(9):
        point = motion_of(estimate).points[i]
        error = point.p_body - points[i]
        assert error @ np.linalg.solve(point.covariance, error) < 40.0


def test_room_for_few_points():
    rng = np.random.default_rng(2)
    points = points_of(rng, 9)
    table = TABLE.model_copy(update={"max_features": 5})
    estimator = InertiaBankEstimator(RIG, paper.ORBIT, table)
    for k, frame in enumerate(frames(rng, points, 6)):
        kept = np.arange(9) if k < 3 else np.arange(4, 9)
        estimate = estimator.step(some(frame, kept))
    assert sorted(motion_of(estimate).points) == [4, 5, 6, 7, 8]


def test_another_target_is_lost_and_begun_anew():
    rng = np.random.default_rng(3)
    estimator = InertiaBankEstimator(RIG, paper.ORBIT, TABLE)
    status = []
    for k, frame in enumerate(frames(rng, points_of(rng), 20)):
        if k >= 8:
            frame.pixels[:] += 40.0  # 4 m aside at once
        status.append(estimator.step(frame).status)
    assert "lost" in status
    assert status[-1] in ("locked", "ambiguous")


def test_too_few_points_and_bad_frames():
    rng = np.random.default_rng(4)
    made = frames(rng, points_of(rng), 4)
    estimator = InertiaBankEstimator(RIG, paper.ORBIT, TABLE)
    waiting = estimator.step(some(made[0], np.arange(2)))
    assert waiting.status == "acquiring"
    assert not waiting.has_estimate
    estimator.step(made[1])
    with pytest.raises(InputError, match="time_s: expected times in order, more than 2"):
        estimator.step(made[1])
    with pytest.raises(InputError, match="every feature once"):
        estimator.step(some(made[2], np.array([0, 1, 1])))
    behind = some(made[2], np.arange(3))
    behind.pixels[0, 2] = behind.pixels[0, 0] + 1.0
    with pytest.raises(InputError, match="positive disparity"):
        estimator.step(behind)


def test_hypotheses_that_cannot_be():
    with pytest.raises(ValueError, match="no body's inertia"):
        InertiaBankTable(hypotheses=((1.0, 1.0, 3.0, 0.0, 0.0, 0.0),))
    with pytest.raises(ValueError, match="positive principal moments"):
        InertiaBankTable(hypotheses=((1.0, 1.0, 1.0, 2.0, 0.0, 0.0),), allow_unphysical=True)
    with pytest.raises(ValueError, match="prior: expected one for every"):
        InertiaBankTable(prior=(0.5, 0.5))


def test_an_undecided_inertia_is_doubted():
    rng = np.random.default_rng(0)
    points = points_of(rng)
    table = TABLE.model_copy(update={"estimate": BankEstimate.MAP})
    estimator = InertiaBankEstimator(RIG, paper.ORBIT, table)
    ratios = np.stack([ratios_from_inertia(each) for each in estimator._inertia])
    undecided = 0
    for frame in frames(rng, points):
        estimate = estimator.step(frame)
        if not estimate.has_estimate:
            continue
        stated = motion_of(estimate).covariance[12:, 12:]
        weights = np.array([estimate.notes[f"weight_{k + 1}"] for k in range(len(ratios))])
        if weights.max() >= 0.9:
            np.testing.assert_array_equal(stated, 0.0)
            continue
        undecided += 1
        followed = int(weights.argmax())
        # Drawn as the bank believes, the true one is so far from the one that is followed.
        drawn = ratios[rng.choice(len(ratios), size=40_000, p=weights)] - ratios[followed]
        spread = drawn.T @ drawn / len(drawn)
        sd = np.sqrt(np.diagonal(spread))
        np.testing.assert_allclose(stated / np.outer(sd, sd), spread / np.outer(sd, sd), atol=0.1)
    assert undecided
