"""Parts of the study of Deng 2024: what it prints, shortened."""

import numpy as np
import pytest

from pcnav.batch.cluster import Workers
from pcnav.core.spatial import log_rotation
from studies.deng2024 import consistency, paper
from studies.deng2024.consistency import monte_carlo_cases, nees_table
from studies.deng2024.filters import error_table, fitted_run, measured, printed_run, spin_table
from studies.deng2024.study import study as make_study
from studies.work import Work


@pytest.fixture(scope="module")
def study():
    return make_study(2, Work(Workers(jobs=1)))


def test_the_printed_motions():
    nutation, spin = paper.nutation(20.0), paper.spin(20.0)
    assert np.allclose(nutation.truth.printed_ratios, paper.NUTATION.ratios)
    np.testing.assert_allclose(np.degrees(spin.truth.omega_body), [[0.0, 2.3, 0.0]] * 41, atol=1e-9)
    assert np.ptp(nutation.truth.omega_body, axis=0).min() > 1e-3


def test_study_has_every_figure_and_the_ranks(study):
    figures = [figure.key for chapter in study.chapters for figure in chapter.figures]
    for key in ("fig2", "fig3", "fig4", "fig5", "fig6", "singular_values", "nees", "arc_length"):
        assert key in figures
    tables = {table.key: table for chapter in study.chapters for table in chapter.tables}
    ranks = {row[0]: (row[7], row[8]) for row in tables["ranks"].rows}
    assert ranks["printed, nutation"] == ("11", "11")
    assert ranks["random state 1"] == ranks["random state 2"] == ("11", "11")
    assert ranks["printed, spin"] == ("8", "8")
    met = {row[0]: row[3] for row in tables["verdict"].rows if row[0].startswith("rank")}
    assert set(met.values()) == {"yes"}
    assert set(study.summary_keys) <= set(tables)


def test_the_printed_filter_is_told_the_noise_that_attitudes_have():
    """R of (35) is of half angles, so that attitudes err by twice its root."""
    long, motion = paper.nutation(400.0), paper.nutation(2.0)
    noisy = measured(long, paper.HALF_ANGLE_SD_RAD, seed=4)
    off = log_rotation(np.swapaxes(long.truth.R_world_body, -1, -2) @ noisy)[1:]
    drawn = np.mean(off**2)
    run = printed_run("as printed", motion, measured(motion, paper.HALF_ANGLE_SD_RAD, seed=4))
    first, second = (np.trace(run.covariance[k, 0, :3, :3]) / 3.0 for k in (0, 1))
    assert first == pytest.approx(drawn, rel=0.1)
    # What went before is less well known by then, for the rate is not: more than half remains.
    assert 0.5 * drawn < second < 0.8 * drawn


def test_printed_filter_converges_in_nutation_only():
    motion = paper.nutation(150.0)
    exact = measured(motion, 0.0, seed=1)
    np.testing.assert_allclose(exact, motion.truth.R_world_body)
    run = printed_run("as printed", motion, exact)
    assert np.degrees(run.rms(slice(0, 3))) < 0.1
    assert np.degrees(run.rms(slice(3, 6))) < 0.3
    assert run.rms(slice(6, 11)) < 0.15
    assert np.abs(run.errors[0, 0, 6:]).max() > 0.5
    spin = paper.spin(150.0)
    stuck = printed_run("as printed", spin, measured(spin, 0.0, seed=1))
    assert np.abs(stuck.errors[-1, 0, 7]) > 0.5
    assert all(row[2] == "does not converge" for row in spin_table([stuck]).rows)


def test_fitted_filter_beats_the_printed_one():
    motion = paper.nutation(60.0, 2.0)
    noisy = measured(motion, paper.HALF_ANGLE_SD_RAD, seed=2)
    fitted, printed = (make("", motion, noisy) for make in (fitted_run, printed_run))
    assert fitted.rms(slice(0, 3)) < 0.8 * printed.rms(slice(0, 3))
    assert error_table([fitted, printed]).rows[0][2] < error_table([fitted, printed]).rows[1][2]


def test_consistency_is_told_against_its_bounds():
    case = monte_carlo_cases(3, 20.0)[0]
    result = consistency.run_case(case)
    low, high = (float(word) for word in result.bounds.split(" to "))
    assert low < 1.0 < high
    assert result.found.nees.shape == (21, 3)
    assert result.judged.mean == pytest.approx(np.mean(result.found.nees, axis=1) / 11.0)
    row = nees_table([result]).rows[0]
    assert row[0] == case.name
    inside = np.mean(result.judged.inside[result.settled])
    assert row[6] == f"{100.0 * inside:.0f} %"
    # Bounds of the mean over time are those of the means of the runs, which are independent.
    of_run = np.mean(result.found.nees[result.settled], axis=0) / 11.0
    low, high = (float(word) for word in result.mean_bounds.split(" to "))
    assert high - 1.0 == pytest.approx(1.96 * np.std(of_run, ddof=1) / np.sqrt(3.0), abs=1e-3)
    assert low + high == pytest.approx(2.0)


def test_rank_chapter_needs_no_case_twice(study):
    names = [row[0] for row in study.chapters[1].tables[0].rows]
    assert len(set(names)) == len(names)
