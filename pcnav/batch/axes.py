"""The axes that a grid may have, the values they take, and what those change in a pipeline."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pydantic import BaseModel

from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, shown_value
from pcnav.config.pipeline_file import Pipeline
from pcnav.estimators.names import EstimatorName

SATELLITE_AXIS = "satellite"
RANGE_AXIS = "range_m"
TUMBLE_AXIS = "tumble_deg_s"


@dataclass(frozen=True)
class Axis:
    """One quantity that cases may differ in."""

    name: str
    """As written in a grid file, with its unit."""
    title: str
    """In words, for tables and figures."""
    unit: str
    """Empty for words and counts without one, 1 for a share."""
    expected: str
    """What its values have to be, for a message."""
    value_of: Callable[[object], AxisValue | None]
    """The checked value of something read from a file; None for what it cannot be."""
    apply: Callable[[Pipeline, AxisValue], Pipeline] = lambda pipeline, _: pipeline
    """The pipeline with the value; unchanged by axes that act elsewhere."""

    @property
    def label(self) -> str:
        """Title and unit: ``distance, m``."""
        return f"{self.title}, {self.unit}" if self.unit not in ("", "1") else self.title


def _number(low: float, *, above: bool = False, high: float = math.inf) -> Callable[..., AxisValue]:
    """Checks a number from ``low``, or above it, up to ``high``."""

    def value_of(found: object) -> float | None:
        # A bool is an int to Python, not to anyone who writes a grid.
        if isinstance(found, bool) or not isinstance(found, int | float):
            return None
        inside = (found > low if above else found >= low) and found <= high
        return float(found) if inside and math.isfinite(found) else None

    return value_of  # type: ignore[return-value]


def _count(found: object) -> int | None:
    return found if isinstance(found, int) and not isinstance(found, bool) and found > 0 else None


def _word(found: object) -> str | None:
    # A case's name is words between spaces.
    return found if isinstance(found, str) and found and not any(map(str.isspace, found)) else None


def _estimator(found: object) -> str | None:
    return str(found) if found in list(EstimatorName) else None


def _noise(key: str) -> Callable[[Pipeline, AxisValue], Pipeline]:
    return lambda pipeline, value: _with(pipeline, "noise", {key: value})


def _resolution(pipeline: Pipeline, value: AxisValue) -> Pipeline:
    """As many pixels across; the field of view and the shape of the image stay."""
    camera = pipeline.camera
    height = max(1, round(int(value) * camera.height_px / camera.width_px))
    return _with(pipeline, "camera", {"width_px": int(value), "height_px": height})


def _with(pipeline: Pipeline, table: str, changed: dict[str, AxisValue]) -> Pipeline:
    before: BaseModel = getattr(pipeline, table)
    return pipeline.model_copy(update={table: before.model_copy(update=changed)})


_SHARE = "numbers from 0 to 1"
_ALL = (
    Axis(SATELLITE_AXIS, "satellite", "", "names of shipped satellites or mesh files", _word),
    Axis(RANGE_AXIS, "distance", "m", "numbers above 0", _number(0.0, above=True)),
    Axis(TUMBLE_AXIS, "tumble rate", "deg/s", "numbers from 0 on", _number(0.0)),
    Axis(
        "frame_rate_hz",
        "frame rate",
        "Hz",
        "numbers above 0",
        _number(0.0, above=True),
        lambda pipeline, value: _with(pipeline, "scenario", {"frame_rate_hz": value}),
    ),
    Axis("resolution_px", "image width", "px", "whole numbers above 0", _count, _resolution),
    Axis(
        "range_sigma_m",
        "range noise",
        "m",
        "numbers from 0 on",
        _number(0.0),
        _noise("range_sigma_m"),
    ),
    Axis(
        "dropout_share",
        "lost returns",
        "1",
        _SHARE,
        _number(0.0, high=1.0),
        _noise("dropout_fraction"),
    ),
    Axis(
        "outlier_share", "outliers", "1", _SHARE, _number(0.0, high=1.0), _noise("outlier_fraction")
    ),
    Axis(
        "mixed_pixel_share",
        "mixed pixels",
        "1",
        _SHARE,
        _number(0.0, high=1.0),
        _noise("mixed_pixel_fraction"),
    ),
    Axis(ESTIMATOR_AXIS, "estimator", "", f"some of {', '.join(EstimatorName)}", _estimator),
)
AXES = {axis.name: axis for axis in _ALL}
"""Every axis by its name, in the order in which a case lists them."""


def axis_label(name: str) -> str:
    """An axis in words, with its unit."""
    axis = AXES.get(name)
    return name if axis is None else axis.label


def axis_setting(name: str, values: Sequence[AxisValue]) -> str:
    """An axis and the values it has, with its unit: ``distance 10, 20 and 40 m``."""
    axis = AXES.get(name)
    title = name if axis is None else axis.title
    unit = "" if axis is None or axis.unit in ("", "1") else f" {axis.unit}"
    *most, last = map(shown_value, values)
    return f"{title} {', '.join(most)} and {last}{unit}" if most else f"{title} {last}{unit}"
