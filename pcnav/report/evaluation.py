"""What a run is worth: errors against the truth, consistency, and what the data told."""

from math import sqrt

import numpy as np
from matplotlib.figure import Figure

from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.statistics import CONFIDENCE
from pcnav.dynamics.blocks import BLOCKS, FILE_ORDER, MASS_CENTRE_LAYOUT
from pcnav.evaluation.consistency import Consistency, squared_errors
from pcnav.evaluation.information_gain import (
    ENOUGH_BITS,
    FROM_DATA,
    MAX_PRIOR_SHARE,
    StateGain,
)
from pcnav.files.text_table import MISSING, TextTable, display_unit, number
from pcnav.report.content import ReportContent
from pcnav.report.figures import ALERT, LINE, drawing
from pcnav.report.page import Piece
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.report.states import block_title
from pcnav.report.summary import ERROR_HEADINGS, error_row

_NEES_HEADINGS = (
    "block",
    "NEES per dof",
    "95 % bounds",
    "frames inside own 95 %",
    "errors over stated sigma",
    "verdict",
)
_GAIN_HEADINGS = ("verdict", "unit", "prior sd", "final sd", "bits", "prior's share")


def against_the_truth(content: ReportContent) -> list[Piece]:
    """Error norms by quantity."""
    metrics = content.metrics
    if not metrics.quantities:
        return []
    rows = [error_row(quantity) for quantity in metrics.quantities]
    cells = tuple((row.title, row.unit, *row.numbers) for row in rows)
    pieces: list[Piece] = [
        f"{metrics.frames_compared} frames have both an estimate and a truth. Norms of the error "
        "vectors in the frames named. Median, 95 % and largest are those of the last third of the "
        "run.",
        TextTable("", "", ("error", "unit", *ERROR_HEADINGS), cells, text_columns=2),
    ]
    if metrics.symmetry:
        pieces.append(
            "The attitude is known up to the target's symmetry: errors are those to the "
            f"equivalent truth under symmetry {metrics.symmetry} of the target."
        )
    return pieces


def consistency(content: ReportContent) -> list[Piece]:
    """Whether innovations and errors have the size that the covariances claim."""
    nis, nees = content.metrics.nis, content.metrics.nees
    pieces: list[Piece] = []
    if nis.frames or nees:
        caption = (
            "Squared normalised "
            + " and ".join(["innovations"] * bool(nis.frames) + ["errors"] * bool(nees))
            + " over the 95 % chi-square bound of their frame: one in twenty belongs above 1."
        )
        figure = drawing("Consistency over time", caption, consistency_figure(content))
        text = (
            "Are the stated covariances honest? NIS and NEES per degree of freedom are 1 when they "
            "are. Innovations are independent from frame to frame. The errors of successive frames "
            "are correlated, so the 95 % bounds of the NEES are those of a single frame; many runs "
            "tell more (pcnav table)."
        )
        pieces.append((figure, (text,)))
    if nees:
        pieces.append(TextTable("", "", _NEES_HEADINGS, tuple(map(_nees_row, nees))))
    return pieces


def consistency_figure(content: ReportContent) -> Figure:
    """NIS, and the NEES where there is a truth, over the 95 % chi-square bound of each frame."""
    run, errors = content.run, content.metrics.errors
    panels = []
    if content.metrics.nis.frames:
        panels.append(_squared_panel("NIS", run.nis, run.nis_dof))
    if errors is not None and content.metrics.nees:
        *_, (squared, degrees) = squared_errors(run, errors).values()
        panels.append(_squared_panel("NEES", squared, np.full(len(run), degrees)))
    return panels_figure(run.time_s, panels, row_in=1.6)


def _squared_panel(name: str, squared: FloatArray, degrees: IntArray) -> Panel:
    """Squared normalised errors as dots, over the 95 % chi-square bound of their frame."""
    # The bound changes with the number of measurements; their ratio has one line to compare with.
    ratio, used = np.full(len(squared), np.nan), np.isfinite(squared) & (degrees > 0)
    ratio[used] = squared[used] / chi_square.quantile(CONFIDENCE, degrees[used])
    curves = [
        Curve("inside", np.where(ratio <= 1.0, ratio, np.nan), style=".", colour=LINE),
        Curve("outside", np.where(ratio > 1.0, ratio, np.nan), style=".", colour=ALERT),
    ]
    band = {"95 % of the frames belong here": (np.zeros(len(ratio)), np.ones(len(ratio)))}
    return Panel(f"{name} / bound", curves, Scale.FROM_ZERO, bands=band)


def _nees_row(values: Consistency) -> tuple[str, ...]:
    title = BLOCKS[values.name].title if values.name in BLOCKS else "whole state"
    if not values.frames:
        return (title, *[MISSING] * 4, "no usable covariance")
    verdict = "consistent"
    if values.mean_per_degree > values.upper:
        verdict = "too confident"
    elif values.mean_per_degree < values.lower:
        verdict = "too cautious"
    if values.unusable_frames:
        verdict += f"; {values.unusable_frames} frames unusable"
    return (
        title,
        number(values.mean_per_degree),
        f"{values.lower:.3f} to {values.upper:.3f}",
        f"{values.share_inside:.1%}",
        number(sqrt(values.mean_per_degree)),
        verdict,
    )


def information_gain(content: ReportContent) -> list[Piece]:
    """The states one by one, and the combinations that single states hide."""
    gain = content.gain
    if gain is None:
        return []
    rows, prior_only = [], []
    for block in FILE_ORDER:
        title, states = block_title(block), gain.states[MASS_CENTRE_LAYOUT.slice_of(block)]
        own = list(zip(block.components, states, strict=True))
        shown = (block.to_shown, block.shown_unit)
        rows += [_gain_row(f"{title}, {component}", each, *shown) for component, each in own]
        unknown = [component for component, each in own if not each.known]
        if unknown:
            prior_only.append(f"{title}: {', '.join(unknown)}")
    verdict = (
        f"Prior only are {'; '.join(prior_only)}."
        if prior_only
        else f"Here every state is {FROM_DATA}."
    )
    combinations = tuple(
        _gain_row(each.name, each, 1.0, each.unit)
        for each in (*gain.com_combinations, *gain.ratio_combinations)
    )
    return [
        f"A state is {FROM_DATA} when at most {MAX_PRIOR_SHARE:.0%} of its final variance is due "
        "to the prior of the mass properties, which takes data that at least halve the standard "
        f"deviation of one of these, or when it gained {ENOUGH_BITS:g} bits or more. Position and "
        "velocity are seen of the model's origin: the prior leaves them no more certain than the "
        f"mass centre. Attitude and rate are seen as they are, without any prior. {verdict}",
        TextTable("", "", ("state", *_GAIN_HEADINGS), tuple(rows), text_columns=3),
        "A motion may leave a combination of states unknown while each of them gains. These are "
        "the independent combinations of the mass centre and of the inertia ratios, the least "
        "known of each first.",
        TextTable("", "", ("combination", *_GAIN_HEADINGS), combinations, text_columns=3),
    ]


def _gain_row(title: str, state: StateGain, scale: float, unit: str) -> tuple[str, ...]:
    by, unit = display_unit(unit, scale * state.posterior_sd)
    return (
        title,
        state.verdict,
        unit,
        number(by * scale * state.prior_sd) if np.isfinite(state.prior_sd) else "none",
        number(by * scale * state.posterior_sd),
        number(state.bits),
        f"{state.prior_share:.1%}",
    )
