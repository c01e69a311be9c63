"""The status over time and its evidence."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.patches import StepPatch
from scipy.stats import chi2

from pcnav.dynamics.blocks import POSITION
from pcnav.files.text_table import TextTable, number
from pcnav.report.content import ReportContent
from pcnav.report.status import (
    STATUS_COLOURS,
    status_and_evidence,
    status_figure,
    window_nis_bounds,
)
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.status import Status
from tests.report.conftest import Contents


@pytest.fixture(scope="module")
def content(make_content: Contents) -> ReportContent:
    return make_content("depth", 60)


def beside(content: ReportContent) -> tuple[Any, ...]:
    """What stands beside the figure."""
    (both,) = status_and_evidence(content)
    assert isinstance(both, tuple)
    pieces = both[1]
    assert isinstance(pieces, tuple)
    return pieces


@pytest.mark.usefixtures("quick_drawings")
def test_the_changes_are_listed_with_their_evidence(content: ReportContent) -> None:
    run = content.run
    changes = [k for k in range(1, 60) if run.status[k] != run.status[k - 1]]
    assert 3 < len(changes) < 25
    (table,) = beside(content)
    assert isinstance(table, TextTable)
    assert table.header == ("from", "to", "frame", "time, s", "inlier ratio", "NIS per dof")
    for k, row in zip(changes, table.rows, strict=True):
        evidence = (f"{run.notes['inlier_ratio'][k]:.0%}", number(run.window_nis[k]))
        assert row == (*run.status[k - 1 : k + 1], str(k), number(run.time_s[k]), *evidence)
    run = replace(run, notes={}, window_nis=np.full(60, np.nan))
    (table,) = beside(replace(content, run=run))
    assert table.header == ("from", "to", "frame", "time, s")


@pytest.mark.usefixtures("quick_drawings")
@pytest.mark.parametrize(
    ("status", "symmetry", "told"),
    [
        (("acquiring",) * 60, "C1", "The status is acquiring in every frame."),
        (("locked", "coasting") * 30, "C1", "34 later changes are not listed."),
        (("locked", "ambiguous") * 30, "D2", "symmetry group is D2"),
        (("locked", "ambiguous") * 30, "C1", "the target itself has no symmetry"),
    ],
)
def test_the_status_is_told_in_words(
    content: ReportContent, status: tuple[str, ...], symmetry: str, told: str
) -> None:
    answer = content.answer.model_copy(update={"symmetry": symmetry})
    pieces = beside(replace(content, run=replace(content.run, status=status), answer=answer))
    assert any(told in piece for piece in pieces if isinstance(piece, str))


def test_every_status_has_its_own_colour_in_the_order_of_worth() -> None:
    assert set(STATUS_COLOURS) == {str(status) for status in Status}
    assert len(set(STATUS_COLOURS.values())) == len(Status)


def test_the_status_bands_last_as_long_as_the_status(content: ReportContent) -> None:
    """Read from the drawing: frames 0.5 s apart, of which the strip shows every one."""
    run = content.run
    figure = status_figure(run)
    strip, inliers, window = figure.axes
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    for patch, label in zip(strip.patches, legend, strict=True):
        assert isinstance(patch, StepPatch)
        heights, edges, below = patch.get_data()
        covered = float(np.sum((heights - below) * np.diff(edges)))
        name, count = label.removesuffix(")").split(" (")
        assert covered == pytest.approx(0.5 * run.status.count(name))
        assert int(count) == run.status.count(name)
    np.testing.assert_array_equal(inliers.lines[0].get_ydata(), run.notes["inlier_ratio"])
    np.testing.assert_array_equal(window.lines[0].get_ydata(), run.window_nis)


def test_without_evidence_only_the_status_is_drawn(content: ReportContent) -> None:
    run = replace(content.run, notes={}, window_nis=np.full(60, np.nan))
    assert len(status_figure(run).axes) == 1


def test_the_band_of_the_window_nis_is_chi_square(make_content: Contents) -> None:
    run = make_content("depth", 400).run
    lower, upper = window_nis_bounds(run)
    for k in (3, 10, 50, 399):
        used = np.flatnonzero(run.nis_dof[: k + 1])[-NIS_WINDOW_FRAMES:]
        degrees = int(run.nis_dof[used].sum())
        if degrees:
            band = np.array(chi2.interval(0.95, degrees)) / degrees
            np.testing.assert_allclose([lower[k], upper[k]], band)
    known = np.isfinite(run.window_nis)
    np.testing.assert_array_equal(np.isfinite(lower), known)
    # The run's innovations are what they should be; neighbouring windows share most frames.
    inside = (run.window_nis >= lower) & (run.window_nis <= upper)
    assert 0.8 < inside[known].mean() <= 1.0


def test_the_window_begins_anew_with_a_new_track(content: ReportContent) -> None:
    trajectory = content.run.trajectory
    r_hill = trajectory[POSITION].copy()
    r_hill[20] = np.nan
    lost = replace(trajectory, values={**trajectory.values, POSITION.name: r_hill})
    _, upper = window_nis_bounds(replace(content.run, trajectory=lost))
    _, before = window_nis_bounds(content.run)
    np.testing.assert_array_equal(upper[:20], before[:20])
    assert (upper[22:38] > before[22:38]).all()


@pytest.mark.usefixtures("quick_drawings")
def test_the_kinds_of_motion_and_their_changes_are_told(content: ReportContent) -> None:
    words = ("",) * 2 + ("torque_free",) * 18 + ("kinematic",) * 9 + ("torque_free",) * 31
    run = replace(content.run, words={"motion": words})
    told = beside(replace(content, run=run))[-1]
    assert isinstance(told, str)
    assert "torque free in 84.5%, kinematic in 15.5%" in told
    when = [number(run.time_s[k]) for k in (20, 29)]
    assert f"to kinematic at {when[0]} s (frame 20), to torque free at {when[1]} s" in told


@pytest.mark.usefixtures("quick_drawings")
def test_doubts_are_counted(content: ReportContent) -> None:
    fields = ("",) * 40 + ("nis tilt",) * 15 + ("nis",) * 5
    told = beside(replace(content, run=replace(content.run, words={"doubts": fields})))[-1]
    assert isinstance(told, str)
    assert "nis (innovations larger than stated) in 20; tilt (" in told
    assert told.endswith("in 15.")
