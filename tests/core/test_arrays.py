"""Batches of arrays put together."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, joined


@dataclass(frozen=True)
class Measured:
    name: str
    time_s: FloatArray
    values: FloatArray


def test_batches_are_joined_along_an_axis() -> None:
    time_s = np.arange(3.0)
    parts = [Measured(name, time_s, np.full((2, 3), value)) for name, value in (("a", 1), ("b", 2))]
    by_rows = joined(parts, alike=("time_s",))
    assert by_rows.name == "a" and by_rows.values[:, 0].tolist() == [1, 1, 2, 2]
    np.testing.assert_array_equal(by_rows.time_s, time_s)
    by_columns = joined([Measured("a", part.values, part.values) for part in parts], axis=1)
    assert by_columns.values.tolist() == by_columns.time_s.tolist() == [[1, 1, 1, 2, 2, 2]] * 2
