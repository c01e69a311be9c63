"""What any estimator says of one frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import Block

Note = float | int | str | None
"""A number or a word of an estimator's own; None for no value."""


@dataclass(frozen=True)
class Estimate:
    """One frame's answer. Blocks and covariance are there together or not at all."""

    time_s: float
    status: str
    """A `pcnav.runs.status.Status`."""
    values: Mapping[str, FloatArray] = field(default_factory=dict)
    """Estimated values by name of a block, see `pcnav.dynamics.trajectory.Trajectory`; empty while
    there is no estimate."""
    covariance: FloatArray | None = None
    """(size, size) in the order of the estimator's layout."""
    T_cam_target: FloatArray | None = None
    """(4, 4) see `Trajectory`."""
    nis: float = float("nan")
    """Normalised innovation squared of what was used; nan without any."""
    nis_dof: int = 0
    notes: Mapping[str, Note] = field(default_factory=dict)
    """The estimator's own columns of states.csv, by name with its unit."""
    records: tuple[object, ...] = ()
    """Rows of measurements.csv."""
    points: Mapping[int, FloatArray] = field(default_factory=dict)
    """(3,) estimated points of a target without a model by feature, body axes, m."""

    @property
    def has_estimate(self) -> bool:
        """Whether anything was estimated."""
        return bool(self.values) or self.T_cam_target is not None

    def __getitem__(self, block: Block) -> FloatArray:
        """The value of a block. Raises ``KeyError`` for one that is not there."""
        return self.values[block.name]
