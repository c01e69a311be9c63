"""The folder a study leaves behind: tables, figures, pipelines as run, and one page."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from matplotlib.figure import Figure
from rich.table import Table

from pcnav.config.pipeline_file import Pipeline
from pcnav.files.new_folder import new_folder
from pcnav.files.text_table import TextTable
from pcnav.report.figures import svg_bytes
from pcnav.report.page import Drawing, Part, Piece, document
from pcnav.runs.provenance import library_versions, pipeline_toml

INDEX_FILE = "index.html"
_TABLES, _FIGURES, _PIPELINES = "tables", "figures", "pipelines"


@dataclass(frozen=True)
class StudyFigure:
    """A drawing."""

    key: str
    """Name of its file, without the suffix."""
    figure: Figure
    title: str = ""
    caption: str = ""

    @cached_property
    def svg(self) -> bytes:
        """As its file has it."""
        return svg_bytes(self.figure)


@dataclass(frozen=True)
class Chapter:
    """A part of the page: text, then tables, then figures."""

    title: str
    text: tuple[str, ...] = ()
    tables: tuple[TextTable, ...] = ()
    figures: tuple[StudyFigure, ...] = ()


@dataclass(frozen=True)
class StudySummary:
    """What the command line shows of a study."""

    tables: tuple[Table, ...]
    page: Path


@dataclass(frozen=True)
class Study:
    """All that a study found."""

    title: str
    lead: str
    headline: tuple[tuple[str, str], ...]
    """Few large values and their names."""
    chapters: tuple[Chapter, ...]
    summary_keys: tuple[str, ...]
    """Keys of the tables that the command line prints."""
    pipelines: Mapping[str, Pipeline]
    """As run, by name."""
    runs: int

    def summary(self, folder: Path) -> StudySummary:
        """What to print of a study that is in its folder."""
        tables = [table for chapter in self.chapters for table in chapter.tables]
        shown = [table.to_rich() for table in tables if table.key in self.summary_keys]
        return StudySummary(tuple(shown), folder / INDEX_FILE)


def study_folder(out: Path, overwrite: bool) -> AbstractContextManager[Path]:
    """A folder that takes its place when the block ends well: see `pcnav.files.new_folder`."""
    return new_folder(out, overwrite, INDEX_FILE)


def write_study(staging: Path, study: Study) -> None:
    """Write tables (CSV and Markdown), figures (SVG), pipelines and the page with them all."""
    for name in (_TABLES, _FIGURES, _PIPELINES):
        (staging / name).mkdir()
    for chapter in study.chapters:
        for table in chapter.tables:
            path = staging / _TABLES / table.key
            path.with_suffix(".csv").write_text(table.to_csv(), encoding="utf-8")
            path.with_suffix(".md").write_text(table.to_markdown(), encoding="utf-8")
        for figure in chapter.figures:
            (staging / _FIGURES / f"{figure.key}.svg").write_bytes(figure.svg)
    versions = library_versions()
    for name, pipeline in study.pipelines.items():
        text = pipeline_toml(pipeline, versions)
        (staging / _PIPELINES / f"{name}.toml").write_text(text, encoding="utf-8")
    (staging / INDEX_FILE).write_text(_page(study, versions), encoding="utf-8")


def _page(study: Study, versions: Mapping[str, str]) -> str:
    parts = [Part(chapter.title, _pieces(chapter)) for chapter in study.chapters]
    made: list[Piece] = [f"{study.runs} Monte Carlo runs. The pipelines as run:"]
    for name, pipeline in study.pipelines.items():
        made += [f"{name}.toml", pipeline.model_dump(mode="json")]
    made.append({"versions": dict(versions)})
    parts.append(Part("How the study was made", made))
    return document(study.title, study.lead, study.headline, parts)


def _pieces(chapter: Chapter) -> list[Piece]:
    figures = tuple(Drawing(each.title, each.caption, each.svg) for each in chapter.figures)
    return [*chapter.text, *chapter.tables, *([figures] if figures else [])]
