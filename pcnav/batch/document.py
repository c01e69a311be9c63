"""The tables of a batch as one Markdown document, to stand in a project's own documentation."""

from collections.abc import Sequence
from datetime import date

from pcnav.batch.page import BatchFacts, TablePart

_COLUMNS = "| estimator | what it is | is told of the pose |\n| --- | --- | --- |\n"


def batch_document(facts: BatchFacts, parts: Sequence[TablePart], command: str, day: date) -> str:
    """All tables with what has to be known of them: command, day, versions and the grid."""
    versions = ", ".join(f"{name} {text}" for name, text in facts.versions.items())
    lead = (
        f"{facts.runs} runs of {facts.cases} cases, {len(facts.failures)} of them failed. "
        f"Tabulated on {day.isoformat()} by `{command}`, with {versions}."
    )
    pieces = [f"# Accuracy: {facts.name}\n", lead + "\n"]
    if facts.estimators:
        rows = "".join(f"| {' | '.join(each)} |\n" for each in facts.estimators)
        pieces.append(_COLUMNS + rows)
    for part in parts:
        pieces.append(f"## {part.title}\n")
        pieces += [_table(table.to_markdown(), table.title == part.title) for table in part.tables]
    pieces.append(f"## The grid as run\n\n```toml\n{facts.grid_toml.strip()}\n```\n")
    return "\n".join(pieces)


def _table(markdown: str, is_titled: bool) -> str:
    """A table under the title of its part needs none of its own."""
    return markdown.split("\n", 2)[2] if is_titled else markdown
