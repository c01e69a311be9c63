"""Status and legend with what is exported: written onto a picture, or laid over a page."""

import re
from functools import cache
from html import escape, unescape
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from pcnav.viewer.frames import Shot
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import RESIDUAL_STOPS, hex_of
from pcnav.viewer.panels import legend_html
from pcnav.viewer.render_options import RenderOptions
from pcnav.viewer.status_bar import status_of_frame

_BAR: tuple[int, int, int] = (27, 28, 32)
_INK = "#c8ccd4"
_ROW_PX, _MARGIN_PX, _FONT_PX = 24, 10, 13
_GRADIENT_PX = 160
_SPAN = re.compile(r"<span style='color:(#[0-9a-f]{6})'>(.*?)</span>")
_TAG = re.compile(r"<[^>]*>")

Words = list[tuple[str, str]]
"""Colour and text."""


def status_words(runs: tuple[LoadedRun, ...], frame: int) -> list[Words]:
    """What the bar of the view says, a row a run; then frame and time."""
    told = status_of_frame(runs, frame)
    rows = [[_word(item) for item in items] for items in told["rows"]]
    rows[0].append((_INK, f"frame {frame} of {told['last']} · {told['time']:.2f} s"))
    return rows


def _word(item: dict[str, Any]) -> tuple[str, str]:
    label = f"{item['label']} " if "label" in item else ""
    return item.get("colour", _INK), f"{label}{item['value']}"


def legend_words(
    loaded: LoadedRun, frame: int, options: RenderOptions, shot: Shot | None
) -> list[Words]:
    """The legend of the view in rows; of residuals without its bar."""
    known = loaded.pose(frame) is not None
    html = legend_html(loaded, options, shot, has_estimate=known)
    rows = [_words(part) for part in re.split(r"</div>", html)]
    return [row for row in rows if row]


def _words(html: str) -> Words:
    words: Words = []
    for k, part in enumerate(_SPAN.split(html)):
        if k % 3 == 1:
            continue
        colour = _INK if k % 3 == 0 else _SPAN.split(html)[k - 1]
        text = unescape(_TAG.sub(" ", part)).strip()
        if text:
            words.append((colour, text))
    return words


def annotated(
    image: npt.NDArray[np.uint8],
    runs: tuple[LoadedRun, ...],
    frame: int,
    options: RenderOptions,
    shot: Shot | None,
) -> npt.NDArray[np.uint8]:
    """(h, w, 3) a picture (h', w, 3) between its status and its legend."""
    head = status_words(runs, frame)
    foot = legend_words(runs[0], frame, options, shot)
    has_bar = shot is not None and shot.shows_residuals(options.colour_by)
    width = image.shape[1]
    above = len(head) * _ROW_PX
    below = sum(len(_wrapped(row, width)) for row in foot) * _ROW_PX
    whole = Image.new("RGB", (width, above + len(image) + below), _BAR)
    whole.paste(Image.fromarray(image), (0, above))
    pen, y = ImageDraw.Draw(whole), 0
    for row in head:
        _write(pen, row, _MARGIN_PX, y)
        y += _ROW_PX
    y += len(image)
    for k, row in enumerate(foot):
        for line in _wrapped(row, width):
            _write(pen, line, _MARGIN_PX, y)
            y += _ROW_PX
        if has_bar and k == 0:
            _gradient(whole, width - _GRADIENT_PX - _MARGIN_PX, y - _ROW_PX + 6)
    return np.asarray(whole)


def _write(pen: ImageDraw.ImageDraw, words: Words, x: float, y: float) -> None:
    for colour, text in words:
        pen.text((x, y + 4), text, fill=colour, font=_font())
        x += _font().getlength(text) + 12.0


def _wrapped(words: Words, width: int) -> list[Words]:
    """Rows that fit a width, broken between words."""
    rows: list[Words] = [[]]
    x = float(_MARGIN_PX)
    for colour, text in words:
        for word in text.split():
            length = _font().getlength(word) + 12.0
            if x + length > width - _GRADIENT_PX - 2 * _MARGIN_PX and rows[-1]:
                rows.append([])
                x = float(_MARGIN_PX)
            last = rows[-1][-1] if rows[-1] else None
            if last is not None and last[0] == colour:
                rows[-1][-1] = (colour, f"{last[1]} {word}")
            else:
                rows[-1].append((colour, word))
            x += length
    return rows


def _gradient(whole: Image.Image, x: int, y: int) -> None:
    share = np.linspace(-1.0, 1.0, _GRADIENT_PX)
    stops = np.array(RESIDUAL_STOPS, dtype=np.float64)
    channels = [np.interp(share, (-1.0, 0.0, 1.0), stops[:, c]) for c in range(3)]
    bar = np.tile(np.stack(channels, axis=-1)[None], (12, 1, 1)).astype(np.uint8)
    whole.paste(Image.fromarray(bar), (x, y))


@cache
def _font() -> ImageFont.FreeTypeFont:
    """A font that has the letters of the units."""
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(path), _FONT_PX)


def overlaid(
    html: str,
    runs: tuple[LoadedRun, ...],
    frame: int,
    options: RenderOptions,
    shot: Shot | None,
) -> str:
    """A page of a scene with status and legend laid over it."""
    rows = "".join(
        "<div>"
        + "&emsp;".join(f"<span style='color:{c}'>{escape(text)}</span>" for c, text in words)
        + "</div>"
        for words in status_words(runs, frame)
    )
    known = runs[0].pose(frame) is not None
    legend = legend_html(runs[0], options, shot, has_estimate=known)
    style = (
        "position:fixed;left:8px;z-index:100;padding:6px 10px;border-radius:6px;max-width:420px;"
        f"font:13px/1.5 system-ui,sans-serif;color:{_INK};background:{hex_of(_BAR)};"
        "pointer-events:none;"
    )
    laid = (
        f"<div style='{style}top:8px;max-width:none'>{rows}</div>"
        f"<div style='{style}bottom:8px'>{legend}</div>"
    )
    end = html.rindex("</body>")
    return html[:end] + laid + html[end:]
