"""The axes that a grid may have, the values they take, and what those change in a pipeline.

Beside the axes listed here, any key of the pipeline file is one, by its path: ``features.count``.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any

from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError

from pcnav.batch.monte_carlo import Case, Run
from pcnav.config.motion import MotionKind
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import Footprint
from pcnav.config.surroundings import BackgroundKind, OccluderKind
from pcnav.config.table import Fraction, NonNegative, Pixels, Positive
from pcnav.estimators.registry import ESTIMATORS
from pcnav.files.toml_file import checked

AxisValue = str | float | int
"""What a case has on an axis."""
AxisValues = tuple[tuple[str, AxisValue], ...]
"""Axis and value, in the order in which the axes are shown."""
GridCase = Case[AxisValues]
"""One combination of axis values: its settings. Named like
``satellite=boxsat range_m=10 estimator=pcnav``."""
GridRun = Run[AxisValues]

SATELLITE_AXIS = "satellite"
RANGE_AXIS = "range_m"
TUMBLE_AXIS = "tumble_deg_s"
RESOLUTION_AXIS = "resolution_px"
FRAME_OFFSET_AXIS = "frame_offset_sigma"
GROWTH_AXIS = "range_noise_growth"
DISTORTION_AXIS = "distortion_k1"
RECORDING_AXIS, OBJECT_AXIS = "recording", "object"
"""Of recordings that lie in files: there is one run of each."""
ESTIMATOR_AXIS = "estimator"
"""The one axis that changes no frame."""
_DIGITS = 12
"""Of a number in a case's name: values closer than this are the same case."""


@dataclass(frozen=True)
class Axis:
    """One quantity that cases may differ in."""

    name: str
    """As written in a grid file, with its unit."""
    title: str
    """In words, for tables and figures."""
    unit: str
    """Empty for words and counts without one, 1 for a share."""
    type: Any
    """Of its values, as pydantic checks them."""
    key: str | None = None
    """Path in the pipeline file of what it sets; None where it acts elsewhere."""
    only_depth: bool = True
    """Whether it has a meaning for depth frames alone."""

    @property
    def label(self) -> str:
        """Title and unit: ``distance, m``."""
        return f"{self.title}, {self.unit}" if self.unit not in ("", "1") else self.title

    def value_of(self, found: object) -> AxisValue:
        """The checked value of something read from a file. Raises ``ValueError`` in one line."""
        # A path stands for whatever a pipeline file may say there.
        strict = self.name != self.key
        adapter = TypeAdapter(self.type, config=ConfigDict(strict=strict, allow_inf_nan=False))
        try:
            value = adapter.validate_python(found)
        except ValidationError as error:
            message = error.errors()[0]["msg"].removeprefix("Value error, ")
            raise ValueError(f"{message}, got {found!r}") from error
        kept = value if strict else found
        if not isinstance(kept, AxisValue):
            raise ValueError(f"expected a number or a word, got {found!r}")
        return kept


def _known_estimator(name: str) -> str:
    if name not in ESTIMATORS:
        raise ValueError(f"expected some of {', '.join(ESTIMATORS)}")
    return name


class NoiseGrowth(StrEnum):
    """With which power of the range the noise grows; at the case's distance it is the same."""

    CONSTANT = "constant"
    LINEAR = "linear"
    QUADRATIC = "quadratic"


def _one_of(words: type[StrEnum]) -> Any:
    """The type of an axis of words."""

    def known(word: str) -> str:
        if word not in set(words):
            raise ValueError(f"expected some of {', '.join(words)}")
        return word

    return Annotated[str, AfterValidator(known)]


# A case's name is words between spaces.
_Word = Annotated[str, Field(pattern=r"^\S+$")]
_ALL = (
    Axis(SATELLITE_AXIS, "satellite", "", _Word),
    Axis(RANGE_AXIS, "distance", "m", Positive),
    Axis(TUMBLE_AXIS, "tumble rate", "deg/s", NonNegative),
    Axis(
        *("frame_rate_hz", "frame rate", "Hz", Positive, "scenario.frame_rate_hz"),
        only_depth=False,
    ),
    Axis(RESOLUTION_AXIS, "image width", "px", Pixels),
    Axis("range_sigma_m", "range noise", "m", NonNegative, "noise.range_sigma_m"),
    Axis("dropout_share", "lost returns", "1", Fraction, "noise.dropout_fraction"),
    Axis("outlier_share", "outliers", "1", Fraction, "noise.outlier_fraction"),
    Axis("mixed_pixel_share", "mixed pixels", "1", Fraction, "noise.mixed_pixel_fraction"),
    Axis("false_return_share", "false returns", "1", Fraction, "noise.false_return_fraction"),
    Axis(FRAME_OFFSET_AXIS, "offset of a frame over range noise", "1", NonNegative),
    Axis(GROWTH_AXIS, "growth of the range noise", "", _one_of(NoiseGrowth)),
    Axis("footprint", "footprint", "", _one_of(Footprint), "noise.footprint"),
    Axis("stamp_jitter_s", "jitter of the stamps", "s", NonNegative, "noise.stamp_jitter_s"),
    Axis(DISTORTION_AXIS, "distortion k1", "1", float),
    Axis("background", "background", "", _one_of(BackgroundKind), "background.kind"),
    Axis("occluder", "occluder", "", _one_of(OccluderKind), "occluder.kind"),
    Axis("occluded_share", "occluded share", "1", Fraction, "occluder.share_fraction"),
    Axis("motion", "motion", "", _one_of(MotionKind), "motion.kind"),
    Axis("first_pose", "first pose", "", bool, "scenario.states_first_pose"),
    Axis(
        *(ESTIMATOR_AXIS, "estimator", "", Annotated[str, AfterValidator(_known_estimator)]),
        only_depth=False,
    ),
)
AXES = {axis.name: axis for axis in _ALL}
"""The axes that have a name of their own, in the order in which a case lists them."""


