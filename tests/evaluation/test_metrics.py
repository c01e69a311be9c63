"""Errors and consistency against scipy, evo and closed forms on runs of known covariance."""

import io
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, invert_transform, make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
)
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.dynamics.state import STATE_SIZE, NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.interface import AxesPolicy
from pcnav.evaluation.consistency import consistency, squared_normalised_errors
from pcnav.evaluation.errors import errors, match_times, principal_rotation, relabelled
from pcnav.evaluation.metrics import PERCENTILES, Metrics, distribution, evaluate
from pcnav.files.text_table import number
from pcnav.report.summary import summary_table
from pcnav.runs.run import Run
from pcnav.runs.status import Status
from tests.made_runs import made_run


def quantity(metrics: Metrics, key: str) -> tuple[str, FloatArray]:
    """Unit and the numbers (rms, percentiles, maximum) of the whole run."""
    found = {each.key: each for each in metrics.quantities}[key]
    return found.unit, np.array([found.whole.rms, *found.whole.percentiles, found.whole.maximum])


def statistics(norms: FloatArray) -> FloatArray:
    """The same by definition, percentiles by sorting."""
    rms = np.sqrt(np.square(norms).sum() / len(norms))
    return np.array([rms, *np.quantile(norms, np.array(PERCENTILES) / 100.0), max(norms)])


@pytest.fixture(scope="module")
def honest(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Any, Run, Path]:
    run = made_run("depth", 400)
    folder = tmp_path_factory.mktemp("honest") / "run"
    return run, run.stored(folder), folder


