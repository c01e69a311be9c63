"""The report of every kind of run: whole, with the metrics, without what does not apply."""

import re
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import chi2

from pcnav.dynamics.blocks import RATIOS
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.information_gain import information_gain
from pcnav.evaluation.metrics import evaluate
from pcnav.files.text_table import TextTable, display_unit, number
from pcnav.report.content import ReportContent
from pcnav.report.evaluation import consistency_figure
from pcnav.report.page import Drawing
from pcnav.report.run_report import SECTIONS, report_html, write_report
from pcnav.report.states import states_over_time
from pcnav.runs.reader import count_outcomes, read_features
from pcnav.runs.records import ACCEPTED
from pcnav.runs.run import Segment
from tests.made_runs import KINDS
from tests.report.conftest import Contents

VOID = {"meta", "img", "br", "wbr"}
COMMON = {
    "Answer",
    "Summary",
    "Status",
    "Against the truth",
    "States over time",
    "How the run was made",
}
OWN = {
    "depth": {"Consistency", "Measurements"},
    "inertia_bank": {"Consistency", "Measurements", "Notes of the estimator"},
    "attitude_inertia": {"Consistency", "Measurements"},
    "image_motion": {"Consistency", "Frames", "Measurements"},
    "open3d_icp": set[str](),
}
"""Sections of a run with a truth, beyond those that all have."""
FIGURES = {
    # Status, pose, six states, consistency, counts and outcomes.
    "depth": 11,
    # Status, five states, consistency, counts, points, notes.
    "inertia_bank": 10,
    # Status, three states, consistency, attitudes taken in.
    "attitude_inertia": 6,
    # Status, outcomes, attitude, rate and their errors, consistency, counts.
    "image_motion": 8,
    # Status and pose.
    "open3d_icp": 2,
}


