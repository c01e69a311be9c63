"""Array type names used across the package, and members of batches of arrays."""

from collections.abc import Collection, Sequence
from dataclasses import Field, fields, replace
from typing import Any, ClassVar, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
IntArray: TypeAlias = npt.NDArray[np.intp]
DepthImage: TypeAlias = npt.NDArray[np.float32]
"""(height, width) z-depth, metres; 0 where no return came back."""


Part: TypeAlias = tuple[slice, slice]
"""Rows and columns of an image."""


def neighbours(axis: int, step: int = 1) -> tuple[Part, Part]:
    """The parts of an image that lie so many pixels apart along an axis: here, and there."""
    here, there, whole = slice(None, -step), slice(step, None), slice(None)
    return ((here, whole), (there, whole)) if axis == 0 else ((whole, here), (whole, there))


class AnyDataclass(Protocol):
    """An instance of any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


Batch = TypeVar("Batch", bound=AnyDataclass)
"""A dataclass of arrays over one leading dimension; its other fields are common to all."""


def picked(batch: Batch, index: IntArray | BoolArray | int) -> Batch:
    """The members of a batch at (b,) places, or one member without the leading dimension."""
    return replace(batch, **{name: array[index] for name, array in _arrays(batch)})


def joined(batches: Sequence[Batch], axis: int = 0, alike: Collection[str] = ()) -> Batch:
    """The members of batches in one, along an axis; ``alike`` fields are those of the first."""
    arrays = {
        name: np.concatenate([getattr(each, name) for each in batches], axis)
        for name, _ in _arrays(batches[0])
        if name not in alike
    }
    return replace(batches[0], **arrays)


def chosen(which: BoolArray, new: Batch, old: Batch) -> Batch:
    """The members of a new batch where marked (B,), of an old one where not."""
    changes = {}
    for name, array in _arrays(new):
        mask = which.reshape(-1, *(1,) * (array.ndim - 1))
        changes[name] = np.where(mask, array, getattr(old, name))
    return replace(new, **changes)


def is_finite(batch: AnyDataclass) -> BoolArray:
    """(B,) whether all numbers of a member are finite."""
    finite = [np.isfinite(array.reshape(len(array), -1)).all(axis=1) for _, array in _arrays(batch)]
    return np.asarray(np.all(finite, axis=0))


def _arrays(batch: AnyDataclass) -> list[tuple[str, FloatArray]]:
    values = ((field.name, getattr(batch, field.name)) for field in fields(batch))
    return [(name, value) for name, value in values if isinstance(value, np.ndarray)]
