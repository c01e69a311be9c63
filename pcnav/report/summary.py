"""Metrics as people read them: numbers with units, and the table a command prints at its end."""

from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from pcnav.evaluation.consistency import Consistency
from pcnav.evaluation.information_gain import FROM_DATA, PRIOR_ONLY, InformationGain
from pcnav.evaluation.metrics import Metrics, QuantityErrors
from pcnav.files.text_table import MISSING, display_unit, number

ERROR_HEADINGS = ("RMS whole", "RMS 2nd half", "RMS last 3rd", "median", "95 %", "max")
"""Median, 95 % point and maximum are those of the last third of the run."""


@dataclass(frozen=True)
class ErrorRow:
    """One quantity's errors as text, all in the same unit."""

    title: str
    unit: str
    numbers: tuple[str, ...]
    """Under `ERROR_HEADINGS`."""
    median: str
    """Of the last third, when the filter has settled."""


def error_row(quantity: QuantityErrors) -> ErrorRow:
    """The row of a table for one quantity, in metres or millimetres as its errors ask for."""
    settled = quantity.last_third if quantity.last_third.frames else quantity.whole
    scale, unit = display_unit(quantity.unit, settled.rms)
    values = (
        quantity.whole.rms,
        quantity.second_half.rms,
        quantity.last_third.rms,
        settled.median,
        settled.at(95),
        settled.maximum,
    )
    texts = tuple(number(scale * value) for value in values)
    return ErrorRow(quantity.title, unit, texts, median=number(scale * settled.median))


def run_facts(metrics: Metrics, gain: InformationGain | None = None) -> list[tuple[str, str]]:
    """What a run says of itself, as pairs of a name and a value with its unit.

    ``gain`` is None in a run without an estimate.
    """
    facts = [
        ("frames", f"{metrics.frames} in {number(metrics.duration_s)} s"),
        ("frames with an estimate", _estimates(metrics)),
    ]
    statuses = [f"{name} {share:.1%}" for name, share in metrics.status_share.items()]
    facts.append(("status", ", ".join(statuses) or MISSING))
    if metrics.nis.frames:
        facts.append(("NIS per degree of freedom", consistency_text(metrics.nis)))
    if gain is not None:
        facts.append((FROM_DATA, gain_text(gain)))
    alone = len(metrics.nees) == 1
    whole_state = (block for block in metrics.nees if alone or block.name == "all")
    name = "NEES per degree of freedom"
    return facts + [(name, consistency_text(block)) for block in whole_state]


def gain_text(gain: InformationGain) -> str:
    """How many states the data tell, and the names of the others."""
    count, others = len(gain.states), gain.prior_only
    text = f"{count - len(others)} of {count} states"
    return f"{text}; {PRIOR_ONLY}: {', '.join(others)}" if others else text


def consistency_text(values: Consistency) -> str:
    """The mean, its bounds and the share of frames inside theirs."""
    if not values.frames:
        return MISSING
    bounds = f"{values.lower:.3f} to {values.upper:.3f}"
    inside = f"{values.share_inside:.1%} of {values.frames} frames inside their own 95 %"
    return f"{values.mean_per_degree:.3f} (95 %: {bounds}); {inside}"


def summary_table(metrics: Metrics, gain: InformationGain | None = None) -> Table:
    """The table printed at the end of a run: errors when there is a truth, facts below them."""
    facts = run_facts(metrics, gain)
    if not metrics.quantities:
        table = Table("run", "value", title="Run summary", title_justify="left")
        for name, value in facts:
            table.add_row(name, escape(value))
        return table
    # Without frame lines and padding the numbers fit a terminal of 80 columns.
    table = Table(box=SIMPLE_HEAD, pad_edge=False, padding=0)
    table.title, table.title_justify = "Errors against the truth", "left"
    table.caption_justify = "left"
    table.add_column("quantity")
    table.add_column("unit")
    for heading in ERROR_HEADINGS:
        table.add_column(heading.replace("RMS ", "RMS\n"), justify="right")
    for quantity in metrics.quantities:
        row = error_row(quantity)
        table.add_row(row.title, row.unit, *row.numbers)
    lines = ["median, 95 % and max: last third of the run"]
    table.caption = "\n".join(lines + [f"{name}: {escape(value)}" for name, value in facts])
    return table


def _estimates(metrics: Metrics) -> str:
    if not metrics.frames_with_estimate:
        return "none"
    share = metrics.frames_with_estimate / metrics.frames
    after = number(metrics.first_estimate_after_s)
    return f"{metrics.frames_with_estimate} ({share:.1%}), the first after {after} s"
