"""The state of a page in its address: a link, a reload and a restart open the same picture."""

from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import parse_qs, urlencode

import numpy as np

from pcnav.viewer.assessment import Opening
from pcnav.viewer.frames import ColourBy
from pcnav.viewer.render_options import Layer

_CAMERA_NUMBERS = 7
_MAX_DIGITS = 1000
"""Python refuses longer ones."""
_MAX_FRAME = _MAX_POINTS = 10**9


@dataclass(frozen=True)
class PageState:
    """What a page shows. What an address does not say is None."""

    frame: int | Opening | None = None
    """A number, or what to look for; an address that a page sets itself has numbers."""
    camera: tuple[float, ...] | None = None
    """Place (3), what it looks at (3), m, and the field of view, rad."""
    layers: frozenset[Layer] | None = None
    colour_by: ColourBy | None = None
    max_points: int | None = None
    plots: str | None = None
    dark: bool | None = None

    def address(self) -> str:
        """What follows the ? of the address."""
        told: dict[str, str] = {}
        if self.frame is not None:
            told["frame"] = str(self.frame)
        if self.camera is not None:
            told["camera"] = ",".join(f"{value:.5g}" for value in self.camera)
        if self.layers is not None:
            told["layers"] = ",".join(str(layer) for layer in Layer if layer in self.layers)
        if self.colour_by is not None:
            told["points"] = str(self.colour_by)
        if self.max_points is not None:
            told["returns"] = str(self.max_points)
        if self.plots is not None:
            told["plots"] = self.plots
        if self.dark is not None:
            told["theme"] = "dark" if self.dark else "light"
        return urlencode(told, safe=",")


def read_address(text: str) -> PageState:
    """What an address says; what is no part of ours is passed over."""
    try:
        told = {name: values[-1] for name, values in parse_qs(text, max_num_fields=20).items()}
    except ValueError:
        return PageState()
    layers = told.get("layers")
    known = {str(layer): layer for layer in Layer}
    theme = told.get("theme")
    return PageState(
        frame=_frame(told),
        camera=_camera(told),
        layers=None
        if layers is None
        else frozenset(known[name] for name in layers.split(",") if name in known),
        colour_by=next((by for by in ColourBy if str(by) == told.get("points")), None),
        max_points=_whole(told.get("returns", ""), _MAX_POINTS),
        plots=told.get("plots"),
        dark=None if theme not in ("dark", "light") else theme == "dark",
    )


def _frame(told: Mapping[str, str]) -> int | Opening | None:
    asked = told.get("frame", "")
    if asked in set(Opening):
        return Opening(asked)
    return _whole(asked, _MAX_FRAME)


def _whole(digits: str, most: int) -> int | None:
    """A number from 0 to ``most``; None for what is none."""
    is_number = digits.isascii() and digits.isdigit() and len(digits) < _MAX_DIGITS
    return min(int(digits), most) if is_number else None


def _camera(told: Mapping[str, str]) -> tuple[float, ...] | None:
    try:
        values = tuple(float(each) for each in told.get("camera", "").split(","))
    except ValueError:
        return None
    sound = len(values) == _CAMERA_NUMBERS and bool(np.isfinite(values).all())
    if not sound or not 0.01 < values[-1] < np.pi or np.allclose(values[:3], values[3:6]):
        return None
    return values