def named_axis(name: str) -> Axis:
    """An axis by its name, or a path of the pipeline file. Raises ``ValueError`` for neither."""
    if name in AXES:
        return AXES[name]
    table, _, key = name.partition(".")
    model = Pipeline.model_fields[table].annotation if table in Pipeline.model_fields else None
    fields = getattr(model, "model_fields", {})
    if key not in fields:
        keys = "a key of the pipeline file like features.count"
        raise ValueError(f"unknown axis; expected one of {', '.join(AXES)}, or {keys}")
    field = fields[key]
    type_ = Annotated[field.annotation, *field.metadata] if field.metadata else field.annotation
    return Axis(name, name, "", type_, name, only_depth=False)


def grid_case(values: Iterable[tuple[str, AxisValue]]) -> GridCase:
    """The case of some axis values."""
    settings = tuple(values)
    return Case(_words(settings), settings)


def scenario_of(case: GridCase) -> str:
    """The name without the estimator, axes in alphabetical order: what fixes the frames."""
    return _words(sorted(axis for axis in case.settings if axis[0] != ESTIMATOR_AXIS))


def shown_value(value: AxisValue) -> str:
    """A value as it stands in a case's name."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:.{_DIGITS}g}"


def with_axes(pipeline: Pipeline, case: GridCase, source: str) -> Pipeline:
    """A pipeline with what the axes of a case set in it.

    Raises `InputError`, which names the source and the key, for a value that cannot be there.
    """
    found: dict[str, Any] = pipeline.model_dump()
    for name, value in case.settings:
        key = named_axis(name).key
        if key is not None:
            table, _, field = key.partition(".")
            found[table][field] = value
    axes = dict(case.settings)
    for name, act in _ACTS.items():
        if name in axes:
            act(found, axes)
    return checked(source, Pipeline, found)


def _set_resolution(found: dict[str, Any], axes: Mapping[str, AxisValue]) -> None:
    """The field of view and the shape of the image stay."""
    camera, width = found["camera"], int(axes[RESOLUTION_AXIS])
    height = max(1, round(width * camera["height_px"] / camera["width_px"]))
    camera |= {"width_px": width, "height_px": height}


def _set_frame_offset(found: dict[str, Any], axes: Mapping[str, AxisValue]) -> None:
    noise = found["noise"]
    noise["frame_offset_sd_m"] = float(axes[FRAME_OFFSET_AXIS]) * noise["range_sigma_m"]


def _set_growth(found: dict[str, Any], axes: Mapping[str, AxisValue]) -> None:
    noise, sigma_m = found["noise"], found["noise"]["range_sigma_m"]
    distance_m = float(axes.get(RANGE_AXIS, math.hypot(*found["orbit"]["r_hill_m"])))
    match NoiseGrowth(str(axes[GROWTH_AXIS])):
        case NoiseGrowth.LINEAR:
            noise |= {"range_sigma_m": 0.0, "range_sigma_per_m": sigma_m / distance_m}
        case NoiseGrowth.QUADRATIC:
            noise |= {"range_sigma_m": 0.0, "range_sigma_per_m2": sigma_m / distance_m**2}


def _set_distortion(found: dict[str, Any], axes: Mapping[str, AxisValue]) -> None:
    k1 = float(axes[DISTORTION_AXIS])
    found["camera"] |= {"distortion_model": "opencv", "distortion": (k1, 0.0, 0.0, 0.0)}


# What follows from the noise that other axes set comes in this order.
_ACTS: Mapping[str, Callable[[dict[str, Any], Mapping[str, AxisValue]], None]] = {
    RESOLUTION_AXIS: _set_resolution,
    FRAME_OFFSET_AXIS: _set_frame_offset,
    GROWTH_AXIS: _set_growth,
    DISTORTION_AXIS: _set_distortion,
}


def axis_label(name: str) -> str:
    """An axis in words, with its unit."""
    return AXES[name].label if name in AXES else name


def axis_setting(name: str, values: Sequence[AxisValue]) -> str:
    """An axis and the values it has, with its unit: ``distance 10, 20 and 40 m``."""
    title, _, unit = axis_label(name).partition(", ")
    *most, last = map(shown_value, values)
    text = f"{', '.join(most)} and {last}" if most else last
    return f"{title} {text} {unit}".rstrip()


def _words(values: Iterable[tuple[str, AxisValue]]) -> str:
    return " ".join(f"{axis}={shown_value(value)}" for axis, value in values)
