"""The parts of the Segal 2011 study: its scenario against the print, its filters, its judge."""

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from pcnav.batch.monte_carlo import batches, runs_of
from pcnav.core.arrays import joined
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.dynamics.inertia_parameters import inertia_of, parameters_of
from pcnav.dynamics.orbit import EARTH_MU_M3_S2
from pcnav.dynamics.rigid_body import is_physical_inertia
from pcnav.simulation.motion import rotate_torque_free
from studies import run_study
from studies.segal2011 import paper
from studies.segal2011.draws import (
    Draw,
    draw_hypotheses,
    four_and_truth,
    four_moments_and_truth,
    physical_share,
    truth_only,
)
from studies.segal2011.picking import arc_information, picks_of
from studies.segal2011.runs import (
    QUANTITIES,
    Bank,
    Found,
    bank_cases,
    coupling_cases,
    motion_cases,
    run_batch,
)


def test_relative_orbit_is_the_printed_one_with_its_sign_mended():
    """(18) in the paper's own axes, radially out, along-track, orbit normal."""
    motion = paper.true_motion(duration_s=600.0, interval_s=100.0)

    def derivative(t, y):
        point = paper.ORBIT.at(t)
        nu, nu_rate, r = point.rate_rad_s, point.acceleration_rad_s2, point.radius_m
        p, v, mu = y[:3], y[3:], EARTH_MU_M3_S2
        cubed = ((r + p[0]) ** 2 + p[1] ** 2 + p[2] ** 2) ** 1.5
        return [
            *v,
            2 * nu * v[1] + nu_rate * p[1] + nu**2 * p[0] - mu * (r + p[0]) / cubed + mu / r**2,
            -2 * nu * v[0] - nu_rate * p[0] + nu**2 * p[1] - mu * p[1] / cubed,
            -mu * p[2] / cubed,
        ]

    start = [10.0, 100.0, 10.0, 0.01, -0.0225, -0.01]
    solved = solve_ivp(
        derivative, (0.0, 600.0), start, t_eval=motion.times_s, rtol=1e-12, atol=1e-9
    )
    np.testing.assert_allclose(motion.r_hill, solved.y[:3].T @ paper.R_HILL_PAPER.T, atol=1e-4)
    np.testing.assert_allclose(motion.v_hill, solved.y[3:].T @ paper.R_HILL_PAPER.T, atol=1e-6)


def test_start_is_as_printed():
    motion = paper.true_motion(duration_s=10.0)
    assert np.degrees(paper.ORBIT.at(0.0).rate_rad_s) == pytest.approx(0.0656, abs=1e-9)
    np.testing.assert_allclose(np.linalg.det(paper.R_HILL_PAPER), 1.0)
    # (16e) in the paper's axes, where the attitude at the start is the identity.
    chaser = np.array([0.0, -paper.ORBIT.at(0.0).rate_rad_s, 0.0])
    ours = motion.R_hill_body[0] @ motion.omega_body[0] - chaser
    printed = np.radians([0.1, 0.1, 0.1 - 0.0656])
    np.testing.assert_allclose(paper.R_HILL_PAPER.T @ ours, printed, atol=1e-9)


def test_image_coordinates_are_those_of_the_print():
    """(3) and (4): columns along the radius, rows along the normal, over the along-track."""
    p = np.array([11.0, 98.0, 9.0])
    u, v, u_second, v_second = paper.RIG.project(paper.R_RIG_HILL @ paper.R_HILL_PAPER @ p)
    # Image right is nadir.
    np.testing.assert_allclose([-u, v], [p[0] / p[1], p[2] / p[1]])
    np.testing.assert_allclose([-u_second, v_second], [(p[0] + 1.0) / p[1], p[2] / p[1]])


def test_draws():
    rng = np.random.default_rng(0)
    physical = draw_hypotheses(Draw.PHYSICAL, 50, rng)
    assert all(is_physical_inertia(each) for each in physical)
    printed = draw_hypotheses(Draw.PRINTED, 4000, rng)
    # The mean of a Wishart matrix is its scale times its degrees of freedom.
    square = paper.TARGET_INERTIA @ paper.TARGET_INERTIA.T
    mean = printed.mean(axis=0) - paper.TARGET_INERTIA
    np.testing.assert_allclose(mean, square, rtol=0.1, atol=0.02 * square.max())
    assert 0.0005 < physical_share(Draw.PRINTED, 20000, rng) < 0.005
    assert 0.15 < physical_share(Draw.PHYSICAL, 20000, rng) < 0.25
    for body in four_moments_and_truth(rng):
        assert is_physical_inertia(body)
        np.testing.assert_allclose(
            body @ paper.TARGET_INERTIA, paper.TARGET_INERTIA @ body, atol=1e-9
        )


def followed(bank: Bank, count: int) -> Found:
    return run_batch(batches(runs_of("test", [bank.case("test")], count), count)[0])


