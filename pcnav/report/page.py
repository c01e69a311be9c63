"""The plain HTML pieces a report is put together from; every text given is escaped here."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from string import Template

_STYLE = """
:root { --ink: #1f2937; --muted: #6b7280; --line: #e5e7eb; --paper: #ffffff; --accent: #1d4ed8; }
* { box-sizing: border-box; }
body { margin: 0; background: #f3f4f6; color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, Arial, sans-serif; }
main { max-width: 1220px; margin: 0 auto; padding: 28px 24px 48px; }
h1 { font-size: 28px; line-height: 1.2; margin: 0 0 4px; overflow-wrap: anywhere; }
h2 { font-size: 18px; margin: 36px 0 12px; }
p.lead { color: var(--muted); margin: 0 0 20px; }
p { max-width: 75ch; }
code { font: 13px/1.5 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(170px, 1fr)); gap: 12px; }
.card, figure, .panel { background: var(--paper); border: 1px solid var(--line);
  border-radius: 10px; }
.card { padding: 12px 16px; }
.card b { display: block; font-size: 20px; white-space: nowrap;
  line-height: 1.3; font-variant-numeric: tabular-nums; }
.card span { color: var(--muted); font-size: 13px; }
.panel { padding: 6px 16px 10px; overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 10px; text-align: left; border-bottom: 1px solid var(--line);
  vertical-align: top; }
tr:last-child td { border-bottom: 0; }
th { color: var(--muted); font-size: 13px; font-weight: 600; }
.number { text-align: right; white-space: nowrap; }
th.number { white-space: normal; }
table.data td:first-child { min-width: 140px; }
td small { color: var(--muted); font-size: 12px; }
.grid { display: grid; grid-template-columns: repeat(auto-fill, minmax(540px, 1fr)); gap: 16px;
  align-items: start; margin-top: 12px; }
.columns { columns: 3 360px; column-gap: 16px; font-size: 13px; }
.columns .panel { break-inside: avoid; margin-bottom: 16px; }
.columns td { padding: 4px 6px; overflow-wrap: anywhere; }
.columns td:first-child { min-width: 16ch; overflow-wrap: normal; }
h3 { font-size: 15px; margin: 6px 0; }
.stack { display: grid; gap: 16px; }
figure { margin: 0; padding: 12px 14px; }
figure h3 { font-size: 15px; margin: 0 0 6px; }
figure img { display: block; width: 100%; height: auto; }
figcaption { color: var(--muted); font-size: 13px; margin-top: 6px; }
pre { background: var(--paper); border: 1px solid var(--line); border-radius: 10px; margin: 0;
  padding: 12px 16px; overflow-x: auto; }
@media (max-width: 620px) { .grid { grid-template-columns: 1fr; } }
"""

_PAGE = Template(
    """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>$style</style>
</head>
<body>
<main>
$body
</main>
</body>
</html>
"""
)


def page(title: str, body: Sequence[str]) -> str:
    """A whole document around finished pieces."""
    return _PAGE.substitute(title=escape(title), style=_STYLE, body="\n".join(body))


def heading(title: str, lead: str) -> str:
    """The page's title and the line below it."""
    return f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>'


def section(title: str, *pieces: str) -> str:
    """A titled part of the page."""
    return "\n".join([f"<section>\n<h2>{escape(title)}</h2>", *pieces, "</section>"])


def subheading(title: str) -> str:
    """The title of one table within a part of the page."""
    return f"<h3>{escape(title)}</h3>"


def paragraph(text: str) -> str:
    """A paragraph of text."""
    return f"<p>{escape(text)}</p>"


def preformatted(text: str) -> str:
    """Text in a fixed-width font."""
    return f"<pre><code>{escape(text)}</code></pre>"


def cards(facts: Sequence[tuple[str, str]]) -> str:
    """Large values, each over its name."""
    items = [
        f'<div class="card"><b>{escape(value)}</b><span>{escape(name)}</span></div>'
        for name, value in facts
    ]
    return '<div class="cards">\n' + "\n".join(items) + "\n</div>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], text_columns: int = 1) -> str:
    """A table whose columns after the first ``text_columns`` hold numbers.

    What stands below the first line of a cell is set small.
    """

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}>{_lines(text)}</{tag}>"
            if k < text_columns
            else f'<{tag} class="number">{_lines(text)}</{tag}>'
            for k, text in enumerate(row)
        )

    lines = [f"<tr>{cells('td', row)}</tr>" for row in rows]
    head = f"<thead><tr>{cells('th', header)}</tr></thead>" if header else ""
    body = "\n".join(lines)
    return f'<div class="panel"><table class="data">{head}<tbody>{body}</tbody></table></div>'


def image(title: str, caption: str, media_type: str, content: bytes) -> str:
    """A figure carried inside the page."""
    data = base64.b64encode(content).decode("ascii")
    return (
        f"<figure><h3>{escape(title)}</h3>"
        f'<img alt="{escape(title)}: {escape(caption)}" src="data:{media_type};base64,{data}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def grid(pieces: Sequence[str]) -> str:
    """Pieces side by side where the window is wide enough."""
    return '<div class="grid">\n' + "\n".join(pieces) + "\n</div>"


def stack(pieces: Sequence[str]) -> str:
    """Pieces below each other, as one cell of a grid."""
    return '<div class="stack">\n' + "\n".join(pieces) + "\n</div>"


def settings(tables: Mapping[str, object]) -> str:
    """One small table per table of settings; those outside any come first."""
    loose = {name: value for name, value in tables.items() if not isinstance(value, Mapping)}
    groups = [("general", loose)] if loose else []
    groups += [(name, dict(value)) for name, value in tables.items() if isinstance(value, Mapping)]
    panels = [
        f'<div class="panel"><h3>{escape(name)}</h3>{_rows(group)}</div>' for name, group in groups
    ]
    return '<div class="columns">\n' + "\n".join(panels) + "\n</div>"


def _lines(text: str) -> str:
    first, _, below = escape(text).partition("\n")
    return f"{first}<br><small>{below}</small>" if below else first


def _rows(group: Mapping[str, object]) -> str:
    rows = (
        f"<tr><td>{_breakable(name)}</td><td>{escape(_setting(value))}</td></tr>"
        for name, value in group.items()
    )
    return "<table><tbody>" + "\n".join(rows) + "</tbody></table>"


def _breakable(name: str) -> str:
    """A long name that a narrow column may break between its words."""
    return escape(name).replace("_", "_<wbr>")


def _setting(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(str(item) for item in value)
    return "not set" if value is None else str(value) or "(empty)"
