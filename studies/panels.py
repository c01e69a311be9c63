"""Panels that several studies draw, and bars."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, finite
from pcnav.report.figures import (
    CATEGORIES,
    LINE,
    PALE,
    add_legend,
    new_figure,
    style_axes,
)
from pcnav.report.panels import Curve, Panel, Scale


def curves_of(values: Mapping[str, FloatArray]) -> list[Curve]:
    """Plain lines by name."""
    return [Curve(name, each) for name, each in values.items()]


def percentiles_of(values: FloatArray, percentiles: Sequence[float]) -> list[Curve]:
    """Percentiles over the runs of values (n, runs)."""
    found = np.percentile(values, percentiles, axis=1)
    return curves_of({f"{p:g} %": curve for p, curve in zip(percentiles, found, strict=True)})


def error_panel(
    label: str,
    error: FloatArray,
    sd: FloatArray | None = None,
    printed: float | None = None,
    settled_from: int | None = None,
) -> Panel:
    """Errors (n,) about zero, in a band of three stated deviations (n,).

    ``printed`` is the largest error that a paper states, drawn on both sides. From the frame
    ``settled_from`` on errors and typical band fill the axis, so that a start-up transient does
    not flatten the rest.
    """
    limits = None
    if settled_from is not None:
        reach = [np.abs(error[settled_from:]), np.array([0.0 if printed is None else printed])]
        if sd is not None:
            reach.append(np.array([3.0 * np.nanmedian(sd[settled_from:])]))
        top = 1.1 * float(finite(np.concatenate(reach)).max(initial=0.0))
        limits = (-top, top) if top > 0.0 else None
    return Panel(
        label,
        [Curve("error", error, colour=LINE)],
        Scale.ABOUT_ZERO,
        bands={} if sd is None else {"3 sd stated": (-3.0 * sd, 3.0 * sd)},
        levels={} if printed is None else {"printed": printed},
        limits=limits,
    )


def mean_squared_panel(label: str, judged: MeanSquared) -> Panel:
    """Means of squared normalised errors (n,) over the runs, against their 95 % bounds."""
    return Panel(
        label,
        [Curve("mean over the runs", judged.mean, colour=LINE)],
        Scale.FROM_ZERO,
        bands={"95 % bounds": (judged.lower, judged.upper)},
        base=1.0,
    )


def component_panels(
    labels: Sequence[str],
    truth: FloatArray,
    estimates: Mapping[str, FloatArray],
    at: FloatArray | None = None,
    style: str = "-",
) -> list[Panel]:
    """A panel for every component of a truth (n, k) and of estimates by name.

    The estimates are (m, k) at ``at`` (m,), or at the times of the truth.
    """
    return [
        Panel(
            label,
            [
                Curve("truth", truth[:, k], colour=PALE, width=2.0),
                *(Curve(name, values[:, k], at, style) for name, values in estimates.items()),
            ],
        )
        for k, label in enumerate(labels)
    ]


def bars_figure(
    groups: Mapping[str, FloatArray],
    names: Sequence[str],
    labels: tuple[str, str],
) -> Figure:
    """Bars (n,) of every group side by side, over their names (n,); labels of both axes."""
    figure = new_figure(3.0)
    axes = figure.add_subplot()
    style_axes(axes)
    width, places = 0.8 / len(groups), np.arange(len(names))
    for k, (colour, (name, values)) in enumerate(zip(CATEGORIES, groups.items(), strict=False)):
        offset = (k - 0.5 * (len(groups) - 1)) * width
        axes.bar(places + offset, values, width, color=colour, label=name)
    axes.set_xticks(places, names)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    add_legend(figure, axes)
    return figure
