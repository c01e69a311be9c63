"""The report carries everything it shows, escapes what it is given and stays small."""

import base64
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from scipy.stats import chi2

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.evaluation.knowledge import what_is_known
from pcnav.evaluation.metrics import evaluate
from pcnav.files.text_table import number
from pcnav.report import depth_report as report
from pcnav.report import status
from pcnav.report.depth_report import ReportContent, report_html
from pcnav.report.envelope import envelope
from pcnav.report.figures import component_figure, outcome_figure, svg_bytes
from pcnav.report.from_run import track_of
from pcnav.report.overlay import frame_picture, visible_pieces
from pcnav.report.status import STATUS_COLOURS, status_figure, status_section, window_nis_bounds
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.reader import count_outcomes, read_run
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.status import Status
from pcnav.runs.writer import RunWriter

VOID = {"meta", "img", "br", "wbr"}


class PageReader(HTMLParser):
    """Checks that tags nest, and keeps the text, the images and all that would be loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.images: list[str] = []
        self.external: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in {"src", "href", "srcset", "data", "action"}:
                (self.images if (value or "").startswith("data:") else self.external).append(
                    value or ""
                )
        assert tag not in {"script", "link", "iframe", "object"}

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        # A place where a word may break is none where the text ends.
        if self.get_starttag_text() == "<wbr>":
            self.text = self.text.removesuffix("\n")
        self.text += data + "\n"


def read_page(html: str) -> PageReader:
    reader = PageReader()
    reader.feed(html)
    reader.close()
    assert reader.open == []
    return reader


def make_content(folder: Path, run: Any, *, with_truth: bool = True) -> ReportContent:
    with RunWriter(folder, run.output) as writer:
        for estimate in run.estimates:
            writer.add(estimate)
    found = read_run(folder, with_covariance=True)
    return ReportContent(
        title="run <one> & two",
        target="bus <b>bold</b>",
        command='pcnav run "a b" --target x.toml',
        track=track_of(found),
        outcomes=count_outcomes(folder),
        metrics=evaluate(found, run.truth if with_truth else None),
        configuration={"seed": 7, "noise": {"range_sigma_m": 0.02, "extra": None}, "v": (1, 2)},
        versions={"numpy": "9.9.<9>"},
    )


@pytest.fixture(scope="module")
def written(
    make_run: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> tuple[ReportContent, str]:
    """The report of a run whose errors are twice what it states, and its HTML."""
    folder = tmp_path_factory.mktemp("report")
    picture = Figure()
    picture.add_subplot().plot([0.0, 1.0])
    content = make_content(folder / "run", make_run(60, 2.0))
    content = replace(content, picture=picture, picture_caption="<c>")
    return content, report_html(content)


def test_the_page_is_whole_and_loads_nothing(written: tuple[ReportContent, str]) -> None:
    _, html = written
    reader = read_page(html)
    assert reader.external == []
    assert not re.search(r"url\(|@import|https?://", re.sub(r"base64,[^\"]*", "", html))
    # Status, pose, six states, consistency, counts, outcomes and the picture.
    assert len(reader.images) == 12
    kinds = [re.split("[:;]", image)[1] for image in reader.images]
    assert (kinds.count("image/png"), kinds.count("image/svg+xml")) == (1, 11)
    for image, kind in zip(reader.images, kinds, strict=True):
        data = base64.b64decode(image.split(",", 1)[1], validate=True)
        if kind == "image/png":
            assert data.startswith(b"\x89PNG")
        else:
            assert ElementTree.fromstring(data).tag.endswith("svg")
    for text in ("run <one> & two", "bus <b>bold</b>", 'pcnav run "a b" --target x.toml'):
        assert text in reader.text
    for text in ("range_sigma_m", "0.02", "not set", "1, 2", "9.9.<9>", "<c>"):
        assert text in reader.text
    for text in ("inertia ratios", "panel, +y", "not recognised"):
        assert text in reader.text


def test_the_numbers_in_the_page_are_those_of_the_metrics(
    written: tuple[ReportContent, str],
) -> None:
    content, html = written
    text = read_page(html).text
    position = content.metrics.quantities[0]
    assert position.key == "position_cam"
    assert position.last_third.rms < 0.1
    for value in (position.whole.rms, position.last_third.at(95), position.last_third.maximum):
        assert number(1e3 * value) in text
    assert text.count("too confident") == 7
    used = sum(n for (_, outcome), n in content.outcomes.items() if outcome == ACCEPTED)
    assert used > 0
    assert f"{content.outcomes.total()} rectangles seen" in text


def test_without_a_truth_the_estimates_are_shown(
    make_run: Callable[..., Any], tmp_path: Path
) -> None:
    content = make_content(tmp_path / "run", make_run(40), with_truth=False)
    reader = read_page(report_html(content))
    assert "Against the truth" not in reader.text
    assert "Pose error" not in reader.text
    assert len(reader.images) == 10


@pytest.mark.parametrize("frames", [0, 1, 3, 4])
def test_a_run_of_hardly_any_frames_has_a_report(
    make_run: Callable[..., Any], tmp_path: Path, frames: int
) -> None:
    # Up to three frames there is no estimate at all.
    content = make_content(tmp_path / "run", make_run(frames), with_truth=frames > 0)
    reader = read_page(report_html(content))
    assert f"{frames} frames" in reader.text
    assert ("States over time" in reader.text) == (frames > 3)


def test_a_long_run_stays_a_small_page(make_run: Callable[..., Any], tmp_path: Path) -> None:
    short = make_content(tmp_path / "run", make_run(500))
    repeats = np.tile(np.arange(500), 10)
    noise = np.random.default_rng(5).standard_normal((5000, 3))
    track = replace(
        short.track,
        time_s=0.5 * np.arange(5000, dtype=np.float64),
        r_hill=short.track.r_hill[repeats] + noise,
        v_hill=short.track.v_hill[repeats] + noise,
        com_model=short.track.com_model[repeats] + noise,
        R_world_body=short.track.R_world_body[repeats],
        omega_body=short.track.omega_body[repeats] + noise,
        inertia_ratios=short.track.inertia_ratios[repeats] + noise[:, :1],
        sd=short.track.sd[repeats],
        T_cam_model=short.track.T_cam_model[repeats],
        status=short.track.status * 10,
        nis=short.track.nis[repeats],
        nis_dof=short.track.nis_dof[repeats],
        window_nis=short.track.window_nis[repeats],
        inlier_ratio=short.track.inlier_ratio[repeats],
        n_rectangles=short.track.n_rectangles[repeats],
        covariance=None,
    )
    alone = replace(short.metrics, quantities=(), nees=(), errors=None)
    long = replace(short, track=track, metrics=alone)
    assert 2e5 < len(report_html(long)) < 3e6


def test_the_status_and_its_changes_are_shown(
    written: tuple[ReportContent, str], make_run: Callable[..., Any], tmp_path: Path
) -> None:
    content, html = written
    track = content.track
    text = read_page(html).text
    changes = [k for k in range(1, 60) if track.status[k] != track.status[k - 1]]
    assert 3 < len(changes) < 25
    for k in changes:
        row = f"{track.status[k - 1]}\n{track.status[k]}\n{k}\n{number(track.time_s[k])}\n"
        assert row + f"{track.inlier_ratio[k]:.0%}\n{number(track.window_nis[k])}\n" in text
    assert "Ambiguous" not in text
    steady = make_content(tmp_path / "run", make_run(3)).track
    told = read_page(status_section(steady, "C1")).text
    assert "The status is acquiring in every frame." in told


@pytest.mark.parametrize(
    ("symmetry", "told"), [("D2", "symmetry group is D2"), ("C1", "the target itself has no")]
)
def test_an_ambiguous_status_names_the_symmetry(
    make_run: Callable[..., Any], tmp_path: Path, symmetry: str, told: str
) -> None:
    content = make_content(tmp_path / "run", make_run(6))
    track = replace(content.track, status=("acquiring",) * 3 + ("ambiguous",) * 3)
    assert told in read_page(status_section(track, symmetry)).text


def test_a_restless_status_is_cut_short(make_run: Callable[..., Any], tmp_path: Path) -> None:
    content = make_content(tmp_path / "run", make_run(60))
    track = replace(content.track, status=("locked", "coasting") * 30)
    reader = read_page(status_section(track, "C1"))
    assert "34 later changes are not listed" in reader.text


def test_every_status_has_its_own_colour_in_the_order_of_worth() -> None:
    assert set(STATUS_COLOURS) == {str(status) for status in Status}
    assert len(set(STATUS_COLOURS.values())) == len(Status)


def test_the_status_bands_last_as_long_as_the_status(
    make_run: Callable[..., Any], tmp_path: Path
) -> None:
    """Read from the drawing: frames 0.5 s apart, of which the strip shows every one."""
    track = make_content(tmp_path / "run", make_run(60)).track
    figure = status_figure(track)
    strip, explained, window = figure.axes
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    for patch, label in zip(strip.patches, legend, strict=True):
        assert isinstance(patch, StepPatch)
        heights, edges, below = patch.get_data()
        covered = float(np.sum((heights - below) * np.diff(edges)))
        name, count = label.removesuffix(")").split(" (")
        assert covered == pytest.approx(0.5 * track.status.count(name))
        assert int(count) == track.status.count(name)
    np.testing.assert_array_equal(explained.lines[0].get_ydata(), track.inlier_ratio)
    np.testing.assert_array_equal(window.lines[1].get_ydata(), track.window_nis)


def test_without_evidence_only_the_status_is_drawn(
    make_run: Callable[..., Any], tmp_path: Path
) -> None:
    track = make_content(tmp_path / "run", make_run(3)).track
    assert len(status_figure(track).axes) == 1


def test_the_band_of_the_window_nis_is_chi_square(
    make_run: Callable[..., Any], tmp_path: Path
) -> None:
    track = make_content(tmp_path / "run", make_run(400)).track
    lower, upper = window_nis_bounds(track)
    for k in (3, 10, 50, 399):
        used = np.flatnonzero(track.nis_dof[: k + 1])[-NIS_WINDOW_FRAMES:]
        degrees = int(track.nis_dof[used].sum())
        if degrees:
            band = np.array(chi2.interval(0.95, degrees)) / degrees
            np.testing.assert_allclose([lower[k], upper[k]], band)
    known = np.isfinite(track.window_nis)
    np.testing.assert_array_equal(np.isfinite(lower), known)
    # The run's innovations are what they should be; neighbouring windows share most frames.
    inside = (track.window_nis >= lower) & (track.window_nis <= upper)
    assert 0.8 < inside[known].mean() <= 1.0


def test_the_window_begins_anew_with_a_new_track(
    make_run: Callable[..., Any], tmp_path: Path
) -> None:
    track = make_content(tmp_path / "run", make_run(40)).track
    r_hill = track.r_hill.copy()
    r_hill[20] = np.nan
    _, upper = window_nis_bounds(replace(track, r_hill=r_hill))
    _, before = window_nis_bounds(track)
    np.testing.assert_array_equal(upper[:20], before[:20])
    assert (upper[22:38] > before[22:38]).all()


def test_the_report_says_what_is_known(
    written: tuple[ReportContent, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (report, status):
        monkeypatch.setattr(module, "svg_bytes", lambda figure: b"")
    content, html = written
    assert "prior only" not in read_page(html).text
    covariance = np.diag(np.full(20, 1e-6))
    covariance[15:17, 15:17] = 0.005 * np.ones((2, 2)) + 1e-9 * np.eye(2)
    knowledge = what_is_known(
        PriorMass(0.15**2 * np.eye(3), 0.01 * np.eye(5)), covariance, np.eye(3), np.ones(3)
    )
    text = read_page(report_html(replace(content, knowledge=knowledge))).text
    assert "Prior only are Inertia ratios over Ixx: Iyy, Izz." in text
    assert "0.71 Iyy + 0.71 Izz\nprior only\n1\n" in text
    assert "Mass centre in model, x\nknown from data\nmm\n150\n1.00\n" in text
    assert "18 of 20 states; prior only: i_yy, i_zz" in text
    assert "Attitude, body axes, y\nknown from data\ndeg\nnone\n0.0573\n-\n0.0%" in text


def test_the_same_figure_gives_the_same_bytes() -> None:
    def drawn() -> bytes:
        time_s = np.arange(30.0)
        values = np.sin(time_s)[:, None]
        sd = np.ones((30, 1))
        return svg_bytes(component_figure(time_s, values, sd, ("x",), "m", is_error=True))

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
    error = np.where(time_s < 5.0, 1e3, np.sin(time_s))[:, None]
    figure = component_figure(time_s, error, np.full((1001, 1), 0.2), ("x",), "1", is_error=True)
    low, high = figure.axes[0].get_ylim()
    assert -1.5 < low < -1.0 < 1.0 < high < 1.5


def test_a_run_that_settles_by_decades_shows_both_ends() -> None:
    time_s = np.linspace(0.0, 100.0, 1001)
    sd = 10.0 ** (1.0 - 4.0 * time_s / 100.0)[:, None]
    figure = component_figure(time_s, sd * np.sin(time_s)[:, None], sd, ("x",), "1", is_error=True)
    axes = figure.axes[0]
    low, high = axes.get_ylim()
    assert low < -30.0 < 30.0 < high
    # The last bound of 3 mm stands well clear of zero: a tenth of the axis and more.
    inside = axes.transData.transform([(0.0, 0.0), (0.0, 3.0 * sd[-1, 0]), (0.0, high)])[:, 1]
    assert (inside[1] - inside[0]) > 0.1 * (inside[2] - inside[0])


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
