"""The chapter on foreign masses: which bodies it draws, and how its tables read."""

import numpy as np
import pytest

from pcnav.dynamics.inertia_parameters import parameters_from_ratios, shares
from pcnav.simulation.random_truth import satellite
from studies.blocks import JUDGED
from studies.tracking.foreign_mass import claims, foreign_truth, run_foreign, tables


def test_bodies_are_any_and_none_is_a_sheet() -> None:
    of = satellite("cubesat6u")
    ratios = np.array([foreign_truth(of, seed, 4).body.inertia_ratios for seed in range(60)])
    parameters = np.array([parameters_from_ratios(row) for row in ratios])
    assert shares(parameters)[0].min() > 0.019
    # The mean of any body's is a ball's, and products of inertia are as large as moments differ.
    assert parameters.mean(axis=0) == pytest.approx([1.0, 1.0, 0.0, 0.0, 0.0], abs=0.15)
    assert np.all(parameters.std(axis=0) > 0.15)
    assert foreign_truth(of, 7, 4) == foreign_truth(of, 7, 4)


def test_a_track_of_a_foreign_mass_is_judged_block_by_block() -> None:
    run = run_foreign("boxsat", 3, 16)
    assert run.lock is not None and run.position_m[-1] < 2e-3
    (table,) = tables({"boxsat": [run]})
    assert [row[1] for row in table.rows] == list(JUDGED)
    assert len(claims({"boxsat": [run]})) == 3 * len(JUDGED)
    # By hand: the error of the mass centre in its own covariance, half way.
    error = run.state_error[7, 6:9]
    assert run.said.trajectory.covariance is not None
    squared = error @ np.linalg.solve(run.said.trajectory.covariance[7, 6:9, 6:9], error)
    (row,) = [row for row in table.rows if row[1] == "mass centre"]
    assert float(row[5].split()[0]) == pytest.approx(squared / 3.0, abs=0.006)


def test_the_inertia_is_judged_over_its_trace() -> None:
    run = run_foreign("boxsat", 3, 12)
    trajectory = run.said.trajectory
    assert trajectory.covariance is not None
    ratios = trajectory.values["inertia_ratios"][-1]
    truth = ratios + run.state_error[-1, 15:]
    error = parameters_from_ratios(truth) - parameters_from_ratios(ratios)
    # By a central difference of the parameters.
    step = 1e-6 * np.eye(5)
    by_ratios = np.column_stack(
        [
            (parameters_from_ratios(ratios + h) - parameters_from_ratios(ratios - h)) / 2e-6
            for h in step
        ]
    )
    P = by_ratios @ trajectory.covariance[-1, 15:, 15:] @ by_ratios.T
    squared = error @ np.linalg.solve(P, error)
    assert run.nees(JUDGED["inertia ratios"])[-1] == pytest.approx(squared, rel=1e-4)
