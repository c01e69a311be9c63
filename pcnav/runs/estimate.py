"""What any estimator says of one frame, and what its result folder has of it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    FILE_ORDER,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
    Block,
    Layout,
)
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.runs.doubts import COLUMN as DOUBTS
from pcnav.runs.feature_outcomes import FeatureOutcomes
from pcnav.runs.records import RectangleRecord
from pcnav.runs.status import CLAIMED

OWN_WORDS = ("outcome", "motion", DOUBTS)
"""Columns of an estimator's own that hold words."""
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
    outcomes: FeatureOutcomes | None = None
    """Rows of feature_outcomes.csv; None for none."""


@dataclass(frozen=True, repr=False)
class Estimate:
    """One frame's answer. Blocks and covariance are there together or not at all.

    The properties are for programs: what is not estimated is None. A covariance is that of the
    error ``true - estimated`` of its value, in the order of its components.
    """

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
    layout: Layout | None = None
    """Blocks of the covariance, of an answer that a program is given."""
    pose_covariance: FloatArray | None = None
    """(6, 6) of the error of `pose`, of an answer that a program is given: the shift of the model's
    origin (m, camera axes), then the rotation vector (rad, model axes) with ``R_cam_model =
    R_estimated exp(theta)``."""

    def __repr__(self) -> str:
        return f"<Estimate at {self.time_s:.12g} s: {', '.join(self._words())}>"

    @property
    def has_estimate(self) -> bool:
        """Whether anything was estimated."""
        return bool(self.values) or self.T_cam_target is not None

    @property
    def is_claimed(self) -> bool:
        """Whether the estimator stands for it: it is locked, or ambiguous by symmetry alone."""
        return self.status in CLAIMED

    def __getitem__(self, block: Block) -> FloatArray:
        """The value of a block. Raises ``KeyError`` for one that is not there."""
        return self.values[block.name]

    @property
    def pose(self) -> FloatArray | None:
        """(4, 4) T_cam_model: ``p_cam = T_cam_model @ p_model``, m; claimed or not."""
        return self.T_cam_target

    @property
    def position(self) -> FloatArray | None:
        """(3,) of the target's mass centre from the chaser's, Hill axes, m."""
        return self.values.get(POSITION.name)

    @property
    def position_covariance(self) -> FloatArray | None:
        """(3, 3) m^2."""
        return self.covariance_of(POSITION)

    @property
    def velocity(self) -> FloatArray | None:
        """(3,) rate of the position as seen in the turning Hill axes, m/s."""
        return self.values.get(VELOCITY.name)

    @property
    def velocity_covariance(self) -> FloatArray | None:
        """(3, 3) m^2/s^2."""
        return self.covariance_of(VELOCITY)

    @property
    def attitude(self) -> FloatArray | None:
        """(3, 3) R_world_body; the body axes are those of the model."""
        return self.values.get(ATTITUDE.name)

    @property
    def attitude_covariance(self) -> FloatArray | None:
        """(3, 3) rad^2, of the rotation vector in body axes: ``R = R_estimated exp(theta)``."""
        return self.covariance_of(ATTITUDE)

    @property
    def rate(self) -> FloatArray | None:
        """(3,) inertial angular rate, body axes, rad/s."""
        return self.values.get(RATE.name)

    @property
    def rate_covariance(self) -> FloatArray | None:
        """(3, 3) rad^2/s^2."""
        return self.covariance_of(RATE)

    @property
    def mass_centre(self) -> FloatArray | None:
        """(3,) in the model frame, m."""
        return self.values.get(CENTRE.name)

    @property
    def mass_centre_covariance(self) -> FloatArray | None:
        """(3, 3) m^2."""
        return self.covariance_of(CENTRE)

    @property
    def inertia(self) -> FloatArray | None:
        """(3, 3) inertia matrix about the mass centre over its first entry, body axes."""
        ratios = self.values.get(RATIOS.name)
        return None if ratios is None else inertia_from_ratios(ratios)

    @property
    def inertia_covariance(self) -> FloatArray | None:
        """(5, 5) of Iyy, Izz, Ixy, Ixz, Iyz, entries of `inertia`."""
        return self.covariance_of(RATIOS)

    def covariance_of(self, block: Block) -> FloatArray | None:
        """(k, k) of a block; None where none is known."""
        if self.covariance is None or self.layout is None or block not in self.layout:
            return None
        rows = self.layout.slice_of(block)
        return self.covariance[rows, rows]

    def _words(self) -> Iterator[str]:
        """What one wants to see of it at a glance."""
        yield str(self.status)
        if self.T_cam_target is not None:
            yield f"{np.linalg.norm(self.T_cam_target[:3, 3]):.4g} m away"
        if self.pose_covariance is not None:
            shift, turn = np.sqrt(np.diag(self.pose_covariance).reshape(2, 3).max(axis=1))
            yield f"sd {1e3 * shift:.2g} mm {np.degrees(turn):.2g} deg"
        if self.rate is not None:
            yield f"turning at {np.degrees(np.linalg.norm(self.rate)):.3g} deg/s"


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
    """Whether points are estimated."""
    has_feature_outcomes: bool = False
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