class PageReader(HTMLParser):
    """Checks that tags nest, and keeps the text, the titles, the images and all that is loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.sections: list[str] = []
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
        if data.strip():
            self.text += data.strip() + "\n"
        if self.open and self.open[-1] == "h2":
            self.sections.append(data)


def read_page(html: str) -> PageReader:
    reader = PageReader()
    reader.feed(html)
    reader.close()
    assert reader.open == []
    return reader


@pytest.fixture(scope="module", params=KINDS)
def written(
    request: pytest.FixtureRequest,
    make_content: Contents,
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[str, ReportContent, PageReader]:
    """A kind of run whose errors are thrice what it states, and its page as read back."""
    content = make_content(request.param, 60, inflation=3.0)
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(path, content)
    html = path.read_text(encoding="utf-8")
    assert not re.search(r"url\(|@import|https?://", re.sub(r"base64,[^\"]*", "", html))
    return request.param, content, read_page(html)


def test_the_page_is_whole_and_has_what_applies(
    written: tuple[str, ReportContent, PageReader],
) -> None:
    kind, _, page = written
    assert page.external == []
    assert set(page.sections) == COMMON | OWN[kind]
    assert page.sections == [name for name in SECTIONS if name in page.sections]
    assert len(page.images) == FIGURES[kind]
    for image in page.images:
        kind_of_image, data = image.split(",", 1)
        assert kind_of_image == "data:image/svg+xml;base64"
        assert ElementTree.fromstring(b64decode(data, validate=True)).tag.endswith("svg")
    for text in ("run <one> & two", 'pcnav run "a b" --target x.toml', kind):
        assert text in page.text
    for text in ("range_sigma_m", "0.02", "not set", "1, 2", "9.9.<9>"):
        assert text in page.text


def test_the_numbers_in_the_page_are_those_of_the_metrics(
    written: tuple[str, ReportContent, PageReader],
) -> None:
    kind, content, page = written
    for quantity in content.metrics.quantities:
        scale, unit = display_unit(quantity.unit, quantity.last_third.rms)
        last = quantity.last_third
        told = (*(p.rms for p in (quantity.whole, quantity.second_half, last)), last.median)
        numbers = [number(scale * value) for value in (*told, last.at(95), last.maximum)]
        assert "\n".join([quantity.title, unit, *numbers]) + "\n" in page.text
    for block in content.metrics.nees:
        assert f"{block.lower:.3f} to {block.upper:.3f}\n{block.share_inside:.1%}\n" in page.text
    assert page.text.count("too confident") == len(content.metrics.nees)
    assert (kind == "open3d_icp") == (not content.metrics.nees)
    if content.metrics.nis.frames:
        assert f"{content.metrics.nis.mean_per_degree:.3f} (95 %: " in page.text
    else:
        assert "NIS" not in page.text.split("Consistency")[0]


def test_what_was_measured_is_told(written: tuple[str, ReportContent, PageReader]) -> None:
    kind, content, page = written
    run = content.run
    assert run.folder is not None
    if kind == "depth":
        outcomes = count_outcomes(run.folder)
        used = sum(n for (_, outcome), n in outcomes.items() if outcome == ACCEPTED)
        assert used > 0
        assert f"{outcomes.total()} rectangles seen" in page.text
        assert "panel, +y" in page.text
        assert "not recognised" in page.text
        assert "bus <b>bold</b>" in page.text
    elif kind == "inertia_bank":
        assert content.metrics.errors is not None
        assert content.metrics.errors.point_m is not None
        table = read_features(run.folder)
        assert table is not None
        point = "\n".join(f"{value:.4f}" for value in (*table.p_body[1], *table.sd[1]))
        assert f"\n7\n{point}\n" in page.text
        assert f"\n57\n57\n{number(content.metrics.errors.point_m[7])}\n" in page.text
        assert f"hypothesis\n{number(5.9)}\n" in page.text
    elif kind == "image_motion":
        measured = run.words["outcome"].count("measured")
        assert f"measured\n{measured}\n{measured / 60:.1%}\n" in page.text
        assert f"{run.status.count('locked')} of 60\nframes measured\n" in page.text
        assert "too few <features>" in page.text
        assert "The body axes are the camera's at the first frame of the chain." in page.text


@pytest.mark.usefixtures("quick_drawings")
@pytest.mark.parametrize("kind", KINDS)
def test_without_a_truth_the_estimates_are_shown(make_content: Contents, kind: str) -> None:
    page = read_page(report_html(make_content(kind, 40, with_truth=False)))
    assert {"Against the truth"} == (COMMON | OWN[kind]) - set(page.sections) - {"Consistency"}
    assert ("Consistency" in page.sections) == KINDS[kind].has_nis
    assert "Pose error" not in page.text
    assert "True minus estimated" not in page.text
    assert "error, m" not in page.text


@pytest.mark.usefixtures("quick_drawings")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frames", [0, 1, 3, 4])
def test_a_run_of_hardly_any_frames_has_a_report(
    make_content: Contents, kind: str, frames: int
) -> None:
    # Up to three frames there is no estimate at all.
    content = make_content(kind, frames, with_truth=frames > 0)
    page = read_page(report_html(content))
    assert f"{frames} frames" in page.text
    assert ("States over time" in page.sections) == (frames > 3)
    assert ("Status" in page.sections) == (frames > 0)


@pytest.mark.study
def test_a_long_run_stays_a_small_page(make_content: Contents) -> None:
    short = make_content("depth", 500)
    repeats = np.tile(np.arange(500), 10)
    noise = np.random.default_rng(5).standard_normal((5000, 3))
    run = short.run
    trajectory: Trajectory = run.trajectory.at(repeats)
    values = {
        name: value if value.ndim == 3 else value + noise[:, :1]
        for name, value in trajectory.values.items()
    }
    time_s = 0.5 * np.arange(5000, dtype=np.float64)
    run = replace(
        run,
        trajectory=replace(trajectory, time_s=time_s, values=values, covariance=None),
        status=run.status * 10,
        nis=run.nis[repeats],
        nis_dof=run.nis_dof[repeats],
        window_nis=run.window_nis[repeats],
        notes={name: note[repeats] for name, note in run.notes.items()},
    )
    assert 2e5 < len(report_html(replace(short, run=run, metrics=evaluate(run, None)))) < 3e6


@pytest.mark.usefixtures("quick_drawings")
def test_the_report_says_what_the_data_told(make_content: Contents) -> None:
    content = make_content("depth", 8)
    assert "prior only" not in read_page(report_html(content)).text
    covariance = np.diag(np.full(20, 1e-6))
    covariance[15:17, 15:17] = 0.005 * np.ones((2, 2)) + 1e-9 * np.eye(2)
    gain = information_gain(
        PriorMass(0.15**2 * np.eye(3), 0.01 * np.eye(5)), covariance, np.eye(3), np.ones(3)
    )
    observable = TextTable("states", "What <is> observable", ("a", "b"), (("<c>", "d"),), "e & f")
    picture = Figure()
    picture.add_subplot().plot([0.0, 1.0])
    content = replace(
        content,
        gain=gain,
        observability=(observable,),
        picture=picture,
        picture_caption="Frame <7>",
    )
    page = read_page(report_html(content))
    assert {"Information gain", "Observability of this motion"} <= set(page.sections)
    assert "Prior only are Inertia ratios over Ixx: Iyy, Izz." in page.text
    assert "0.71 Iyy + 0.71 Izz\nprior only\n1\n" in page.text
    assert "Mass centre in model, x\nknown from data\nmm\n150\n1.00\n" in page.text
    assert "18 of 20 states; prior only: i_yy, i_zz" in page.text
    assert "Attitude, body axes, y\nknown from data\ndeg\nnone\n0.0573\n-\n0.0%" in page.text
    assert "What <is> observable\na\nb\n<c>\nd\ne & f\n" in page.text
    assert "One frame as it was understood\nFrame <7>\n" in page.text


@pytest.mark.usefixtures("quick_drawings")
def test_segments_and_symmetry_are_told(make_content: Contents) -> None:
    content = make_content("image_motion", 20)
    run = content.run
    later = replace(run.segments[0], time_s=float(run.time_s[12]))
    content = replace(content, run=replace(run, segments=(*run.segments, later)))
    assert "2 segments" in read_page(report_html(content)).text
    assert "symmetry 3 of the target" not in read_page(report_html(content)).text
    content = replace(content, metrics=replace(content.metrics, symmetry=3))
    assert "symmetry 3 of the target" in read_page(report_html(content)).text


def test_what_is_held_fixed_is_not_drawn(
    make_content: Contents, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = dict[str, Figure]()

    def keep(title: str, caption: str, figure: Figure) -> Drawing:
        drawn[title] = figure
        return Drawing(title, caption, b"")

    monkeypatch.setattr("pcnav.report.states.drawing", keep)
    content = make_content("attitude_inertia", 20, with_truth=False)
    trajectory = content.run.trajectory
    assert trajectory.sd is not None
    ratios, sd = trajectory[RATIOS].copy(), trajectory.sd.copy()
    ratios[:, 2:] = sd[:, -3:] = 0.0
    fixed = replace(trajectory, sd=sd, values={**trajectory.values, RATIOS.name: ratios})
    states_over_time(replace(content, run=replace(content.run, trajectory=fixed)))
    assert [axes.get_ylabel() for axes in drawn["Inertia ratios over Ixx"].axes] == ["Iyy", "Izz"]
    later = Segment(float(content.run.time_s[10]), np.eye(3))
    states_over_time(replace(content, run=replace(content.run, segments=(later, later))))
    line = drawn["Attitude"].axes[0].lines[0]
    assert np.flatnonzero(np.isnan(np.asarray(line.get_ydata()))).tolist() == [0, 1, 2, 10]


@pytest.mark.parametrize("kind", ["depth", "inertia_bank", "attitude_inertia"])
def test_every_frame_is_drawn_over_its_own_bound(make_content: Contents, kind: str) -> None:
    content = make_content(kind, 60, inflation=1.3)
    used, nees = content.run.nis_dof > 0, content.metrics.nees[-1]
    assert nees.name == "all"
    degrees = np.full(nees.frames, nees.degrees / nees.frames)
    drawn = []
    for axes, dof in zip(
        consistency_figure(content).axes, (content.run.nis_dof[used], degrees), strict=True
    ):
        lines = [np.asarray(line.get_ydata(), dtype=np.float64) for line in axes.lines]
        inside, outside = lines
        assert np.nanmax(inside) <= 1.0 < np.nanmin(outside)
        ratio = np.fmax(inside, outside)
        drawn.append(ratio[np.isfinite(ratio)] * chi2.ppf(0.95, dof))
    np.testing.assert_allclose(drawn[0], content.run.nis[used])
    assert drawn[1].sum() / nees.degrees == pytest.approx(nees.mean_per_degree)
