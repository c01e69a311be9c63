"""The style of every figure: of reports, batches and studies."""

import io

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from pcnav.report.page import Drawing

INK, MUTED, GRID = "#1f2937", "#6b7280", "#e5e7eb"
LINE, BAND, BOUND, ALERT = "#1d4ed8", "#bfdbfe", "#f59e0b", "#ea580c"
PALE = "#cbd5e1"
"""Of what others are drawn over, or compared with."""
CATEGORIES = ("#2563eb", "#f59e0b", "#0d9488", "#9333ea", "#db2777", "#65a30d", "#64748b")

_WIDTH_IN = 5.8


def drawing(title: str, caption: str, figure: Figure) -> Drawing:
    """A figure for a page."""
    return Drawing(title, caption, svg_bytes(figure))


def svg_bytes(figure: Figure) -> bytes:
    """The figure as SVG, the same bytes for the same figure."""
    stream, before = io.BytesIO(), figure.dpi
    # Of what is drawn as pixels.
    figure.set_dpi(200)
    # Text as outlines looks the same on every machine; the salt and the missing date keep the
    # bytes reproducible. Figure.savefig would draw everything once before, for nothing.
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": "pcnav"}):
        FigureCanvasSVG(figure).print_svg(stream, metadata={"Date": None})  # type: ignore[no-untyped-call]
    figure.set_dpi(before)
    FigureCanvasAgg(figure)
    return stream.getvalue()


def new_figure(height_in: float) -> Figure:
    """An empty figure as wide as half a report."""
    figure = Figure(figsize=(_WIDTH_IN, height_in), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def style_axes(axes: Axes) -> None:
    """Spines, grid and labels in the look of the report."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color(MUTED)
    axes.grid(visible=True, color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=8, color=MUTED, labelcolor=INK)
    axes.xaxis.label.set(fontsize=8.5, color=INK)
    axes.yaxis.label.set(fontsize=8.5, color=INK)


def add_legend(figure: Figure, axes: Axes, max_columns: int = 4) -> None:
    """The legend of one of the axes, above all of them, where it covers no data."""
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        [shortened(label, 32) for label in labels],
        loc="outside upper left",
        ncols=min(len(labels), max_columns) or 1,
        fontsize=8,
        frameon=False,
        markerscale=2.5,
        handlelength=1.4,
        labelcolor=INK,
    )


def shortened(text: str, length: int) -> str:
    """Its beginning, with an ellipsis where it is cut."""
    return text if len(text) <= length else text[: length - 1] + "…"
