"""What a run knows of every state at its end: from the data, or only from its prior."""

from collections.abc import Sequence
from html import escape

import numpy as np

from pcnav.dynamics.blocks import Block
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import ACCEPTED_COLOUR, AMBIGUOUS, coloured

_STYLE = "font-size:12px;line-height:1.45;padding:4px 10px"
_FROM_DATA = coloured("■ data", ACCEPTED_COLOUR)
_PRIOR_ONLY = coloured("□ prior", AMBIGUOUS)


def knowledge_html(loaded: LoadedRun) -> str:
    """A row a state: its name, last value, 1 sigma, that of the prior, and who tells it."""
    known = np.flatnonzero(loaded.run.has_estimate)
    if not known.size:
        return f"<div style='{_STYLE}'>nothing is estimated</div>"
    frame = int(known[-1])
    rows = [row for block in loaded.trajectory.layout.blocks for row in _rows(loaded, block, frame)]
    head: tuple[str, ...] = ("state", "value", "1σ", "1σ before", "known from")
    if not loaded.verdicts:
        rows, head = [row[:3] for row in rows], head[:3]
    title = f"<b>{escape(loaded.name)}</b> at {loaded.run.time_s[frame]:.2f} s, frame {frame}"
    return f"<div style='{_STYLE}'>{title}{_table(head, rows)}{_combinations(loaded)}</div>"


def _rows(loaded: LoadedRun, block: Block, frame: int) -> list[tuple[str, ...]]:
    to_shown = block.to_shown
    unit = "" if block.shown_unit == "1" else f" {block.shown_unit}"
    values = loaded.trajectory[block][frame]
    sd = to_shown * loaded.sd(block, frame)
    # An attitude has no value per axis; its three standard deviations do.
    is_vector = np.shape(values) == (block.size,)
    rows: list[tuple[str, ...]] = []
    for k, (component, column) in enumerate(
        zip(block.components, block.error_columns, strict=True)
    ):
        value = f"{to_shown * values[k]:.5g}{unit}" if is_vector else "see the body axes"
        verdict = loaded.verdicts.get(column)
        before, source = "none", ""
        if verdict is not None:
            prior = to_shown * verdict.prior_sd
            before = f"{prior:.2g}{unit}" if np.isfinite(prior) else "none"
            source = _FROM_DATA if verdict.from_data else _PRIOR_ONLY
        told = f"{sd[k]:.2g}{unit}" if np.isfinite(sd[k]) else "unknown"
        rows.append((f"{block.title} {component}", value, told, before, source))
    return rows


def _combinations(loaded: LoadedRun) -> str:
    """What the data tell of combinations of states that no state alone shows."""
    states = {name for block in loaded.trajectory.layout.blocks for name in block.error_columns}
    rows = [
        (
            escape(name),
            f"{verdict.posterior_sd:.2g} {verdict.unit.replace('1', '')}",
            f"{verdict.prior_sd:.2g}",
            _FROM_DATA if verdict.from_data else _PRIOR_ONLY,
        )
        for name, verdict in loaded.verdicts.items()
        if name not in states
    ]
    return _table(("combination", "1σ", "1σ before", "known from"), rows) if rows else ""


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    cells = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in rows)
    light = "text-align:left;opacity:.75;font-weight:400"
    heads = "".join(f"<th style='{light}'>{name}</th>" for name in head)
    return f"<table style='border-spacing:0 1px;width:100%'><tr>{heads}</tr>{cells}</table>"


def _cell(text: str) -> str:
    return f"<td style='padding-right:10px;white-space:nowrap'>{text}</td>"
