"""The folder a study leaves behind: tables, figures, pipelines as run, and one page."""

import secrets
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from pcnav.config import Pipeline
from pcnav.errors import InputError
from pcnav.evaluation import page
from pcnav.evaluation.text_table import TextTable
from pcnav.provenance import library_versions, pipeline_toml

INDEX_FILE = "index.html"
_TABLES, _FIGURES, _PIPELINES = "tables", "figures", "pipelines"
_CONTENT = {INDEX_FILE, _TABLES, _FIGURES, _PIPELINES}


@dataclass(frozen=True)
class StudyFigure:
    """A finished drawing."""

    key: str
    """Name of its file, without the suffix."""
    title: str
    caption: str
    svg: bytes


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


@contextmanager
def study_folder(out: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary sibling of the folder; it takes the folder's place when the block ends well.

    Raises `InputError` at once when the folder holds anything and ``overwrite`` is false, or
    when it holds something that no study wrote. An exception in the block leaves things as they
    were.
    """
    folder = out.resolve()
    _refuse_unless_replaceable(folder, overwrite)
    staging = folder.parent / f".{folder.name}-{secrets.token_hex(4)}"
    try:
        staging.mkdir(parents=True)
    except OSError as error:
        expected = f"expected a place that can be written ({error.strerror})"
        raise InputError(out, "folder", expected) from error
    try:
        yield staging
        if folder.exists():
            earlier = staging.with_name(f"{staging.name}-earlier")
            folder.rename(earlier)
            staging.rename(folder)
            shutil.rmtree(earlier)
        else:
            staging.rename(folder)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def _refuse_unless_replaceable(folder: Path, overwrite: bool) -> None:
    if not folder.exists():
        return
    if not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder, this is a file")
    names = {path.name for path in folder.iterdir()}
    if names and not overwrite:
        raise InputError(folder, "folder", "expected an empty or new folder (or ask to overwrite)")
    if names and not (INDEX_FILE in names and names <= _CONTENT):
        expected = "expected an earlier study's folder to overwrite, this holds something else"
        raise InputError(folder, "folder", expected)


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
    body = [page.heading(study.title, study.lead), page.cards(study.headline)]
    for chapter in study.chapters:
        pieces = [page.paragraph(text) for text in chapter.text]
        pieces += [_titled_table(table) for table in chapter.tables]
        if chapter.figures:
            drawn = [
                page.image(f.title, f.caption, "image/svg+xml", f.svg) for f in chapter.figures
            ]
            pieces.append(page.grid(drawn))
        body.append(page.section(chapter.title, *pieces))
    made = [page.paragraph(f"{study.runs} Monte Carlo runs. The pipelines as run:")]
    for name, pipeline in study.pipelines.items():
        made.append(page.paragraph(f"{name}.toml"))
        made.append(page.settings(pipeline.model_dump(mode="json")))
    made.append(page.settings({"versions": dict(versions)}))
    body.append(page.section("How the study was made", *made))
    return page.page(study.title, body)


def _titled_table(table: TextTable) -> str:
    rows = page.table(table.header, table.rows, table.text_columns)
    note = page.paragraph(table.note) if table.note else ""
    return "\n".join([page.subheading(table.title), rows, note])
