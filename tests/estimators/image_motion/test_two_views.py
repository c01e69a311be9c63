"""Two views: eight points, decomposition, least squares, degenerate cases, other solvers."""

import importlib
import subprocess
import sys
from collections import Counter
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import NonlinearConstraint, minimize
from scipy.stats import chi2

from pcnav.config.image_motion import ImageMotionTable, MatchSolver
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, log_rotation, rotation_angle
from pcnav.estimators.image_motion import degeneracy, refinement
from pcnav.estimators.image_motion.essential import (
    decompose,
    depths,
    direction_given_rotation,
    eight_point,
    essential_of,
    homogeneous,
    in_front,
    mirrored_rotation,
    out_of_plane_angle,
    pose_of,
    sampson,
)
from pcnav.estimators.image_motion.relative import Expected, Outcome, measure

FOCAL = 2909.0
SETTINGS = ImageMotionTable()
PLACE = np.array([0.0, 0.0, 40.0])
TURN = np.array([0.95, 0.28, 0.1])


def views(
    rng: np.random.Generator,
    turn_deg: float,
    sigma_px: float = 0.0,
    count: int = 40,
    half: tuple[float, float, float] = (2.9, 2.1, 1.25),
    second: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Matches of both views, the rotation between them and the unit translation."""
    points = rng.uniform(-1.0, 1.0, (count, 3)) * half
    R = exp_rotation(np.deg2rad(turn_deg) * TURN / np.linalg.norm(TURN))
    place = PLACE if second is None else second
    a, b = points + PLACE, points @ R.T + place
    t = place - R @ PLACE
    x, y = a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:]
    x = x + sigma_px / FOCAL * rng.standard_normal(x.shape)
    y = y + sigma_px / FOCAL * rng.standard_normal(y.shape)
    length = float(np.linalg.norm(t))
    return x, y, R, t / length if length > 0.0 else t


def test_eight_points_are_exact_without_noise_and_batched() -> None:
    pairs = [views(np.random.default_rng(k), 2.0 + k) for k in range(4)]
    first, second = (np.stack([pair[i] for pair in pairs]) for i in (0, 1))
    E = eight_point(first, second)
    values = np.linalg.svd(E, compute_uv=False)
    assert values == pytest.approx(np.tile([1.0, 1.0, 0.0], (4, 1)), abs=1e-12)
    R, t = pose_of(E, first, second)
    for k, (x, y, R_true, t_true) in enumerate(pairs):
        assert rotation_angle(R[k].T @ R_true) < 1e-9
        assert t[k] == pytest.approx(t_true, abs=1e-8)
        assert eight_point(x, y) == pytest.approx(E[k], abs=1e-12)
        assert np.abs(sampson(E[k], x, y)).max() < 1e-12


def test_four_motions_and_one_with_the_points_in_front() -> None:
    first, second, R_true, t_true = views(np.random.default_rng(1), 12.0)
    R, t = decompose(3.7 * essential_of(R_true, t_true))
    assert np.linalg.det(R) == pytest.approx(np.ones(4))
    fits = [rotation_angle(Rk.T @ R_true) < 1e-9 and tk @ t_true > 0.9 for Rk, tk in zip(R, t)]  # noqa: B905
    assert sum(fits) == 1
    front = in_front(R, t, np.stack([first] * 4), np.stack([second] * 4)).mean(axis=-1)
    assert front[np.argmax(fits)] == 1.0 and np.sort(front)[-2] < 0.5
    z1, z2 = depths(R_true, t_true, first, second)
    carried = z1[:, None] * homogeneous(first) @ R_true.T + t_true
    assert carried == pytest.approx(z2[:, None] * homogeneous(second))


def test_the_direction_follows_from_the_rotation() -> None:
    first, second, R, t = views(np.random.default_rng(2), 8.0, second=np.array([1.0, -2.0, 43.0]))
    assert direction_given_rotation(R, first, second) == pytest.approx(t, abs=1e-9)


def test_the_mirrored_rotation_turns_the_other_way_out_of_the_image_plane() -> None:
    first, second, R, _ = views(np.random.default_rng(3), 15.0)
    mirrored = mirrored_rotation(R, first, second)
    assert np.linalg.det(mirrored) == pytest.approx(1.0)
    assert mirrored_rotation(mirrored, first, second) == pytest.approx(R)
    assert out_of_plane_angle(mirrored, first, second) == pytest.approx(
        out_of_plane_angle(R, first, second)
    )
    # From far away it explains the matches nearly as well: a pixel where they moved by dozens.
    t = direction_given_rotation(mirrored, first, second)
    wrong = np.sqrt(np.mean(sampson(essential_of(mirrored, t), first, second) ** 2))
    turned = exp_rotation(np.array([0.0, 0.0, 0.1])) @ R
    other = direction_given_rotation(turned, first, second)
    much = np.sqrt(np.mean(sampson(essential_of(turned, other), first, second) ** 2))
    assert FOCAL * wrong < 3.0 < FOCAL * much


def test_sampson_errors_are_distances_to_the_nearest_pairs_that_agree() -> None:
    """By hand, and against the nearest pair on the epipolar constraint."""
    # A shift along x: lines are rows, and half of a step between rows is to be blamed on each view.
    aside = essential_of(np.eye(3), np.array([1.0, 0.0, 0.0]))
    step = sampson(aside, np.array([[0.1, 0.2]]), np.array([[0.3, 0.2 + 1e-3]]))
    assert np.abs(step) == pytest.approx(1e-3 / np.sqrt(2.0))
    first, second, R, t = views(np.random.default_rng(6), 8.0, 0.5, count=3)
    E = essential_of(R, t)
    for a, b, found in zip(first, second, sampson(E, first, second), strict=True):
        agreeing = nearest_pair(E, np.concatenate([a, b]))
        off_px = FOCAL * np.linalg.norm(agreeing - np.concatenate([a, b]))
        assert FOCAL * abs(found) == pytest.approx(off_px, rel=1e-3, abs=1e-4)


def nearest_pair(E: FloatArray, pair: FloatArray) -> FloatArray:
    """(4,) nearest to a match (4,) of those on the epipolar constraint."""
    found = cast(Any, minimize)(
        lambda each: float(FOCAL**2 * np.sum((each - pair) ** 2)),
        pair,
        constraints=NonlinearConstraint(
            lambda each: FOCAL * (homogeneous(each[2:]) @ E @ homogeneous(each[:2])), 0.0, 0.0
        ),
        method="SLSQP",
        options={"ftol": 1e-14},
    )
    return np.asarray(found.x)


def test_least_squares_derivatives_and_gains_against_differences() -> None:
    first, second, R, t = views(np.random.default_rng(4), 6.0, 0.3, count=12)
    sigma = 0.3 / FOCAL
    residuals, jacobian = refinement._linearised(R[None], t[None], first, second, sigma)
    step = 1e-6
    for k in range(5):
        delta = np.zeros((1, 5))
        delta[0, k] = step
        R_moved = R[None] @ exp_rotation(delta[:, :3])
        t_moved = refinement._moved(t[None], delta[:, 3:])
        ahead, _ = refinement._linearised(R_moved, t_moved, first, second, sigma)
        slope = (ahead - residuals)[0] / step
        assert jacobian[0, :, k] == pytest.approx(slope, rel=1e-4, abs=1e-4 * np.abs(slope).max())
    # Where the residuals are zero Gauss-Newton has all of the curvature.
    first, second, R, t = views(np.random.default_rng(4), 6.0, count=12)
    refined = refinement.refine(R[None], t[None], first, second, sigma)
    gain = refinement.motion_gain(refined.R[0], refined.t[0], first, second, sigma)
    for k in range(3):
        moved = second.copy()
        moved[k, 0] += 1e-5
        again = refinement.refine(refined.R, refined.t, first, moved, sigma)
        eps = log_rotation(refined.R[0].T @ again.R[0]) / 1e-5
        assert gain.by_second[k, :, 0] == pytest.approx(eps, rel=5e-3, abs=5e-3 * np.abs(eps).max())
    total = sigma**2 * sum(np.einsum("nik,njk->ij", g, g) for g in (gain.by_first, gain.by_second))
    assert total == pytest.approx(gain.covariance, rel=1e-6, abs=1e-9 * np.trace(gain.covariance))


@pytest.mark.parametrize(("sigma_px", "turn_deg"), [(0.02, 2.0), (0.1, 8.0), (0.5, 25.0)])
def test_the_covariance_of_a_rotation_is_true(sigma_px: float, turn_deg: float) -> None:
    squared = []
    for draw in range(40):
        first, second, R, _ = views(np.random.default_rng([draw, 5]), turn_deg, sigma_px)
        found = measure(first, second, sigma_px / FOCAL, SETTINGS)
        if found.motion is None or found.covariance is None:
            continue
        eps = log_rotation(found.motion.R_second_first.T @ R)
        squared.append(eps @ np.linalg.solve(found.covariance, eps))
    degrees = 3 * len(squared)
    assert len(squared) >= 36
    assert chi2.ppf(0.001, degrees) < sum(squared) < chi2.ppf(0.999, degrees)


def test_wrong_matches_break_the_eight_point_method_and_not_the_robust_one() -> None:
    plain = ImageMotionTable(solver=MatchSolver.EIGHT_POINT)
    robust_deg: list[float] = []
    plain_deg: list[float] = []
    for draw in range(10):
        rng = np.random.default_rng([draw, 6])
        first, second, R, _ = views(rng, 10.0, 0.1)
        bad = rng.uniform(size=len(second)) < 0.2
        second[bad] = rng.permutation(second)[bad] + 0.02 * rng.standard_normal((bad.sum(), 2))
        for settings, errors in ((SETTINGS, robust_deg), (plain, plain_deg)):
            found = measure(first, second, 0.1 / FOCAL, settings)
            assert found.motion is not None
            errors.append(float(np.rad2deg(rotation_angle(found.motion.R_second_first.T @ R))))
    assert np.median(robust_deg) < 1.0 and np.median(plain_deg) > 5.0


def outcomes(
    kind: str, wrong: float = 0.0, draws: int = 10, sigma_px: float = 0.1
) -> Counter[Outcome]:
    counted: Counter[Outcome] = Counter()
    for draw in range(draws):
        rng = np.random.default_rng([draw, 7])
        half = (2.9, 2.1, 1e-9) if kind == "plane" else (2.9, 2.1, 1.25)
        R = exp_rotation(np.deg2rad(10.0) * TURN / np.linalg.norm(TURN))
        second_place = R @ PLACE if kind == "rotation" else None
        turn = 0.0 if kind == "repeated" else 10.0
        count = 7 if kind == "few" else 40
        first, second, _, _ = views(rng, turn, sigma_px, count, half, second_place)
        bad = rng.uniform(size=count) < wrong
        second[bad] = rng.permutation(second)[bad]
        found = measure(first, second, sigma_px / FOCAL, SETTINGS)
        assert (found.motion is None) == (found.outcome is not Outcome.MEASURED)
        counted[found.outcome] += 1
    return counted


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [
        ("few", Outcome.FEW_MATCHES),
        ("repeated", Outcome.NO_MOTION),
        ("rotation", Outcome.NO_PARALLAX),
        ("plane", Outcome.PLANAR),
        ("tumbling", Outcome.MEASURED),
    ],
)
def test_what_does_not_determine_a_motion_is_said(kind: str, outcome: Outcome) -> None:
    # A tenth may fail a test of 99.9 % or find no consensus; none is passed off as measured.
    assert outcomes(kind)[outcome] >= 9
    if kind != "tumbling":
        assert outcomes(kind)[Outcome.MEASURED] == 0
        assert outcomes(kind, wrong=0.2)[Outcome.MEASURED] == 0


def test_a_small_turn_far_away_is_seldom_determined_and_never_silently_wrong() -> None:
    measured = 0
    for draw in range(20):
        first, second, R, _ = views(np.random.default_rng([draw, 8]), 0.5, 0.1)
        found = measure(first, second, 0.1 / FOCAL, SETTINGS)
        if found.motion is None or found.covariance is None:
            continue
        eps = log_rotation(found.motion.R_second_first.T @ R)
        assert eps @ np.linalg.solve(found.covariance, eps) < chi2.ppf(1.0 - 1e-4, 3)
        measured += 1
    assert measured <= 2


def test_what_is_expected_chooses_and_does_not_pull() -> None:
    first, second, R, _ = views(np.random.default_rng(9), 10.0, 0.1)
    free = measure(first, second, 0.1 / FOCAL, SETTINGS)
    off = R @ exp_rotation(np.deg2rad(np.array([1.0, 1.0, 1.0])))
    told = measure(first, second, 0.1 / FOCAL, SETTINGS, Expected(off, np.deg2rad(2.0)))
    assert free.motion is not None and told.motion is not None
    apart = rotation_angle(free.motion.R_second_first.T @ told.motion.R_second_first)
    assert apart < 1e-6


def test_random_matches_have_no_consensus() -> None:
    rng = np.random.default_rng(10)
    first, second = 0.07 * rng.uniform(-1.0, 1.0, (2, 40, 2))
    assert measure(first, second, 0.1 / FOCAL, SETTINGS).outcome is Outcome.NO_CONSENSUS


def test_the_rotations_of_a_plane_against_opencv() -> None:
    cv2 = pytest.importorskip("cv2", reason="the extra `images` is not installed")
    rng = np.random.default_rng(11)
    points = np.column_stack([rng.uniform(-2.0, 2.0, (20, 2)), np.zeros(20)])
    points[:, 2] = 0.4 * points[:, 0] - 0.2 * points[:, 1]
    R = exp_rotation(np.array([0.2, -0.3, 0.1]))
    a, b = points + np.array([0.1, 0.2, 8.0]), points @ R.T + np.array([-0.4, 0.3, 7.0])
    first, second = a[:, :2] / a[:, 2:], b[:, :2] / b[:, 2:]
    H, judged = degeneracy.plane(first, second, 1e-6)
    assert judged.explains
    ours = degeneracy.rotations_of_plane(H, first, second)
    assert 1 <= len(ours) <= 2
    assert min(rotation_angle(each.T @ R) for each in ours) < 1e-7
    theirs = cv2.decomposeHomographyMat(H, np.eye(3))[1]
    for each in ours:
        assert min(rotation_angle(each.T @ other) for other in theirs) < 1e-6


def test_against_opencv_recover_pose() -> None:
    cv2 = pytest.importorskip("cv2", reason="the extra `images` is not installed")
    for draw in range(5):
        first, second, _, _ = views(np.random.default_rng([draw, 12]), 15.0)
        E, _ = cv2.findEssentialMat(first, second, np.eye(3), method=cv2.LMEDS)
        _, R, t, _ = cv2.recoverPose(E[:3], first, second, np.eye(3))
        ours_R, ours_t = pose_of(eight_point(first, second), first, second)
        assert rotation_angle(ours_R.T @ R) < 1e-3
        assert ours_t == pytest.approx(t.ravel(), abs=5e-3)
        # The same matrix must give the same one of four motions.
        again_R, again_t = pose_of(E[:3], first, second)
        assert rotation_angle(again_R.T @ R) < 1e-6 and again_t @ t.ravel() > 0.999


def test_least_squares_against_poselib() -> None:
    """Its own refinement of the same matches has a minimum where ours is."""
    poselib = pytest.importorskip("poselib", reason="the extra `images` is not installed")
    camera = {"model": "SIMPLE_PINHOLE", "width": 0, "height": 0, "params": [FOCAL, 0.0, 0.0]}
    for draw in range(5):
        first, second, R, t = views(np.random.default_rng([draw, 13]), 12.0, 0.1)
        start = poselib.CameraPose()
        start.R, start.t = R, t
        options = {"max_iterations": 200, "loss_type": "TRIVIAL"}
        theirs, _ = poselib.refine_relative_pose(
            FOCAL * first, FOCAL * second, start, camera, camera, options
        )
        found = measure(first, second, 0.1 / FOCAL, SETTINGS)
        assert found.motion is not None and found.covariance is not None
        if not found.agreeing.all():
            continue
        apart = log_rotation(found.motion.R_second_first.T @ np.array(theirs.R))
        assert np.sqrt(apart @ np.linalg.solve(found.covariance, apart)) < 0.05


def test_without_the_library_one_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing(name: str, *_: object) -> object:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    first, second, _, _ = views(np.random.default_rng(14), 10.0)
    with pytest.raises(InputError, match="extra `images`"):
        measure(first, second, 0.1 / FOCAL, SETTINGS)
    plain = ImageMotionTable(solver=MatchSolver.EIGHT_POINT)
    assert measure(first, second, 0.1 / FOCAL, plain).outcome is Outcome.MEASURED


def test_neither_library_is_needed_to_import_the_chain() -> None:
    program = (
        "import sys; sys.modules['cv2'] = sys.modules['poselib'] = None\n"
        "import pcnav.estimators.image_motion.chain, pcnav.perception.feature_tracking\n"
        "import pcnav.recordings.images, pcnav.simulation.images"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_a_motion_that_would_show_features_from_both_sides_is_not_believed() -> None:
    """Matches made by a turn of 150 degrees are exact, and yet no feature can be seen so."""
    rng = np.random.default_rng(8)
    points = rng.uniform(-1.0, 1.0, (30, 3))
    R, place = exp_rotation(np.deg2rad([150.0, 0.0, 0.0])), np.array([0.0, 0.0, 12.0])
    first, second = points + place, points @ R.T + place
    matches = [p[:, :2] / p[:, 2:] for p in (first, second)]
    found = measure(matches[0], matches[1], 1e-5, ImageMotionTable())
    assert found.outcome is Outcome.NO_CONSENSUS and found.motion is None
    wide = ImageMotionTable(max_turn_deg=180.0)
    assert measure(matches[0], matches[1], 1e-5, wide).outcome is Outcome.MEASURED
