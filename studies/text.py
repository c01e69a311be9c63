"""The page of a study: Markdown beside its code, with fields for what the code alone knows.

    # Title of the page
    The line below it.

    - name of a large value: {best} deg

    ## Title of a chapter
    A paragraph that says {paper.CALM:g}.

    ### table errors: Title of the table that the code makes under this key
    What has to be known to read it.

    ### table settings: Title of a table that stands here
    | setting | paper | ours |
    | --- | --- | --- |
    | baseline of the rig | not printed | {baseline_m:g} m |

    ### figure errors: Title of the figure that the code draws under this key
    Its caption.

Fields are those of `str.format`. Left out are paragraphs that come out empty, and pieces with a
question mark (``### figure? errors: ...``) that the code did not make.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from pcnav.config.pipeline_file import Pipeline
from pcnav.files.text_table import TextTable

from .folder import Chapter, Study, StudyFigure

TEXT_FILE = "text.md"
_HEADING = re.compile(r"^(##+) (.+)\n", re.MULTILINE)
_PIECE = re.compile(r"(table|figure)(\??) (\w+): (.+)")


def study_of(
    folder: Path,
    runs: int,
    tables: Iterable[TextTable],
    figures: Iterable[StudyFigure],
    *,
    shown: tuple[str, ...],
    pipelines: Mapping[str, Pipeline],
    **fields: object,
) -> Study:
    """The page that the text in a study's folder describes, from the pieces that its code made.

    Args:
        folder: of the study.
        runs: that it made.
        tables: in any order; their titles and notes are those of the text.
        figures: likewise.
        shown: keys of the tables that the command line prints.
        pipelines: as run, by name.
        fields: what the text asks for besides ``runs``.

    Raises ``KeyError`` for a field or a piece that the text asks for in vain, ``ValueError`` for a
    piece that has no place in it.
    """
    text = (folder / TEXT_FILE).read_text(encoding="utf-8").format(runs=runs, **fields)
    head, *parts = _HEADING.split(text)
    title, below = head.removeprefix("# ").split("\n", 1)
    lead, *facts = _blocks(below)
    left: dict[tuple[str, str], TextTable | StudyFigure] = {}
    left |= {("table", table.key): table for table in tables}
    left |= {("figure", figure.key): figure for figure in figures}
    chapters: list[Chapter] = []
    for level, heading, body in zip(parts[::3], parts[1::3], parts[2::3], strict=True):
        if level == "##":
            chapters.append(Chapter(heading, tuple(map(_line, _blocks(body)))))
            continue
        kind, optional, key, name = _PIECE.findall(heading)[0]
        if optional and (kind, key) not in left:
            continue
        blocks = _blocks(body)
        stands_here = bool(blocks) and blocks[0].startswith("|")
        piece = _table(key, blocks.pop(0)) if stands_here else left.pop((kind, key))
        chapters[-1] = _with(chapters[-1], piece, name, " ".join(map(_line, blocks)))
    if left:
        raise ValueError(f"{folder.name}: the text has no place for {', '.join(map(str, left))}")
    return Study(
        title=title,
        lead=_line(lead),
        headline=tuple(_fact(line) for block in facts for line in block.splitlines()),
        chapters=tuple(chapters),
        summary_keys=shown,
        pipelines=pipelines,
        runs=runs,
    )


def _with(chapter: Chapter, piece: TextTable | StudyFigure, title: str, note: str) -> Chapter:
    if isinstance(piece, TextTable):
        table = replace(piece, title=title, note=note)
        return replace(chapter, tables=(*chapter.tables, table))
    figure = replace(piece, title=title, caption=note)
    return replace(chapter, figures=(*chapter.figures, figure))


def _blocks(text: str) -> list[str]:
    """What blank lines part."""
    return [block.strip() for block in text.split("\n\n") if block.strip()]


def _line(block: str) -> str:
    return " ".join(block.split())


def _fact(line: str) -> tuple[str, str]:
    """The name of a value, which may have a colon itself, and the value."""
    name, value = line.removeprefix("- ").rsplit(": ", 1)
    return name, value


def _table(key: str, text: str) -> TextTable:
    """A table of words."""
    lines = text.splitlines()
    cells = [tuple(cell.strip() for cell in line.strip("|").split("|")) for line in lines]
    header, _, *rows = cells
    return TextTable(key, "", header, tuple(rows), text_columns=len(header))
