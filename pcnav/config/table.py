"""What the tables of a pipeline file are made of: the frozen base model and bounded numbers."""

import logging
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, model_validator

Vector3 = tuple[float, float, float]
Vector5 = tuple[float, float, float, float, float]
Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


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


def _renamed(key: object) -> object:
    """What a key of the last release is called now; the key itself where it is none."""
    if isinstance(key, str):
        for old, new in reversed(_RENAMED.items()):
            if key.startswith(old):
                return new + key.removeprefix(old)
    return key
