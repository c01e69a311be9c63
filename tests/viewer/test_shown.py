"""What the page shows is so: nothing drawn where there is nothing, nothing hidden or praised."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.core import chi_square
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATIOS
from pcnav.runs.reader import read_records
from pcnav.runs.records import ACCEPTED, AXES
from pcnav.runs.result_files import MEASUREMENTS_FILE
from pcnav.viewer.address import PageState, read_address
from pcnav.viewer.assessment import error_over_sigma
from pcnav.viewer.curves import Chart, _nis_chart, differences, groups_of
from pcnav.viewer.frames import ColourBy
from pcnav.viewer.knowledge import knowledge_html
from pcnav.viewer.layers import RunLayers, shot_of
from pcnav.viewer.loaded_run import LoadedRun, all_events
from pcnav.viewer.page import number_of, read_message
from pcnav.viewer.palette import ACCEPTED_COLOUR, REJECTED_COLOUR, RUNS
from pcnav.viewer.panels import legend_html, measurements_html
from pcnav.viewer.picking import Ray, picked_point, picked_rectangle, point_card, rectangle_card
from pcnav.viewer.plots import plots_of, with_gaps
from pcnav.viewer.render_options import Layer, RenderOptions, line_colour
from pcnav.viewer.server import LOOPBACK, LocalServer
from pcnav.viewer.status_bar import status_of_frame
from pcnav.viewer.timeline import status_spans, time_line
from tests.viewer.conftest import FRAMES

LAST = FRAMES - 1


def with_notes(loaded: LoadedRun, **columns: np.ndarray) -> LoadedRun:
    return replace(loaded, run=replace(loaded.run, notes={**loaded.run.notes, **columns}))


def test_lines_have_the_colour_of_what_they_mean_whatever_came_first(loaded: LoadedRun) -> None:
    """A browser draws lines white that were made with one colour and got several later."""
    server = LocalServer(LOOPBACK, 0, "lines")
    try:
        layers = RunLayers(server.scene, (loaded,), RUNS)
        made = {layer: np.array(line.colors) for layer, line in layers._rectangles._lines.items()}
        layers.show(LAST, None, RenderOptions())
        for layer, colour in (
            (Layer.ACCEPTED, ACCEPTED_COLOUR),
            (Layer.REJECTED, REJECTED_COLOUR),
        ):
            sent = layers._rectangles._lines[layer].colors
            for colours in (made[layer], sent):
                assert colours.ndim == 3, "a colour for each end of each line"
                assert (colours == line_colour(colour)).all()
        assert len(layers._rectangles._lines[Layer.ACCEPTED].colors) >= 4
    finally:
        server.stop()


def test_a_gap_is_a_gap_whatever_is_left_out() -> None:
    values = np.array([1.0, 2.0, np.nan, 3.0, 4.0, np.nan, np.nan, 5.0])
    assert with_gaps(values, np.arange(8)).tolist() == [0, 1, -1, 3, 4, -1, 7]
    # Frame 2 is not among those shown, but the line may not pass over it.
    assert with_gaps(values, np.array([1, 3, 4])).tolist() == [1, -1, 3, 4]


def drawn_times(line: dict[str, Any]) -> list[float]:
    return [t for t, v in zip(line["t"], line["v"], strict=True) if v is not None]


def test_plots_draw_nothing_where_there_is_nothing(loaded: LoadedRun) -> None:
    missing = np.array([4, 5, 8])
    nis = loaded.run.nis.copy()
    nis[missing] = np.nan
    inliers = np.full(FRAMES, 0.9)
    inliers[missing] = np.nan
    told = with_notes(replace(loaded, run=replace(loaded.run, nis=nis)), inlier_ratio=inliers)
    charts = plots_of((told,), "consistency").data["charts"]
    gone = set(np.round(loaded.run.time_s[missing], 6))
    for chart in charts[:2]:
        assert gone.isdisjoint(np.round(drawn_times(chart["lines"][0]), 6))
        # These frames have an estimate: they coast.
        assert chart["shades"] == []
    line = charts[1]["lines"][0]
    breaks = [t for t, v in zip(line["t"], line["v"], strict=True) if v is None]
    assert len(breaks) == 2


def test_only_frames_without_an_estimate_are_shaded_as_such(loaded: LoadedRun) -> None:
    shades = plots_of((loaded,), "position").data["charts"][0]["shades"]
    first = int(np.flatnonzero(loaded.run.has_estimate)[0])
    (span,) = shades[0]["spans"]
    assert span[0] == loaded.run.time_s[0]
    assert span[1] == pytest.approx(0.5 * (loaded.run.time_s[first - 1] + loaded.run.time_s[first]))


def shortened(loaded: LoadedRun, frames: int) -> LoadedRun:
    """The same run, that ended earlier."""
    trajectory = loaded.trajectory
    values = {name: each[:frames] for name, each in trajectory.values.items()}
    T = trajectory.T_cam_target
    sd = None if trajectory.sd is None else trajectory.sd[:frames]
    cut = replace(
        trajectory,
        time_s=trajectory.time_s[:frames],
        values=values,
        sd=sd,
        T_cam_target=None if T is None else T[:frames],
    )
    run = replace(
        loaded.run,
        name="shorter",
        trajectory=cut,
        status=loaded.run.status[:frames],
        nis=loaded.run.nis[:frames],
        nis_dof=loaded.run.nis_dof[:frames],
        window_nis=loaded.run.window_nis[:frames],
        notes={name: each[:frames] for name, each in loaded.run.notes.items()},
    )
    return replace(loaded, run=run, errors=None, covariances={})


def test_of_two_runs_the_shorter_ends_where_it_ends(loaded: LoadedRun) -> None:
    short = shortened(loaded, 8)
    for chart in plots_of((loaded, short), "rate").data["charts"]:
        first, second = chart["lines"]
        assert max(drawn_times(first)) == pytest.approx(loaded.run.time_s[-1])
        assert max(drawn_times(second)) == pytest.approx(loaded.run.time_s[7])
        assert max(chart["bands"][1]["t"]) == pytest.approx(loaded.run.time_s[7])


def test_differences_are_the_second_minus_the_first(loaded: LoadedRun) -> None:
    short = shortened(loaded, 8)
    name = next(iter(groups_of(loaded)))
    for chart in differences((loaded, short), name).charts:
        assert np.isnan(chart.values[8:]).all()
        known = chart.values[np.isfinite(chart.values)]
        assert len(known) >= 5 and np.abs(known).max() < 1e-9


def test_of_a_long_run_as_much_is_drawn_above_the_bound_as_is() -> None:
    rng = np.random.default_rng(3)
    n = 100_000
    ratio = rng.chisquare(6, n) / chi_square.quantile(0.96, 6)
    assert (ratio > 1.0).mean() == pytest.approx(0.04, abs=0.003)
    chart = _nis_chart(np.arange(float(n)), ratio)
    assert not chart.is_dots and chart.high is not None and len(chart.values) < 1000
    # Of 500 frames, 4 % above: the 95 % quantile is below the bound nearly everywhere.
    assert (chart.high > 1.0).mean() < 0.25
    assert (chart.values > 1.0).mean() == 0.0
    assert (_nis_chart(np.arange(100.0), ratio[:100])).is_dots


def test_a_wrong_lock_does_not_look_right(loaded: LoadedRun) -> None:
    assert loaded.errors is not None
    theta = loaded.errors.theta_model_rad.copy()
    theta[LAST] = (np.deg2rad(147.0), 0.0, 0.0)
    state = {**loaded.errors.state, "theta_body": theta}
    wrong = replace(loaded.errors, theta_model_rad=theta, state=state)
    inliers = np.full(FRAMES, 0.57)
    false = with_notes(replace(loaded, errors=wrong), inlier_ratio=inliers)
    told = status_of_frame((false,), LAST)
    items = {item.get("label", ""): item for item in told["rows"][0]}
    assert items["inliers"]["value"] == "57 %"
    assert "147 deg" in items["error"]["value"] and items["error"]["bad"]
    assert "NIS" in items and items["symmetry"]["value"] == "C1"
    right = {i.get("label", ""): i for i in status_of_frame((loaded,), LAST)["rows"][0]}
    assert not right["error"].get("bad", False)
    ratio = error_over_sigma(false)
    assert ratio is not None and int(np.nanargmax(ratio)) == LAST


def test_doubts_of_a_frame_stand_in_the_bar(loaded: LoadedRun) -> None:
    fields = ("",) * LAST + ("nis rim",)
    told = replace(loaded, run=replace(loaded.run, words={"doubts": fields}))
    items = {i.get("label", ""): i for i in status_of_frame((told,), LAST)["rows"][0]}
    assert items["doubts"]["value"] == "nis, rim"
    assert items["doubts"]["bad"]
    assert "step at the rim" in items["doubts"]["title"]
    before = status_of_frame((told,), LAST - 1)["rows"][0]
    assert all(item.get("label") != "doubts" for item in before)


def test_what_is_left_out_and_what_lies_beside_is_said(loaded: LoadedRun) -> None:
    whole, thin = shot_of(loaded, LAST), shot_of(loaded, LAST, 300)
    assert whole is not None and thin is not None
    options = RenderOptions(colour_by=ColourBy.RESIDUAL)
    told = legend_html(loaded, options, thin, has_estimate=True)
    assert f"{len(thin.points):,} of {whole.n_returns:,} returns drawn" in told
    assert f"all {whole.n_returns:,} returns drawn" in legend_html(
        loaded, options, whole, has_estimate=True
    )
    beside = np.arange(len(whole.points)) < 0.47 * len(whole.points)
    other = replace(whole, beside=beside)
    assert "47 % belong to other things" in legend_html(loaded, options, other, has_estimate=True)


def test_the_time_line_has_every_status_and_event(loaded: LoadedRun) -> None:
    runs = (loaded, shortened(loaded, 8))
    events = all_events(runs)
    line = time_line(runs, events)
    assert len(line["events"]) == len(events) >= 2
    assert {event.run for event in events} == {0, 1}
    assert all(event["text"].startswith(("result, ", "shorter, ")) for event in line["events"])
    spans = line["runs"][0]["status"]
    assert spans[0][3] == "acquiring" and spans[-1][3] == "locked"
    assert spans[0][1] == spans[1][0]
    assert line["span"] == [loaded.run.time_s[0], pytest.approx(spans[-1][1])]
    names = [bars["name"] for bars in line["runs"][0]["bars"]]
    assert names == ["inliers, %", "|error| / σ"]
    assert status_spans(["a", "a", "b"], np.arange(4.0))[1][:2] == [2.0, 3.0]


def test_bars_show_the_worst_of_their_frames(loaded: LoadedRun) -> None:
    n = 5000
    time_s, inliers = np.arange(float(n)), np.full(n, 0.95)
    inliers[[1234, 4321]] = 0.2, np.nan
    trajectory = replace(shortened(loaded, 0).trajectory, time_s=time_s)
    run = replace(
        loaded.run,
        trajectory=trajectory,
        status=("locked",) * n,
        nis=np.full(n, np.nan),
        nis_dof=np.zeros(n, dtype=int),
        notes={"inlier_ratio": inliers},
    )
    (bars,) = time_line((LoadedRun(run),), ())["runs"][0]["bars"]
    assert len(bars["values"]) <= 500 and len(bars["edges"]) == len(bars["values"]) + 1
    assert min(bars["values"]) == pytest.approx(20.0)
    assert bars["edges"][bars["values"].index(min(bars["values"]))] <= 1234.0


def test_rejections_are_explained_by_distance_gate_and_axis(
    loaded: LoadedRun, run_folder: Path, tmp_path: Path
) -> None:
    records = read_records(run_folder)
    used = [record for record in records if record.outcome == ACCEPTED]
    compared = [record for record in used if record.worst_axis]
    assert used and compared
    for record in used:
        if np.isfinite(record.squared_distance):
            assert 0.0 <= record.squared_distance <= record.gate
    assert {record.worst_axis for record in compared} <= set(AXES)
    listed = measurements_html(loaded.records_at(LAST))
    some = next(r for r in loaded.records_at(LAST) if np.isfinite(r.squared_distance))
    assert f"{some.squared_distance:.3g} / {some.gate:.3g}" in listed
    # Folders that were written before these columns are read all the same.
    lines = (run_folder / MEASUREMENTS_FILE).read_text().splitlines()
    older = "\n".join(",".join(line.split(",")[:-3]) for line in lines) + "\n"
    (tmp_path / MEASUREMENTS_FILE).write_text(older)
    before = read_records(tmp_path)
    assert [record.outcome for record in before] == [record.outcome for record in records]
    assert all(np.isnan(record.gate) for record in before)


def test_a_click_finds_what_is_under_it(loaded: LoadedRun) -> None:
    shot = shot_of(loaded, LAST)
    assert shot is not None
    k = len(shot.points) // 2
    p = shot.points[k].astype(float)
    ray = Ray(np.zeros(3), p / np.linalg.norm(p))
    assert picked_point(shot, ray) == k
    card = point_card(loaded, shot, k)
    assert f"{np.linalg.norm(p):.4f} m" in dict(card.rows)["range"]
    assert picked_point(shot, Ray(np.zeros(3), np.array([1.0, 0.0, 0.0]))) is None
    record = next(r for r in loaded.records_at(LAST) if r.outcome == ACCEPTED and r.rectangle)
    centre = record.T_cam_rect[:3, 3]
    found = picked_rectangle((record,), Ray(np.zeros(3), centre / np.linalg.norm(centre)))
    assert found is record
    corner = record.corners_cam[0] + 1.1 * (record.corners_cam[0] - centre)
    assert picked_rectangle((record,), Ray(np.zeros(3), corner / np.linalg.norm(corner))) is None
    rows = dict(rectangle_card(loaded, record, shot).rows)
    assert {"squared distance", "residual, mean", "case chosen"} <= set(rows)
    assert "within the gate" in rows["squared distance"]


def test_all_states_are_told_with_who_knows_them(loaded: LoadedRun) -> None:
    told = knowledge_html(loaded)
    assert loaded.verdicts
    for block in loaded.trajectory.layout.blocks:
        assert block.title in told
        for column in block.error_columns:
            assert column in loaded.verdicts
    combinations = [name for name in loaded.verdicts if " " in name]
    assert all(name in told for name in combinations)
    assert told.count("■ data") + told.count("□ prior") == len(loaded.verdicts)


def test_what_is_known_fits_its_panel(loaded: LoadedRun) -> None:
    """In lines of which all but the first cell stay whole; units stand above them, once."""
    told = knowledge_html(loaded)
    for block in loaded.trajectory.layout.blocks:
        unit = "" if block.shown_unit == "1" else f", {block.shown_unit}"
        assert len(re.findall(f">{block.title}[^<]*{unit}</th>", told)) == 1
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in told.split("<tr>")]
    lengths = [sum(len(re.sub("<.*?>", "", cell)) for cell in row[1:]) for row in rows if row]
    # Of 400 pixels, digits are 8 wide and gaps 6.
    assert lengths and max(lengths) <= 40
    # A value has the digits that its deviation leaves it, and is right to them.
    frame = int(np.flatnonzero(loaded.run.has_estimate)[-1])
    value, sd = loaded.trajectory[POSITION][frame][0], loaded.sd(POSITION, frame)[0]
    shown, deviation = rows[[row[:1] for row in rows].index(["x"])][1:3]
    assert abs(float(shown) - value) <= 0.06 * sd
    assert float(deviation) == pytest.approx(sd, rel=0.06)
    # An attitude is told so that it can be made of it again.
    first = [row[:1] for row in rows].index(["x"])
    k = [b.name for b in loaded.trajectory.layout.in_file_order].index(ATTITUDE.name)
    sizes = [b.size for b in loaded.trajectory.layout.in_file_order][:k]
    at = first + sum(sizes) + k
    R = exp_rotation(np.deg2rad([float(row[1]) for row in rows[at : at + 3]]))
    np.testing.assert_allclose(R, loaded.trajectory[ATTITUDE][frame], atol=1e-3)


def test_what_is_held_is_not_said_to_be_known(loaded: LoadedRun) -> None:
    """A principal axis has no product of inertia: zero, and no deviation of it either."""
    trajectory = loaded.trajectory
    assert trajectory.sd is not None
    sd = trajectory.sd.copy()
    sd[:, trajectory.layout.slice_of(RATIOS)] = [1e-3, 1e-3, 0.0, 0.0, 0.0]
    held = replace(loaded, run=replace(loaded.run, trajectory=replace(trajectory, sd=sd)))
    assert knowledge_html(loaded).count("held") == 0
    assert knowledge_html(held).count("held") == 3


def test_an_address_brings_back_what_it_was_made_of() -> None:
    state = PageState(
        frame=120,
        camera=(1.5, -2.0, 3.25, 0.0, 0.5, 20.0, 0.7),
        layers=frozenset({Layer.TRUTH, Layer.POINTS}),
        colour_by=ColourBy.RESIDUAL,
        plots="error norms",
        dark=False,
    )
    assert read_address(state.address()) == state
    assert read_address("") == PageState()
    for foreign in (
        "frame=-3&camera=1,2&layers=<script>&points=x",
        "frame=9" + "9" * 400,
        "camera=nan,0,0,1,0,0,1",
        "a=1&" * 200,
    ):
        read = read_address(foreign)
        assert read.camera is None and read.colour_by is None
        assert read.frame is None or 0 <= int(read.frame) <= 10**9


def test_messages_of_the_page_are_numbers_or_nothing() -> None:
    assert read_message("{") is None and read_message("[1]") is None
    assert read_message('{"do": 3}') is None and read_message("[" * 5000) is None
    message = read_message('{"do": "seek", "time": 1.5}')
    assert message is not None and number_of(message) == 1.5
    for bad in ('{"do":"seek","time":NaN}', '{"do":"seek","time":true}', '{"do":"x","time":"1"}'):
        found = read_message(bad)
        assert found is None or number_of(found) is None


def test_a_chart_of_dots_keeps_its_frames() -> None:
    ratio = np.array([0.5, np.nan, 2.0])
    chart = _nis_chart(np.arange(3.0), ratio)
    assert isinstance(chart, Chart) and chart.is_dots
    assert chart.shown().tolist() == [0, 1, 2]
