"""Figures: reproducible, with every peak, on axes that suit; the picture of a frame."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.report.envelope import Spans, envelope
from pcnav.report.figures import svg_bytes
from pcnav.report.measurements import count_figure, outcome_figure
from pcnav.report.overlay import frame_picture, visible_pieces
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.report.states import error_panel
from pcnav.runs.records import ACCEPTED, RectangleRecord


def error_figure(time_s: FloatArray, error: FloatArray, sd: FloatArray) -> Figure:
    """Of an error (n,) and its stated deviations (n,)."""
    return panels_figure(time_s, [error_panel("x", error, 3.0 * sd)])


def test_the_same_figure_gives_the_same_bytes() -> None:
    def drawn() -> bytes:
        time_s = np.arange(30.0)
        values = np.sin(time_s)
        sd = np.ones(30)
        return svg_bytes(error_figure(time_s, values, sd))

    assert drawn() == drawn()


def test_thinning_keeps_every_peak_and_gap() -> None:
    values = np.sin(np.linspace(0.0, 9.0, 5000))
    values[1234], values[4321] = 50.0, -60.0
    values[2000:2100] = np.nan
    at = envelope(values, 250)
    assert len(at) <= 500
    assert (np.diff(at) > 0).all()
    assert {1234, 4321} <= set(at.tolist())
    assert np.isnan(values[at]).any()
    assert envelope(values[:500], 250).tolist() == list(range(500))


def test_a_transient_does_not_set_the_scale() -> None:
    time_s = np.linspace(0.0, 100.0, 1001)
    values = np.where(time_s < 5.0, 1e3, np.sin(time_s))
    figure = panels_figure(time_s, [Panel("x", [Curve("", values)])])
    low, high = figure.axes[0].get_ylim()
    assert -1.5 < low < -1.0 < 1.0 < high < 1.5


def test_errors_that_settle_by_decades_are_read_at_both_ends() -> None:
    time_s = np.linspace(0.0, 100.0, 1001)
    sd = 10.0 ** (1.0 - 4.0 * time_s / 100.0)
    axes = error_figure(time_s, sd * np.sin(time_s), sd).axes[0]
    low, high = axes.get_ylim()
    assert axes.get_yscale() == "log"
    # Zeros of the error leave the axis below; the last bound and the first stand well within.
    assert 1e-6 < low < 0.5 * sd[-1] and high > 30.0
    error, bound = (y for line in axes.lines if (y := np.asarray(line.get_ydata())).size)
    assert error.min() >= 0.0
    heights = axes.transAxes.inverted().transform(axes.transData.transform([(0.0, bound[-1])]))
    assert heights[0, 1] > 0.2


def test_a_first_tenth_that_takes_no_more_room_stays_in_view() -> None:
    ramp = np.linspace(0.0, 1.0, 100)
    figure = panels_figure(np.arange(100.0), [Panel("x", [Curve("", ramp, steps=True)])])
    low, high = figure.axes[0].get_ylim()
    assert low < 0.0 < 1.0 < high


def test_a_value_between_two_gaps_is_drawn() -> None:
    values = np.array([0.0, 1.0, np.nan, 5.0, np.nan, 2.0])
    axes = panels_figure(np.arange(6.0), [Panel("x", [Curve("a", values)])]).axes[0]
    dots = [line for line in axes.lines if line.get_marker() == "."]
    assert [np.asarray(line.get_ydata()).tolist() for line in dots] == [[5.0, 2.0]]


def test_dots_alone_are_all_drawn() -> None:
    values = np.sin(np.arange(3000.0))
    panel = Panel("x", [Curve("a", values, style=".")], Scale.FROM_ZERO)
    assert np.size(panels_figure(np.arange(3000.0), [panel]).axes[0].lines[0].get_xdata()) == 3000


@pytest.mark.parametrize("largest", [19.0, 21.0])
def test_what_leaves_its_band_far_behind_gets_a_logarithmic_axis(largest: float) -> None:
    band = {"95 %": (np.zeros(10), np.ones(10))}
    curve = Curve("a", np.append(np.full(9, 0.5), largest))
    figure = panels_figure(np.arange(10.0), [Panel("x", [curve], Scale.FROM_ZERO, bands=band)])
    assert figure.axes[0].get_yscale() == ("log" if largest > 20.0 else "linear")


def test_intervals_are_drawn_and_stay_in_view() -> None:
    at, values = np.array([1.0, 1.01, 10.0]), np.array([2.0, 3.0, 4.0])
    bars = (np.array([1.0, np.nan, 3.0]), np.array([9.0, np.nan, 5.0]))
    panel = Panel("x", [Curve("a", values, style="o-", bars=bars)], Scale.LOG)
    axes = panels_figure(at, [panel], ticks=True, log_at=True).axes[0]
    [drawn] = [each for each in axes.collections if isinstance(each, LineCollection)]
    np.testing.assert_allclose(drawn.get_segments()[2], [[10.0, 3.0], [10.0, 5.0]])
    low, high = axes.get_ylim()
    assert low < 1.0 and high > 9.0
    # Labels that would touch are left out.
    assert axes.get_xticks().tolist() == [1.0, 10.0]


def test_spans_hold_every_frame_once() -> None:
    spans = Spans(np.linspace(0.0, 500.0, 1001))
    values = np.random.default_rng(0).integers(0, 9, 1001).astype(np.float64)
    widths = np.diff(spans.edges_s)
    assert len(widths) <= 250
    assert float(widths @ spans.mean(values)) == pytest.approx(0.5 * values.sum())
    low, high = spans.extremes(values)
    assert low.min() == values.min()
    assert high.max() == values.max()
    assert spans.edges_s[[0, -1]].tolist() == [0.0, 500.5]
    assert Spans(np.array([3.0])).edges_s.tolist() == [3.0, 4.0]


def test_counts_are_drawn_to_the_end_of_the_last_frame() -> None:
    figure = count_figure(np.arange(4.0), {"seen": np.array([4.0, 2.0, np.nan, 6.0])}, "features")
    (line,) = (line for line in figure.axes[0].lines if np.size(line.get_xdata()) > 1)
    assert np.asarray(line.get_ydata()).tolist() == [4.0, 2.0, 0.0, 6.0, 6.0]
    assert figure.axes[0].get_xlim() == (0.0, 4.0)


def test_rare_outcomes_are_summed() -> None:
    reasons = [ACCEPTED] * 30 + [f"reason {k}" for k in range(20) for _ in range(k + 1)]
    figure = outcome_figure(Counter(("a", reason) for reason in reasons))
    widths = [bar.get_width() for bar in figure.axes[0].patches]  # type: ignore[attr-defined]
    assert len(widths) == 10
    assert sum(widths) == len(reasons)
    assert svg_bytes(figure).startswith(b"<?xml")


CAMERA = PinholeCamera.from_field_of_view(80, 60, 0.5)


def wall(depth_m: float) -> DepthImage:
    """The left half of the image is a wall, the right half is space."""
    image = np.zeros((CAMERA.height, CAMERA.width), dtype=np.float32)
    image[:, :40] = depth_m
    return image


def at_pixel(u: float, v: float, z: float) -> FloatArray:
    return np.array([(u - CAMERA.cx) / CAMERA.fx * z, (v - CAMERA.cy) / CAMERA.fy * z, z])


def test_edges_behind_the_seen_surface_are_hidden() -> None:
    across = np.stack([at_pixel(10, 30, 12.0), at_pixel(70, 30, 12.0)])
    in_front = np.stack([at_pixel(10, 20, 9.0), at_pixel(70, 20, 9.0)])
    on_it = np.stack([at_pixel(5, 40, 10.05), at_pixel(35, 40, 10.05)])
    pieces, visible = visible_pieces(CAMERA, wall(10.0), np.stack([across, in_front, on_it]))
    u = project(CAMERA, pieces.mean(axis=1))[:, 0]
    first, second, third = np.split(visible, 3)
    np.testing.assert_array_equal(first, u[: len(first)] > 38.5)
    assert second.all()
    assert third.all()


def test_the_picture_draws_what_it_is_given() -> None:
    T_cam_rect = make_transform(exp_rotation(np.array([0.0, 0.3, 0.2])), at_pixel(20, 30, 10.0))
    record = RectangleRecord(0.0, "panel", 2.0, 1.0, T_cam_rect, np.ones(6), "I", ACCEPTED)
    refused = replace(record, rectangle="<other>", outcome="side cut")
    unknown = replace(record, rectangle="nowhere", T_cam_rect=np.full((4, 4), np.nan))
    edges = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]], [[0.0, 0.0, 0.0], [0.0, 0.0, -99.0]]])
    labels = np.full((60, 80), -1, dtype=np.intp)
    labels[:, :20] = 3
    pose = make_transform(np.eye(3), np.array([0.0, 0.0, 9.0]))
    figure = frame_picture(wall(10.0), CAMERA, labels, (record, refused, unknown), edges, pose)
    axes = figure.axes[0]
    assert [text.get_text() for text in axes.texts] == ["panel", "<other>"]
    outline = np.asarray(axes.lines[0].get_xydata(), dtype=np.float64)
    np.testing.assert_allclose(outline[:4], project(CAMERA, record.corners_cam))
    assert [line.get_linestyle() for line in axes.lines] == ["-", "--"]
    drawn = [c for c in axes.collections if isinstance(c, LineCollection)]
    points = np.concatenate([s for c in drawn for s in c.get_segments()])
    # Only the edge that lies before the camera, 2 m wide at 9 m.
    assert np.ptp(points[:, 0]) == pytest.approx(2.0 / 9.0 * CAMERA.fx)
    assert np.ptp(points[:, 1]) == pytest.approx(0.0)
    image = np.asarray(axes.images[0].get_array())
    assert len(np.unique(image.reshape(-1, 3), axis=0)) == 3


def test_the_picture_is_of_the_target_where_returns_fill_the_image() -> None:
    edge = np.array([[[-0.5, 0.0, 0.0], [0.5, 0.2, 0.0]]])
    pose = make_transform(np.eye(3), np.array([0.0, 0.0, 9.0]))
    axes = frame_picture(wall(10.0), CAMERA, None, (), edge, pose).axes[0]
    left, right = axes.get_xlim()
    length_px = CAMERA.fx / 9.0
    assert length_px < right - left < 3.0 * length_px + 20.0 < CAMERA.width
    seen = project(CAMERA, edge[0] + pose[:3, 3])
    assert (seen[:, 0] > left).all() and (seen[:, 0] < right).all()
    # Without a pose all of it is shown.
    axes = frame_picture(wall(10.0), CAMERA, None, (), edge, None).axes[0]
    assert np.ptp(axes.get_xlim()) >= CAMERA.width


def test_corners_span_the_sides() -> None:
    T = make_transform(exp_rotation(np.array([0.4, -1.0, 2.0])), np.array([1.0, 2.0, 30.0]))
    corners = RectangleRecord(0.0, "p", 4.0, 1.5, T, np.ones(6), "I", ACCEPTED).corners_cam
    sides = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    np.testing.assert_allclose(sides, [1.5, 4.0, 1.5])
    np.testing.assert_allclose(corners.mean(axis=0), T[:3, 3])
    np.testing.assert_allclose(corners[1] - corners[0], 1.5 * T[:3, 0], atol=1e-12)


def test_a_picture_of_nothing_is_still_a_picture() -> None:
    nothing = np.zeros((60, 80), dtype=np.float32)
    figure = frame_picture(nothing, CAMERA, None, (), np.zeros((0, 2, 3)), None)
    assert figure.axes[0].get_xlim() == (-0.5, 79.5)
