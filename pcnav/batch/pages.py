"""The one page of a batch, and its tables as one document: what was run, numbers, failures."""

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

from pcnav.batch.axes import ESTIMATOR_AXIS, RECORDING_AXIS
from pcnav.batch.metrics import EvaluationWindow
from pcnav.batch.record import RunRecord
from pcnav.batch.store import RunStore
from pcnav.estimators.interface import FirstPose
from pcnav.estimators.registry import ESTIMATORS
from pcnav.files.text_table import TextTable
from pcnav.report.page import Code, Drawing, Part, Piece, document

_MAX_FAILURES = 50
"""On the page; the file of failures has all."""
_METHOD = (
    "A frame without a pose has no error and a failed run has none either: read an error beside "
    "the share of frames with a pose and the number of failed runs.",
    "Confidence intervals are 95 %. They draw whole runs again, within their case where a cell "
    "pools several, because the frames of one run are not independent, and take Student's t for so "
    "many runs. A maximum has none, because no draw can exceed it, nor has a number in which all "
    "runs agree.",
)


@dataclass(frozen=True)
class TitledTables:
    """The tables of one layout."""

    title: str
    tables: tuple[TextTable, ...]


@dataclass(frozen=True)
class TabulatedBatch:
    """What there is to show of a batch."""

    store: RunStore
    headers: Sequence[RunRecord]
    """Of the finished runs, failed ones among them."""
    tables: Sequence[TitledTables]
    drawings: Sequence[Drawing]

    @property
    def title(self) -> str:
        """Of the page and of the document."""
        return f"Accuracy: {self.store.folder.name}"

    @property
    def counts(self) -> str:
        """Of runs and cases, in words."""
        return f"{len(self.headers)} runs of {self.cases} cases"

    @property
    def cases(self) -> int:
        """How many."""
        return len({header.run.case for header in self.headers})

    @property
    def failures(self) -> list[RunRecord]:
        """Runs without a result."""
        return [header for header in self.headers if header.failure is not None]

    @property
    def estimators(self) -> TextTable | None:
        """What each is, and what it knows of the first pose; None where the axis is missing."""
        axes = (dict(header.run.case.settings) for header in self.headers)
        found = [(str(e[ESTIMATOR_AXIS]), RECORDING_AXIS in e) for e in axes if ESTIMATOR_AXIS in e]
        header = ("estimator", "what it is", "known of the pose")
        rows = tuple((name, *_known_of(name, is_read)) for name, is_read in dict.fromkeys(found))
        return TextTable("estimators", "", header, rows, text_columns=3) if rows else None


def page_of(batch: TabulatedBatch, window: EvaluationWindow) -> str:
    """The whole page, with everything it shows inside it."""
    missing, versions = len(batch.store.missing), batch.headers[0].versions
    facts = [
        ("runs", str(len(batch.headers))),
        ("failed", str(len(batch.failures))),
        ("cases", str(batch.cases)),
        ("version of pcnav", versions.get("pcnav", "unknown")),
    ]
    lead = batch.counts
    if missing:
        facts.insert(3, ("runs not finished", str(missing)))
        lead += f"; {missing} more runs of the grid are not finished"
    if batch.estimators is not None and len(batch.estimators.rows) > 1:
        facts.insert(3, ("estimators", str(len(batch.estimators.rows))))
    reading: list[Piece] = [
        f"Errors are pooled over {window.text} and over the runs of a cell; the time to lock and "
        "what happens before are numbers of their own.",
        *_METHOD,
    ]
    if batch.estimators is not None:
        reading.append(batch.estimators)
    first, *others = (Part(each.title, _pieces(each)) for each in batch.tables)
    # An empty place keeps a figure alone from filling the page.
    drawn: tuple[Piece, ...] = (*batch.drawings, *([()] if len(batch.drawings) == 1 else []))
    made: list[Piece] = [Code(batch.store.grid_toml), {"versions": dict(versions)}]
    return document(
        batch.title,
        lead,
        facts,
        [
            Part("How to read it", reading),
            first,
            *([Part("Errors along the axes", [drawn])] if drawn else []),
            *others,
            Part("Failures", _failures(batch.failures)),
            Part("The grid as run", made),
        ],
    )


def document_of(batch: TabulatedBatch) -> str:
    """All tables as Markdown, to stand in a project's own documentation: with command, day,
    versions and grid."""
    command = shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])
    versions = ", ".join(f"{name} {text}" for name, text in batch.headers[0].versions.items())
    lines = [
        f"# {batch.title}\n",
        f"{batch.counts}, {len(batch.failures)} of them failed. Tabulated on "
        f"{date.today().isoformat()} by `{command}`, with {versions}.\n",
    ]
    if batch.estimators is not None:
        lines.append(_without_title(batch.estimators))
    for part in batch.tables:
        lines.append(f"## {part.title}\n")
        lines += [
            _without_title(table) if table.title == part.title else table.to_markdown()
            for table in part.tables
        ]
    lines.append(f"## The grid as run\n\n```toml\n{batch.store.grid_toml.strip()}\n```\n")
    return "\n".join(lines)


def stacked(table: TextTable) -> TextTable:
    """The table with every number above its interval: side by side they would not fit."""
    rows = tuple(tuple(text.replace(" [", "\n[", 1) for text in row) for row in table.rows)
    return replace(table, rows=rows)


def _pieces(part: TitledTables) -> list[TextTable]:
    """The tables of a part; their notes are alike and stand below the last."""
    found = []
    for table in map(stacked, part.tables):
        title = "" if table.title == part.title else table.title
        found.append(replace(table, title=title, note=""))
    return [*found[:-1], replace(found[-1], note=part.tables[-1].note)]


def _failures(failures: Sequence[RunRecord]) -> list[Piece]:
    pieces: list[Piece] = []
    for each in failures[:_MAX_FAILURES]:
        pieces += [f"{each.run}: {each.failure}", Code(each.command)]
    if len(failures) > _MAX_FAILURES:
        pieces.append(f"{len(failures) - _MAX_FAILURES} more are in failures.csv.")
    return pieces or ["None: every run that was finished has a result."]


def _without_title(table: TextTable) -> str:
    return table.to_markdown().split("\n", 2)[2]


def _known_of(estimator: str, is_read: bool) -> tuple[str, str]:
    """What an estimator is, and what it knows of the first pose; empty of one that is gone.

    Of a recording that ``is_read`` from files none is told more than `pcnav run` would tell it.
    """
    # It brings Open3D, which nothing else here needs.
    from pcnav.estimators.peers.icp import START_SHIFT_FRACTION, START_TURN_DEG

    if estimator not in ESTIMATORS:
        return "", ""
    near = f"off by {START_TURN_DEG:g} deg and {START_SHIFT_FRACTION:.0%} of the diameter"
    known = {
        FirstPose.NOTHING: "nothing",
        FirstPose.NEAR: f"the first pose, {near}",
        FirstPose.EXACT: "the first pose, exactly",
    }
    entry = ESTIMATORS[estimator]
    if is_read:
        knows = entry.first_pose is FirstPose.NOTHING
        return entry.title, "nothing" if knows else "that which the recording states or pcnav finds"
    return entry.title, known[entry.first_pose]
