"""Pages: one template and one style for runs, studies and batches.

A page is a title, a few large values and parts; what a part holds is laid out by ``pieces.html``.
Every text given is escaped.
"""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from pcnav.files.text_table import TextTable


@dataclass(frozen=True)
class Drawing:
    """A finished figure."""

    title: str
    caption: str
    svg: bytes


@dataclass(frozen=True)
class Code:
    """Text in a fixed-width font."""

    text: str


Piece: TypeAlias = "str | TextTable | Drawing | Code | Mapping[str, object] | tuple[Piece, ...]"
"""A paragraph, a table with its title and note, a figure, code, tables of settings by name; or
pieces side by side where the window is wide enough. Pieces within those stand below each other."""


@dataclass(frozen=True)
class Part:
    """A titled part of a page."""

    title: str
    pieces: Sequence[Piece]


def document(
    title: str,
    lead: str,
    facts: Sequence[tuple[str, str]],
    parts: Sequence[Part],
    warnings: Sequence[str] = (),
) -> str:
    """A page: title, the line below it, sentences of warning, large values by name, and parts."""
    template = _environment().get_template("page.html")
    return template.render(title=title, lead=lead, facts=facts, parts=parts, warnings=warnings)


@cache
def _environment() -> Environment:
    found = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    found.filters["base64"] = lambda content: base64.b64encode(content).decode("ascii")
    # A narrow column may break a long name between its words.
    found.filters["breakable"] = lambda name: escape(name).replace("_", Markup("_<wbr>"))
    return found
