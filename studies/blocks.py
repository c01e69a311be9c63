"""The blocks of the twenty states as the studies show them."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
)
from pcnav.evaluation.consistency import squared_normalised_errors


@dataclass(frozen=True)
class ShownBlock:
    """Part of the state that is judged by itself."""

    name: str
    rows: slice
    """Of the error state."""
    unit: str
    """That numbers are shown in; "1" without any."""
    scale: float
    """From SI to it."""

    @property
    def size(self) -> int:
        """Degrees of freedom."""
        return int(self.rows.stop - self.rows.start)

    @property
    def label(self) -> str:
        """Name and unit."""
        return self.name if self.unit == "1" else f"{self.name}, {self.unit}"

    def shown(self, errors: FloatArray) -> FloatArray:
        """(..., k) of errors or deviations (..., 20), in the unit."""
        return np.asarray(self.scale * errors[..., self.rows])

    def squared(self, errors: FloatArray, covariance: FloatArray) -> FloatArray:
        """(n,) squared normalised errors of (n, 20) with their covariances (n, 20, 20)."""
        return squared_normalised_errors(errors[:, self.rows], covariance[:, self.rows, self.rows])


_DEGREES = float(np.rad2deg(1.0))
BLOCKS = {
    name: ShownBlock(name, MASS_CENTRE_LAYOUT.slice_of(block), unit, scale)
    for name, block, unit, scale in (
        ("position", POSITION, "mm", 1e3),
        ("velocity", VELOCITY, "mm/s", 1e3),
        ("mass centre", CENTRE, "mm", 1e3),
        ("attitude", ATTITUDE, "deg", _DEGREES),
        ("rate", RATE, "deg/s", _DEGREES),
        ("inertia ratios", RATIOS, "1", 1.0),
    )
}
WHOLE = ShownBlock("all", slice(0, MASS_CENTRE_LAYOUT.size), "1", 1.0)
JUDGED = {**BLOCKS, WHOLE.name: WHOLE}
"""The blocks and the whole state."""
