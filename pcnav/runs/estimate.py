"""What any estimator says of one frame, and what its result folder has of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import FILE_ORDER, POSITION, Block, Layout
from pcnav.runs.records import RectangleRecord

Note = float | int | str | None
"""A number or a word of an estimator's own; None for no value."""


@dataclass(frozen=True)
class FeaturePoint:
    """A point of a target without a model, as estimated."""

    p_body: FloatArray
    """(3,) from the mass centre, body axes, m."""
    covariance: FloatArray
    """(3, 3) m^2."""


@dataclass(frozen=True)
class FeatureUse:
    """What became of the features of a frame, by their numbers."""

    seen: tuple[int, ...] = ()
    used: tuple[int, ...] = ()
    """By the filter."""
    rejected: tuple[int, ...] = ()
    """By its gate: wrong matches."""
    points: Mapping[int, FeaturePoint] = field(default_factory=dict)
    """All those estimated after the frame, seen in it or not."""


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
    window_nis: float | None = None
    """NIS over its degrees of freedom over the last frames, nan without any; None leaves it to
    `pcnav.runs.nis_window`."""
    notes: Mapping[str, Note] = field(default_factory=dict)
    """The estimator's own columns of states.csv, by name with its unit."""
    records: tuple[RectangleRecord, ...] = ()
    """Rows of measurements.csv."""
    features: FeatureUse = FeatureUse()
    """Of an estimator that lives on features."""
    new_axes: FloatArray | None = None
    """(3, 3) R_world_body of a frame from which on the body axes are new."""

    @property
    def has_estimate(self) -> bool:
        """Whether anything was estimated."""
        return bool(self.values) or self.T_cam_target is not None

    def __getitem__(self, block: Block) -> FloatArray:
        """The value of a block. Raises ``KeyError`` for one that is not there."""
        return self.values[block.name]


@dataclass(frozen=True)
class Output:
    """What an estimator's answers hold: what does not apply to it has no file and no column."""

    layout: Layout
    without_sd: tuple[Block, ...] = ()
    """Blocks that are told without deviations."""
    notes: tuple[str, ...] = ()
    """Names of its own columns."""
    has_nis: bool = True
    has_records: bool = False
    has_features: bool = False
    follows_signs: bool = False
    """Whether the sign of each quaternion follows the one before, so that none of them jumps."""

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All that have values, in the order of states.csv."""
        known = (*self.layout.blocks, *self.without_sd)
        return tuple(block for block in FILE_ORDER if block in known)

    @property
    def has_poses(self) -> bool:
        """Whether a pose comes with every estimate."""
        return POSITION in self.layout or not self.layout.blocks

    @property
    def columns(self) -> tuple[str, ...]:
        """The header of states.csv."""
        values = tuple(name for block in self.blocks for name in block.columns)
        nis = ("nis", "nis_dof", "window_nis") if self.has_nis else ()
        return ("time_s", *values, *self.layout.sd_columns, "status", *nis, *self.notes)