def test_state_errors_are_the_states_own(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    found = errors(track, run.truth)
    known = np.flatnonzero(track.has_estimate)
    assert len(known) == 397
    state = np.hstack([found[block] for block in track.trajectory.layout.blocks])
    for i in known[::40]:
        own = NavigationState(*(run.estimates[i][block] for block in MASS_CENTRE_LAYOUT.blocks))
        true = NavigationState.of(run.truth, i)
        np.testing.assert_allclose(state[i], own.ratio_error(true), rtol=1e-9, atol=1e-13)
    assert np.isnan(state[~track.has_estimate]).all()


def test_pose_errors_agree_with_evo_on_the_written_file(honest: tuple[Any, Run, Path]) -> None:
    run, track, folder = honest
    estimated = file_interface.read_tum_trajectory_file(str(folder / "poses.tum"))
    first = int(np.argmax(track.has_estimate))
    reference = PoseTrajectory3D(
        poses_se3=list(run.truth.T_cam_target[first:]), timestamps=run.truth.time_s[first:]
    )
    metrics = evaluate(track, run.truth)
    for key, relation in (
        ("position_cam", evo_metrics.PoseRelation.translation_part),
        ("attitude", evo_metrics.PoseRelation.rotation_angle_deg),
    ):
        ape = evo_metrics.APE(relation)
        ape.process_data((reference, estimated))
        theirs = ape.get_all_statistics()
        unit, ours = quantity(metrics, key)
        assert unit == {"position_cam": "m", "attitude": "deg"}[key]
        expected = [theirs["rmse"], theirs["median"], theirs["max"]]
        np.testing.assert_allclose(ours[[0, 1, -1]], expected, rtol=1e-6)


def test_every_quantity_is_the_norm_in_its_unit(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    metrics = evaluate(track, run.truth)
    k = track.has_estimate
    relative = Rotation.from_matrix(run.truth[ATTITUDE][k]).inv() * Rotation.from_matrix(
        track.trajectory[ATTITUDE][k]
    )
    for key, unit, norms in (
        ("attitude", "deg", np.rad2deg(relative.magnitude())),
        (
            "r_hill",
            "m",
            np.linalg.norm(track.trajectory[POSITION] - run.truth[POSITION], axis=1)[k],
        ),
        (
            "v_hill",
            "m/s",
            np.linalg.norm(track.trajectory[VELOCITY] - run.truth[VELOCITY], axis=1)[k],
        ),
        (
            "omega_body",
            "deg/s",
            np.linalg.norm(track.trajectory[RATE] - run.truth[RATE], axis=1)[k] * 180.0 / np.pi,
        ),
        ("com_model", "m", np.linalg.norm(track.trajectory[CENTRE] - run.truth[CENTRE], axis=1)[k]),
        (
            "inertia_ratios",
            "1",
            np.linalg.norm(track.trajectory[RATIOS] - run.truth[RATIOS], axis=1)[k],
        ),
    ):
        assert norms.min() > 0.0
        told, numbers = quantity(metrics, key)
        assert told == unit
        np.testing.assert_allclose(numbers, statistics(norms), rtol=1e-7)


def test_parts_of_the_run_are_parts_of_its_time(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    whole = evaluate(track, run.truth)
    norms = np.linalg.norm(track.trajectory[POSITION] - run.truth[POSITION], axis=1)
    r_hill = {each.key: each for each in whole.quantities}["r_hill"]
    assert r_hill.second_half.frames == 200
    # Frame 266 lies on the border of the last third, give or take a rounding error.
    third = r_hill.last_third.frames
    assert third in {133, 134}
    assert r_hill.last_third.rms == pytest.approx(np.sqrt(np.mean(norms[-third:] ** 2)))
    assert r_hill.second_half.maximum == pytest.approx(norms[200:].max())


def test_nees_of_honest_errors_lies_within_its_bounds(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    blocks = {block.name: block for block in evaluate(track, run.truth).nees}
    assert set(blocks) == {*(block.name for block in MASS_CENTRE_LAYOUT.blocks), "all"}
    for block in blocks.values():
        # Here frames are independent. Eight correlated 95 % tests of one fixed draw: half as wide
        # again is all they need.
        low, high = chi2.interval(0.95, block.degrees) / np.array(block.degrees)
        slack = 0.5 * (high - low) / 2.0
        assert low - slack < block.mean_per_degree < high + slack
        assert block.lower < low and high < block.upper
        assert 0.92 < block.share_inside < 0.98
        assert block.unusable_frames == 0
    whole = blocks["all"]
    assert whole.degrees == 397 * 20
    # Errors of a filter are correlated: the bounds are those of a single frame.
    np.testing.assert_allclose(
        [whole.lower, whole.upper], chi2.interval(0.95, 20) / np.array(20), rtol=1e-12
    )


@pytest.mark.parametrize("inflation", [0.6, 1.4])
def test_nees_tells_covariances_of_the_wrong_size(tmp_path: Path, inflation: float) -> None:
    run = made_run("depth", 200, inflation)
    track = run.stored(tmp_path / "run")
    for block in evaluate(track, run.truth).nees:
        outside = block.mean_per_degree - (block.upper if inflation > 1.0 else block.lower)
        assert outside * (inflation - 1.0) > 0.0 or block.name != "all"
        assert block.mean_per_degree == pytest.approx(inflation**2, rel=0.15)


def test_squared_errors_match_a_plain_solve_across_scales() -> None:
    generator = np.random.default_rng(1)
    factor = generator.standard_normal((30, 6, 9))
    scale = np.array([1e3, 1.0, 1e-4, 1e-8, 1e-12, 1e5])
    unscaled = factor @ np.swapaxes(factor, 1, 2)
    error = generator.standard_normal((30, 6))
    expected = [e @ np.linalg.solve(P, e) for e, P in zip(error, unscaled, strict=True)]
    got = squared_normalised_errors(error * scale, unscaled * scale[:, None] * scale)
    np.testing.assert_allclose(got, expected, rtol=1e-9)


def test_a_covariance_that_is_none_is_counted_not_used() -> None:
    singular = np.ones((2, 2))
    indefinite = np.array([[1.0, 2.0], [2.0, 1.0]])
    covariance = np.stack([np.eye(2), singular, indefinite, np.zeros((2, 2)), np.eye(2) * np.nan])
    squared = squared_normalised_errors(np.ones((5, 2)), covariance)
    np.testing.assert_array_equal(squared, [2.0, *[np.nan] * 4])
    judged = consistency("x", squared, np.full(5, 2))
    assert (judged.frames, judged.unusable_frames, judged.mean_per_degree) == (1, 4, 1.0)
    assert np.isnan(consistency("x", squared[1:], np.full(4, 2)).mean_per_degree)


def test_nis_sums_over_changing_degrees_of_freedom(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    nis = evaluate(track, None).nis
    frames = [each for each in run.estimates if each.nis_dof]
    degrees = sum(each.nis_dof for each in frames)
    assert len({each.nis_dof for each in frames}) == 3
    assert nis.frames == len(frames) < len(run.estimates)
    assert nis.mean_per_degree == pytest.approx(sum(each.nis for each in frames) / degrees)
    assert nis.lower == pytest.approx(chi2.ppf(0.025, degrees) / degrees)
    assert nis.lower < nis.mean_per_degree < nis.upper
    inside = [chi2.cdf(each.nis, each.nis_dof) for each in frames]
    assert nis.share_inside == pytest.approx(np.mean([0.025 <= p <= 0.975 for p in inside]))


def test_what_a_run_says_of_itself(honest: tuple[Any, Run, Path]) -> None:
    _, track, _ = honest
    metrics = evaluate(track, None)
    assert (metrics.frames, metrics.frames_with_estimate) == (400, 397)
    assert metrics.first_estimate_after_s == 1.5
    assert metrics.duration_s == 199.5
    assert metrics.status_share["acquiring"] == 3 / 400
    assert sum(metrics.status_share.values()) == pytest.approx(1.0)
    assert next(iter(metrics.status_share)) == "locked"
    assert (metrics.quantities, metrics.nees) == ((), ())


def test_a_truth_of_poses_alone_gives_pose_errors_alone(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    poses = Trajectory(run.truth.time_s, POSE_LAYOUT, T_cam_target=run.truth.T_cam_target)
    metrics = evaluate(track, poses)
    assert [each.key for each in metrics.quantities] == ["position_cam", "attitude"]
    assert metrics.nees == ()
    states = replace(run.truth, T_cam_target=None)
    keys = [each.key for each in evaluate(track, states).quantities]
    assert "position_cam" not in keys
    assert "attitude" in keys
    _, with_poses = quantity(metrics, "attitude")
    _, without = quantity(evaluate(track, states), "attitude")
    np.testing.assert_allclose(with_poses, without, rtol=1e-6)


def test_frames_are_matched_by_time_not_by_row(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    whole = evaluate(track, run.truth)
    rows = np.arange(len(run.truth.time_s))[::2]
    some = run.truth.at(rows)
    every_second = Trajectory(some.time_s + 4e-7, POSE_LAYOUT, T_cam_target=some.T_cam_target)
    metrics = evaluate(track, every_second)
    assert metrics.frames_compared == 198
    assert whole.errors is not None and metrics.errors is not None
    np.testing.assert_array_equal(metrics.errors.p_cam_m[4], whole.errors.p_cam_m[4])
    assert np.isnan(metrics.errors.p_cam_m[5]).all()
    with pytest.raises(InputError, match="time_s"):
        evaluate(track, replace(run.truth, time_s=run.truth.time_s + 0.25))


@given(
    st.lists(st.integers(-1000, 1000), min_size=1, max_size=30, unique=True),
    st.lists(st.integers(-1000, 1000), min_size=1, max_size=30),
    st.integers(0, 40),
)
def test_time_matching_is_nearest_neighbour(a: list[int], b: list[int], tolerance: int) -> None:
    truth, times = np.array(a, dtype=float), np.array(b, dtype=float)
    rows = match_times(times, truth, float(tolerance))
    distance = np.abs(times[:, None] - truth)
    for k, row in enumerate(rows):
        if row < 0:
            assert distance[k].min() > tolerance
        else:
            assert distance[k, row] == distance[k].min() <= tolerance


HALF_TURN = make_transform(exp_rotation(np.array([0.0, 0.0, np.pi])), np.array([0.4, 0.2, 0.0]))
SYMMETRIES = np.stack([np.eye(4), HALF_TURN])


def test_an_equivalent_truth_is_the_same_motion(honest: tuple[Any, Run, Path]) -> None:
    run, _, _ = honest
    other: Any = relabelled(run.truth, HALF_TURN)
    i = 50
    # Where the mass centre is in the camera, and the direction of the angular momentum.
    before = run.truth.T_cam_target[i] @ [*run.truth[CENTRE][i], 1.0]
    after = other.T_cam_target[i] @ [*other[CENTRE][i], 1.0]
    np.testing.assert_allclose(after, before, atol=1e-12)
    assert np.abs(other[CENTRE][i] - run.truth[CENTRE][i]).max() > 0.1
    np.testing.assert_allclose(
        other[ATTITUDE][i] @ other[RATE][i],
        run.truth[ATTITUDE][i] @ run.truth[RATE][i],
        atol=1e-14,
    )
    directions = []
    for truth in (run.truth, other):
        inertia = inertia_from_ratios(truth[RATIOS][i])
        momentum = truth[ATTITUDE][i] @ inertia @ truth[RATE][i]
        directions.append(momentum / np.linalg.norm(momentum))
    np.testing.assert_allclose(directions[1], directions[0], atol=1e-12)


def test_errors_are_taken_up_to_the_symmetry_of_the_target(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    plain = evaluate(track, run.truth)
    assert evaluate(track, run.truth, symmetry_transforms=SYMMETRIES).symmetry == 0
    # The truth told in the other labels: without its symmetry the run looks half a turn wrong.
    labels = relabelled(run.truth, invert_transform(HALF_TURN))
    wrong = evaluate(track, labels)
    right = evaluate(track, labels, symmetry_transforms=SYMMETRIES)
    assert right.symmetry == 1
    assert quantity(wrong, "attitude")[1][1] > 170.0
    for key in ("position_cam", "attitude", "com_model", "omega_body", "inertia_ratios"):
        np.testing.assert_allclose(
            quantity(right, key)[1], quantity(plain, key)[1], rtol=1e-6, atol=1e-12
        )
    assert right.nees[-1].mean_per_degree == pytest.approx(plain.nees[-1].mean_per_degree)
    # Half of the frames the other way: no one symmetry fits, of each frame one does.
    assert run.truth.T_cam_target is not None and labels.T_cam_target is not None
    mixed = run.truth.T_cam_target.copy()
    mixed[::2] = labels.T_cam_target[::2]
    poses = Trajectory(run.truth.time_s, POSE_LAYOUT, T_cam_target=mixed)
    turned = errors(track, poses, AxesPolicy.SYMMETRY, symmetry_transforms=SYMMETRIES)
    assert np.nanmax(np.linalg.norm(turned.theta_model_rad, axis=1)) > 3.0
    fitted = errors(track, poses, AxesPolicy.SYMMETRY_OF_FRAME, symmetry_transforms=SYMMETRIES)
    assert plain.errors is not None
    np.testing.assert_allclose(fitted.theta_model_rad, plain.errors.theta_model_rad, atol=1e-9)


def test_a_target_found_anew_may_be_found_in_another_of_its_equivalent_attitudes(
    honest: tuple[Any, Run, Path],
) -> None:
    run, track, _ = honest
    half = len(track) // 2
    other = relabelled(run.truth, invert_transform(HALF_TURN)).T_cam_target
    assert run.truth.T_cam_target is not None and other is not None
    turned = np.concatenate([run.truth.T_cam_target[:half], other[half:]])
    poses = Trajectory(run.truth.time_s, POSE_LAYOUT, T_cam_target=turned)
    largest = {}
    for word in (Status.COASTING, Status.LOST, Status.ACQUIRING):
        status = (*track.status[:half], word, *track.status[half + 1 :])
        parted = replace(track, status=status)
        found = errors(parted, poses, AxesPolicy.SYMMETRY, symmetry_transforms=SYMMETRIES)
        largest[word] = np.nanmax(np.linalg.norm(found.theta_model_rad, axis=1))
    # A track that goes on must not jump.
    assert largest[Status.COASTING] > 3.0
    assert largest[Status.LOST] == largest[Status.ACQUIRING] < 0.2


def test_distribution_of_a_known_sample() -> None:
    values = distribution(np.array([np.nan, *np.arange(101.0)]))
    assert values.frames == 101
    np.testing.assert_array_equal(values.percentiles, PERCENTILES)
    assert values.median == 50.0
    assert values.at(95) == 95.0
    assert values.maximum == 100.0
    # Sum of squares of 0..n is n (n + 1) (2 n + 1) / 6.
    assert values.rms == pytest.approx(np.sqrt(100 * 201 / 6))
    assert distribution(np.array([np.nan])).frames == 0


def test_metrics_json_says_its_units(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    content = json.loads(json.dumps(evaluate(track, run.truth).to_json(), allow_nan=False))
    assert set(content["errors"]) == {
        *("position_cam_m", "attitude_deg", "r_hill_m", "v_hill_m_s"),
        *("omega_body_deg_s", "com_model_m", "inertia_ratios"),
    }
    attitude = content["errors"]["attitude_deg"]
    assert attitude["unit"] == "deg"
    assert attitude["last_third"]["p95"] <= attitude["last_third"]["max"]
    assert content["nees"]["all"]["degrees_of_freedom"] == 397 * STATE_SIZE
    json.dumps(evaluate(replace_all_unknown(track), None).to_json(), allow_nan=False)


def replace_all_unknown(track: Run) -> Run:
    """The same frames without a single estimate."""
    values = {name: np.full_like(v, np.nan) for name, v in track.trajectory.values.items()}
    trajectory = replace(track.trajectory, values=values)
    return replace(track, trajectory=trajectory, nis=np.full(len(track), np.nan))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (13.34, "13.3"),
        (0.001234, "0.00123"),
        (123456.0, "123456"),
        (1.5e-7, "1.50e-07"),
        (np.nan, "-"),
        (-2.5, "-2.50"),
    ],
)
def test_numbers_keep_three_digits(value: float, text: str) -> None:
    assert number(value) == text


def test_the_table_shows_errors_in_readable_units(honest: tuple[Any, Run, Path]) -> None:
    run, track, _ = honest
    metrics = evaluate(track, run.truth)

    def printed(shown: Metrics) -> str:
        console = Console(file=io.StringIO(), width=80)
        console.print(summary_table(shown))
        assert isinstance(console.file, io.StringIO)
        return console.file.getvalue()

    text = printed(metrics)
    _, numbers = quantity(metrics, "r_hill")
    line = next(line for line in text.splitlines() if "mass centre in hill" in line)
    assert "mm " in line
    assert number(1e3 * numbers[0]) in line
    assert "NEES per degree of freedom" in text
    alone = printed(evaluate(track, None))
    assert "NIS per degree of freedom" in alone
    assert "397 (99.2%), the first after 1.50 s" in alone
    odd = replace(track, status=("[bold]lost[/] [/oops]",) * len(track))
    assert "[bold]lost[/] [/oops] 100.0%" in printed(evaluate(odd, None))


def test_principal_rotation_diagonalises_with_falling_moments() -> None:
    inertia = inertia_from_ratios(np.array([0.7, 0.5, 0.05, -0.02, 0.03]))
    R = principal_rotation(inertia)
    moments = R.T @ inertia @ R
    np.testing.assert_allclose(moments, np.diag(np.diag(moments)), atol=1e-14)
    assert (np.diff(np.diag(moments)) < 0.0).all()
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)
