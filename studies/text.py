"""The prose of a study: Markdown beside its code, with fields for what the code alone knows.

    # Title of the page
    The line below it.

    ## Title of a chapter
    A paragraph that says {paper.CALM:g}.

    ## Settings
    | setting | paper | ours |
    | --- | --- | --- |
    | baseline of the rig | not printed | {baseline_m:g} m |

Fields are those of `str.format`.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pcnav.files.text_table import TextTable

from .folder import Chapter, StudyFigure

TEXT_FILE = "text.md"


@dataclass(frozen=True)
class StudyText:
    """Blocks of text by the title of their chapter."""

    title: str
    lead: str
    blocks: Mapping[str, tuple[str, ...]]
    """Paragraphs and tables, fields not filled in."""

    def chapter(
        self,
        title: str,
        tables: Sequence[TextTable] = (),
        figures: Sequence[StudyFigure] = (),
        **fields: object,
    ) -> Chapter:
        """A chapter with its paragraphs, the fields filled in; none for those that are then empty.

        Raises ``KeyError`` for a chapter or a field that is not there.
        """
        text = [" ".join(block.format(**fields).split()) for block in self.blocks[title]]
        return Chapter(title, tuple(filter(None, text)), tuple(tables), tuple(figures))

    def table(self, key: str, title: str, text_columns: int, **fields: object) -> TextTable:
        """The table that stands under its title."""
        (block,) = self.blocks[title]
        header, _, *rows = (
            tuple(text.strip().format(**fields) for text in line.strip("|").split("|"))
            for line in block.splitlines()
        )
        return TextTable(key, title, header, tuple(rows), text_columns=text_columns)


def study_text(folder: Path) -> StudyText:
    """Read the text of the study in a folder."""
    head, *parts = re.split(r"^## ", (folder / TEXT_FILE).read_text(encoding="utf-8"), flags=re.M)
    title, lead = head.removeprefix("# ").split("\n", 1)
    sections = (part.split("\n", 1) for part in parts)
    blocks = {name: tuple(body.strip().split("\n\n")) for name, body in sections}
    return StudyText(title, " ".join(lead.split()), blocks)