def test_a_batch_is_its_runs():
    """Errors do not depend on what else is in the array."""
    bank = Bank(four_and_truth, paper.true_motion(duration_s=40.0), blend=2)
    runs = runs_of("test", [bank.case("test")], 3)
    together = run_batch(batches(runs, 3)[0])
    alone = [run_batch(batch) for batch in batches(runs, 1)]
    apart = joined(alone, axis=1)
    np.testing.assert_array_equal(together.inertia, apart.inertia)
    np.testing.assert_allclose(together.errors, apart.errors, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(together.log_innovation[-1], apart.log_innovation[-1], rtol=1e-6)
    np.testing.assert_allclose(together.blended, apart.blended, rtol=1e-5, atol=1e-9)


def test_the_filter_that_knows_the_inertia_is_consistent_and_improves():
    found = followed(Bank(truth_only, paper.true_motion(duration_s=200.0)), 20)
    nees = found.nees[:, :, 0].mean(axis=1)
    # The priors are wider than the truth is spread, hence the lower side is not judged.
    assert np.all(nees < chi2.ppf(0.999, 12 * 20) / 20)
    errors = np.median(found.errors[:, :, 0], axis=1)
    last = dict(zip(QUANTITIES, errors[-1], strict=True))
    assert last["position, m"] < 0.6 * errors[0, 0]
    assert last["velocity, m/s"] < 0.05 * errors[0, 1]
    assert last["angular rate, deg/s"] < 0.05 * errors[0, 3]


def test_without_coupled_errors_the_stated_covariance_is_wrong():
    coupled = Bank(truth_only, paper.true_motion(duration_s=60.0))
    uncoupled = coupling_cases(coupled.motion)[0].settings
    assert followed(coupled, 4).nees[-1].mean() < 30.0
    assert followed(uncoupled, 4).nees[-1].mean() > 300.0


def test_truth_is_picked_and_the_bank_beats_a_random_inertia():
    case = bank_cases(paper.true_motion())[0]
    found = followed(case.settings, 8)
    picks = picks_of("as printed", case, found, np.arange(1, 6), 5)
    assert picks.rank == 11
    assert picks.observable.sum() >= 6
    assert np.all(picks.right[picks.observable])
    bank = found.errors_of(found.picked(np.arange(5)))[-1, :, 2]
    random = found.errors[-1, :, 0, 2]
    assert np.median(bank) < np.median(random)
    assert np.percentile(bank, 90) < np.percentile(random, 90)


def test_rank_of_a_pure_spin_is_eight():
    spin = motion_cases(paper.true_motion())[3].settings.motion
    information = arc_information(
        paper.TARGET_INERTIA, spin.omega_body[0], spin.times_s, paper.ATTITUDE_SD_RAD, 1e-9
    )
    sd = information.standard_deviations()
    assert np.sum(sd < 10.0) == 2
    assert not information.observable


def test_information_of_an_arc_is_that_of_its_numerical_derivatives():
    omega, times = np.array([0.02, 0.015, -0.01]), np.linspace(0.0, 60.0, 31)
    sd, axes_sd = 1e-3, 0.02

    def turns(unknown):
        """Of the points since the first frame: offset, rate, axes of the body, inertia."""
        offset, rate, axes = (unknown[k : k + 3] for k in (0, 3, 6))
        N = inertia_of(parameters_of(paper.TARGET_INERTIA) + unknown[9:])
        R = exp_rotation(axes)
        attitudes, _ = rotate_torque_free(np.eye(3), omega + rate, R @ N @ R.T, times)
        return exp_rotation(offset) @ attitudes

    step, columns = 1e-4, []
    for direction in np.eye(14):
        after, before = turns(step * direction), turns(-step * direction)
        columns.append(log_rotation(after @ np.swapaxes(before, 1, 2)).ravel() / (2.0 * step))
    jacobian = np.stack(columns, axis=1) / sd
    full = jacobian.T @ jacobian
    full[6:9, 6:9] += np.eye(3) / axes_sd**2
    expected = np.linalg.inv(np.linalg.inv(full)[9:, 9:])
    root = arc_information(paper.TARGET_INERTIA, omega, times, sd, axes_sd).root
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(root.T @ root / scale, expected / scale, atol=1e-4)


@pytest.mark.study
def test_a_quick_study_writes_everything(tmp_path: Path) -> None:
    out = tmp_path / "segal2011"
    done: list[tuple[int, int]] = []
    summary = run_study("segal2011", out, runs=2, on_progress=lambda k, n: done.append((k, n)))
    assert summary.page.read_text(encoding="utf-8").count("<figure>") == 9
    names = {path.stem for path in (out / "tables").glob("*.csv")}
    assert names == {
        "verdict",
        "settings",
        "plain",
        "bank_physical",
        "bank_printed",
        "picking",
        "coupling",
    }
    with (out / "tables" / "verdict.csv").open(newline="", encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) >= 6
    assert done[-1][0] == done[-1][1]
