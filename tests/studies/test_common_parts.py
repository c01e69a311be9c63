"""What all studies are made of: cells and verdicts, panels, texts, planned runs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import RunError
from pcnav.batch.monte_carlo import Case, Run, runs_of
from pcnav.core.statistics import mean_squared
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from studies.folder import Study, StudyFigure
from studies.panels import bars_figure, error_panel, mean_squared_panel
from studies.tables import always, at_most, below, cell, inside, never, table, table_of, verdict
from studies.text import study_of
from studies.work import Work


def test_cells_show_values_by_their_kind() -> None:
    shown = [cell(value) for value in ("a", "", None, np.nan, True, np.False_, np.int64(1200))]
    assert shown == ["a", "-", "-", "-", "yes", "no", "1200"]
    assert cell(np.float64(0.012345)) == "0.0123" and cell(np.array(2.0)) == "2.00"
    assert cell([1.0, None, 3]) == "1.00 / - / 3"


def test_tables_of_records_and_tables_without_any() -> None:
    columns = {"name": lambda word: word, "letters": len}
    found = table_of("key", ["a", "bcd"], columns)
    assert found.header == ("name", "letters") and found.rows == (("a", "1"), ("bcd", "3"))
    assert table("key", ("a", "b"), []).rows == (("none", "-"),)


def test_claims_are_met_up_to_their_bound() -> None:
    assert at_most("c", "q", [1.0, 2.0], 2.0).met and not at_most("c", "q", [1.0, 2.1], 2.0).met
    assert not below("c", "q", [0.5], 0.5).met and not at_most("c", "q", [1.0, np.nan], 2.0).met
    assert cell(at_most("c", "q", [1, 3], 10).ours) == "3"
    assert never("c", "q", 0).met and not never("c", "q", 1).met
    assert always("c", "q", [True]).met and always("c", "q", [True, False]).ours == "1 of 2"
    squared = np.random.default_rng(1).chisquare(3, 200)
    claims = [
        inside("c", "fair", mean_squared(squared, 3)),
        inside("c", "far", mean_squared(2.0 * squared, 3)),
    ]
    rows = verdict(claims, "chapter", "bar").rows
    assert [row[-1] for row in rows] == ["yes", "no"] and rows[0][0] == "c"


def test_panels_stand_gaps_and_long_series() -> None:
    time_s = np.arange(4000.0)
    error = np.random.default_rng(2).standard_normal(4000)
    error[:10], error[2000:2600] = 100.0, np.nan
    judged = mean_squared(np.abs(error)[None] * [[30.0]], 1)
    unknown = mean_squared(np.full((2, 4000), np.nan), 3)
    panels = [
        error_panel("x, m", error, np.ones(4000), printed=2.0, settled_from=100),
        error_panel("y, m", np.full(4000, np.nan)),
        Panel("dots", [Curve("error", error, style=".")], Scale.ABOUT_ZERO),
        mean_squared_panel("far", judged),
        mean_squared_panel("none", unknown),
    ]
    assert panels[0].limits is not None and panels[0].limits[1] < 5.0, "not the start-up"
    figure = StudyFigure("key", panels_figure(time_s, panels, dark=[(2000.0, 2600.0)]))
    assert figure.svg.startswith(b"<?xml") and len(figure.svg) < 400_000
    bars = bars_figure({"a": np.ones(2), "b": np.ones(2)}, ("1", "2"), ("x", "y"))
    assert StudyFigure("bars", bars).svg.startswith(b"<?xml")


DRAWN = Figure()
PAGE = """# Title
The line
below.

- best: {best:g} deg: at 1 %: {runs}
- worst: 3

## First
Made of {runs} runs.

{cut}

### table settings: Settings
| a | b |
| --- | --- |
| {runs} | 2 |

Below it.

## Second

### table errors: Errors of {runs} runs
A
note.

### figure? never: Not drawn

### figure errors: Drawn: once
Its caption.
"""


def page(folder: Path, figures: Sequence[StudyFigure], **fields: object) -> Study:
    (folder / "text.md").write_text(PAGE)
    errors = table("errors", ("a", "b"), [(1, 2)])
    return study_of(folder, 4, [errors], figures, shown=("errors",), pipelines={}, **fields)


def test_the_text_lays_out_the_page(tmp_path: Path) -> None:
    made = page(tmp_path, [StudyFigure("errors", DRAWN)], best=0.5, cut="")
    assert (made.title, made.lead, made.runs) == ("Title", "The line below.", 4)
    assert made.headline == (("best: 0.5 deg: at 1 %", "4"), ("worst", "3"))
    first, second = made.chapters
    assert (first.title, first.text) == ("First", ("Made of 4 runs.",))
    settings, errors = first.tables[0], second.tables[0]
    assert (settings.header, settings.rows) == (("a", "b"), (("4", "2"),))
    assert (settings.note, settings.text_columns) == ("Below it.", 2)
    assert (errors.title, errors.note) == ("Errors of 4 runs", "A note.")
    assert errors.rows == (("1", "2"),)
    assert second.figures == (StudyFigure("errors", DRAWN, "Drawn: once", "Its caption."),)


def test_a_page_without_a_field_or_a_piece_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(KeyError, match="cut"):
        page(tmp_path, [StudyFigure("errors", DRAWN)], best=0.5)
    with pytest.raises(KeyError, match="errors"):
        page(tmp_path, [], best=0.5, cut="")
    two = [StudyFigure("errors", DRAWN), StudyFigure("another", DRAWN)]
    with pytest.raises(ValueError, match=r"no place for .*another"):
        page(tmp_path, two, best=0.5, cut="")


def twice(run: Run[int]) -> int:
    """Of the setting; a case of 0 fails."""
    if not run.case.settings:
        raise ValueError("nothing to double")
    return 2 * run.case.settings


def test_planned_runs_come_back_in_order_and_are_counted_by_their_work() -> None:
    told: list[tuple[int, int]] = []
    work = Work(Workers(jobs=1), lambda *done: told.append(done))
    cases = [Case("one", 1, 3.0), Case("two", 2, 5.0)]
    runs = work.plan(twice, runs_of("study", cases, 2))
    words = work.plan(str.upper, ["a", "b"], work=2.0)
    work.run()
    assert runs.by_case == {"one": [2, 2], "two": [4, 4]} and words.results == ["A", "B"]
    assert told == [(3, 20), (6, 20), (11, 20), (16, 20), (18, 20), (20, 20)]
    work.plan(twice, [Run(Case("none", 0), 0, 7)])
    with pytest.raises(RunError, match=r"none, run 0 \(seed 7\): ValueError: nothing to double"):
        work.run()
