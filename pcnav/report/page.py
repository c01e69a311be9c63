"""Pages: one template and one set of pieces for runs, studies and batches.

A package with a page of its own keeps a template of it in its folder ``templates`` and calls
`render`; the template extends ``page.html`` and imports the macros of ``pieces.html``. The
functions below are these macros for pages that are put together in Python. Every text given is
escaped; finished pieces are not.
"""

import base64
from collections.abc import Mapping, Sequence
from functools import cache

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

_HERE = "pcnav.report"


def render(package: str, template: str, **values: object) -> str:
    """A whole document of a package's template: ``render(__package__, "batch.html", ...)``."""
    return _environment(package).get_template(template).render(values)


@cache
def _environment(package: str) -> Environment:
    found = Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, _HERE))]),
        autoescape=lambda name: name is None or not name.endswith(".md"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    found.filters["base64"] = lambda content: base64.b64encode(content).decode("ascii")
    # A narrow column may break a long name between its words.
    found.filters["breakable"] = lambda name: escape(name).replace("_", Markup("_<wbr>"))
    return found


def _piece(macro: str, *values: object) -> str:
    pieces = _environment(_HERE).get_template("pieces.html").module
    return str(getattr(pieces, macro)(*values))


def page(title: str, body: Sequence[str]) -> str:
    """A whole document around finished pieces."""
    return render(_HERE, "page.html", title=title, body=Markup("\n".join(body)))


def heading(title: str, lead: str) -> str:
    """The page's title and the line below it."""
    return _piece("heading", title, lead)


def section(title: str, *pieces: str) -> str:
    """A titled part of the page."""
    return _piece("section", title, *map(Markup, pieces))


def subheading(title: str) -> str:
    """The title of one table within a part of the page."""
    return _piece("subheading", title)


def paragraph(text: str) -> str:
    """A paragraph of text."""
    return _piece("paragraph", text)


def preformatted(text: str) -> str:
    """Text in a fixed-width font."""
    return _piece("preformatted", text)


def cards(facts: Sequence[tuple[str, str]]) -> str:
    """Large values, each over its name."""
    return _piece("cards", facts)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """A table whose columns after the first ``text_columns`` hold numbers.

    What stands below the first line of a cell is set small.
    """
    return _piece("table", header, rows, text_columns)


def image(title: str, caption: str, media_type: str, content: bytes) -> str:
    """A figure carried inside the page."""
    return _piece("image", title, caption, media_type, content)


def grid(pieces: Sequence[str]) -> str:
    """Pieces side by side where the window is wide enough."""
    return _piece("together", "grid", [*map(Markup, pieces)])


def stack(pieces: Sequence[str]) -> str:
    """Pieces below each other, as one cell of a grid."""
    return _piece("together", "stack", [*map(Markup, pieces)])


def settings(tables: Mapping[str, object]) -> str:
    """One small table per table of settings; those outside any come first."""
    return _piece("settings", tables)
