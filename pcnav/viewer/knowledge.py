"""What a run knows of every state at its end: from the data, or only from its prior."""

from html import escape

import numpy as np

from pcnav.core.spatial import log_rotation
from pcnav.dynamics.blocks import ATTITUDE, FILE_ORDER, Block
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import ACCEPTED_COLOUR, AMBIGUOUS, coloured

_STYLE = "font-size:12px;line-height:1.35;padding:4px 10px"
_FROM_DATA = coloured("■ data", ACCEPTED_COLOUR)
_PRIOR_ONLY = coloured("□ prior", AMBIGUOUS)
_LIGHT = "text-align:left;opacity:.75;font-weight:400;padding:0 6px 0 0"


def knowledge_html(loaded: LoadedRun) -> str:
    """A row a state: its name, last value, 1 sigma, that of the prior, and who tells it.

    The unit stands at the head of each quantity: in every cell it made the table wider than the
    panel.
    """
    frame = loaded.run.final_frame
    if frame is None:
        return f"<div style='{_STYLE}'>nothing is estimated</div>"
    head: tuple[str, ...] = ("state", "value", "1σ", "1σ before", "known from")
    head = head if loaded.verdicts else head[:3]
    rows = "".join(
        _group(block, len(head))
        + "".join(_row(cells[: len(head)]) for cells in _rows(loaded, block, frame))
        for block in FILE_ORDER
        if block.name in loaded.trajectory.values
    )
    title = f"<b>{escape(loaded.name)}</b> at {loaded.run.time_s[frame]:.2f} s, frame {frame}"
    tables = f"{_table(head, rows)}{_combinations(loaded)}"
    return f"<div class='pcnav-known' style='{_STYLE}'>{title}{tables}</div>"


def _group(block: Block, columns: int) -> str:
    unit = "" if block.shown_unit == "1" else f", {block.shown_unit}"
    if block is ATTITUDE:
        unit = f" (world from body) as a rotation vector{unit}"
    return (
        f"<tr><th colspan={columns} style='{_LIGHT};padding-top:3px'>{block.title}{unit}</th></tr>"
    )


def _rows(loaded: LoadedRun, block: Block, frame: int) -> list[tuple[str, ...]]:
    to_shown = block.to_shown
    values = loaded.trajectory[block][frame]
    if block is ATTITUDE:
        values = log_rotation(values)
    sd = np.full(block.size, np.nan)
    if block in loaded.trajectory.layout:
        sd = to_shown * loaded.sd(block, frame)
    rows: list[tuple[str, ...]] = []
    for k, (component, column) in enumerate(
        zip(block.components, block.error_columns, strict=True)
    ):
        value = _rounded(float(to_shown * values[k]), float(sd[k]))
        verdict = loaded.verdicts.get(column)
        before, source = "none", ""
        if verdict is not None:
            prior = to_shown * verdict.prior_sd
            before = f"{prior:.2g}" if np.isfinite(prior) else "none"
            source = _FROM_DATA if verdict.from_data else _PRIOR_ONLY
        rows.append((component, value, _deviation(float(sd[k])), before, source))
    return rows


def _rounded(value: float, sd: float) -> str:
    """As many digits as the deviation leaves it."""
    if not np.isfinite(sd) or sd <= 0.0:
        return f"{value:.5g}"
    decimals = 1 - int(np.floor(np.log10(sd)))
    return f"{value:.{min(max(decimals, 0), 8)}f}"


def _deviation(sd: float) -> str:
    # What has none is no state: the axes are chosen so that it stays.
    return "held" if sd == 0.0 else f"{sd:.2g}" if np.isfinite(sd) else "not stated"


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
    head = ("combination", "1σ", "1σ before", "known from")
    return _table(head, "".join(map(_row, rows))) if rows else ""


def _table(head: tuple[str, ...], rows: str) -> str:
    heads = "".join(f"<th style='{_LIGHT}'>{name}</th>" for name in head)
    return f"<table style='border-spacing:0 1px;width:100%'><tr>{heads}</tr>{rows}</table>"


def _row(cells: tuple[str, ...]) -> str:
    """The first may be broken into lines: a combination names many states."""
    first, *others = cells
    kept = "".join(
        f"<td style='padding:0 6px 0 0;white-space:nowrap'>{each}</td>" for each in others
    )
    return f"<tr><td style='padding:0 6px 0 8px'>{first}</td>{kept}</tr>"
