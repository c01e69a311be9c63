"""What the tables of a pipeline file are made of: the frozen base model and bounded numbers."""

import logging
import math
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, Strict, model_validator

_SMALLEST, _LARGEST = 1e-30, 1e15
"""Of what is not 0: products and squares of such numbers are numbers, too."""


def _of_this_world(value: float) -> float:
    if value != 0.0 and not _SMALLEST <= abs(value) <= _LARGEST:
        raise ValueError(f"expected 0 or a magnitude from {_SMALLEST:g} to {_LARGEST:g}")
    return value


def _of_a_file_system(text: str) -> str:
    parts = text.replace("\\", "/").split("/")
    if "\0" in text or len(text) > 4000 or any(len(part.encode()) > 255 for part in parts):
        raise ValueError("expected a path that a file system can have")
    return text


Number = Annotated[float, AfterValidator(_of_this_world)]
Place = Annotated[str, AfterValidator(_of_a_file_system)]
# TOML has lists, not tuples: also a strict table takes those.
Vector2 = Annotated[tuple[Number, Number], Strict(False)]
Vector3 = Annotated[tuple[Number, Number, Number], Strict(False)]
Vector5 = Annotated[tuple[Number, Number, Number, Number, Number], Strict(False)]


def _direction(values: tuple[float, float, float]) -> tuple[float, float, float]:
    length = math.sqrt(sum(value * value for value in values))
    if not 0.0 < length < math.inf:
        raise ValueError(f"expected a direction, got {', '.join(f'{x:g}' for x in values)}")
    return values


Direction = Annotated[Vector3, AfterValidator(_direction)]
Positive = Annotated[Number, Field(gt=0.0)]
NonNegative = Annotated[Number, Field(ge=0.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Probability = Annotated[float, Field(gt=0.0, lt=1.0)]
Count = Annotated[int, Field(ge=1)]
# Bounded, since memory is allocated by them.
Pixels = Annotated[int, Field(gt=0, le=16_384)]
Many = Annotated[int, Field(gt=0, le=1_000_000)]


_LOG = logging.getLogger("pcnav")
_RENAMED = {
    "most_": "max_",
    "largest_": "max_",
    "longest_": "max_",
    "fewest_": "min_",
    "least_": "min_",
    "fewest_sd": "min_significance",
}
"""Keys, or their beginnings, as they were called up to release 0.1; the last that fits counts."""


class Table(BaseModel):
    """One TOML table: frozen, no unknown keys, no infinities."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def __repr_args__(self) -> Iterator[tuple[str | None, Any]]:
        """What differs from the defaults: all keys of all tables are no line to look at."""
        for name, value in super().__repr_args__():
            field = type(self).model_fields.get(name or "")
            if field is None or value != field.get_default(call_default_factory=True):
                yield name, value

    @model_validator(mode="before")
    @classmethod
    def _take_old_keys(cls, found: Any) -> Any:
        """Keys of the last release are read for one more, with a warning."""
        if not isinstance(found, dict):
            return found
        taken = {}
        for key, value in found.items():
            name = key if key in cls.model_fields else _renamed(key)
            if name == key or name not in cls.model_fields or name in found:
                taken[key] = value
                continue
            _LOG.warning("%s is called %s now; the old name is read for one release", key, name)
            taken[name] = value
        return taken


class StrictTable(Table):
    """A table of a file beside data, in which numbers are numbers, and texts are none."""

    model_config = ConfigDict(strict=True)


def _renamed(key: object) -> object:
    """What a key of the last release is called now; the key itself where it is none."""
    if isinstance(key, str):
        for old, new in reversed(_RENAMED.items()):
            if key.startswith(old):
                return new + key.removeprefix(old)
    return key
