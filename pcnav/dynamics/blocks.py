"""Named blocks of a state: what is estimated, in which unit, and what its columns are called.

An estimator's error state is a `Layout`: an ordered tuple of blocks. Whoever needs the rows of a
block asks the layout for them by name, so that estimators with different states share one writer,
one evaluation and one report.
"""

import math
from dataclasses import dataclass
from functools import cached_property

_XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class Block:
    """One quantity of a state."""

    name: str
    """Identifier: key of values and of the NEES in metrics.json."""
    quantity: str
    """Key of its errors in metrics.json, without the unit."""
    title: str
    """In words."""
    unit: str
    """Of the errors as stored: SI, rad."""
    shown_unit: str
    """Of the errors as people read them: degrees for angles."""
    columns: tuple[str, ...]
    """Of the values, in truth.csv and states.csv."""
    error_columns: tuple[str, ...]
    """Of the errors, one a component; ``sd_`` before them heads the deviations in states.csv."""
    components: tuple[str, ...]
    """Names of the components in figures and tables."""
    constant: bool = False
    """Whether it is a property of the target, not of its motion."""

    @property
    def size(self) -> int:
        """Number of components of the error."""
        return len(self.error_columns)

    @property
    def to_shown(self) -> float:
        """Factor from the unit as stored to that as people read it."""
        return 1.0 if self.unit == self.shown_unit else 180.0 / math.pi

    @property
    def sd_columns(self) -> tuple[str, ...]:
        """Columns of the standard deviations."""
        return tuple(f"sd_{name}" for name in self.error_columns)


def _vector(
    name: str, quantity: str, title: str, units: tuple[str, str], stem: str, constant: bool = False
) -> Block:
    columns = tuple(stem.format(axis) for axis in _XYZ)
    return Block(name, quantity, title, *units, columns, columns, _XYZ, constant)


POSITION = _vector("r_hill", "r_hill", "mass centre in hill", ("m", "m"), "r_{}_m")
VELOCITY = _vector("v_hill", "v_hill", "velocity in hill", ("m/s", "m/s"), "v_{}_m_s")
CENTRE = _vector("com_model", "com_model", "mass centre in model", ("m", "m"), "com_{}_m", True)
ATTITUDE = Block(
    name="theta_body",
    quantity="attitude",
    title="attitude",
    unit="rad",
    shown_unit="deg",
    columns=("q_x", "q_y", "q_z", "q_w"),
    error_columns=("theta_x_rad", "theta_y_rad", "theta_z_rad"),
    components=_XYZ,
)
"""The value is R_world_body (3, 3), the error a rotation vector in body axes:
``R_true = R_estimated exp(theta)``."""
RATE = _vector("omega_body", "omega_body", "angular rate", ("rad/s", "deg/s"), "w_{}_rad_s")
RATIOS = Block(
    name="inertia_ratios",
    quantity="inertia_ratios",
    title="inertia ratios",
    unit="1",
    shown_unit="1",
    columns=("i_yy", "i_zz", "i_xy", "i_xz", "i_yz"),
    error_columns=("i_yy", "i_zz", "i_xy", "i_xz", "i_yz"),
    components=("Iyy", "Izz", "Ixy", "Ixz", "Iyz"),
    constant=True,
)
"""Entries of the inertia matrix over Ixx."""

FILE_ORDER = (POSITION, VELOCITY, ATTITUDE, RATE, CENTRE, RATIOS)
"""The order of columns in truth.csv and states.csv, whatever the order of the error state."""
BLOCKS = {block.name: block for block in FILE_ORDER}


@dataclass(frozen=True)
class Layout:
    """The blocks of an error state, in its order."""

    blocks: tuple[Block, ...]

    @cached_property
    def _slices(self) -> dict[str, slice]:
        slices, start = {}, 0
        for block in self.blocks:
            slices[block.name] = slice(start, start + block.size)
            start += block.size
        return slices

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where its blocks stand, in its order."""
        return tuple(self._slices.values())

    def slice_of(self, block: Block) -> slice:
        """Where a block stands in the error state. Raises ``KeyError`` for one it does not have."""
        return self._slices[block.name]

    def __contains__(self, block: object) -> bool:
        return block in self.blocks

    @cached_property
    def size(self) -> int:
        """Components of the error state."""
        return sum(block.size for block in self.blocks)

    @property
    def in_file_order(self) -> tuple[Block, ...]:
        """Its blocks as files list them."""
        return tuple(block for block in FILE_ORDER if block in self.blocks)

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the values in states.csv."""
        return tuple(name for block in self.in_file_order for name in block.columns)

    @property
    def sd_columns(self) -> tuple[str, ...]:
        """Columns of the standard deviations in states.csv."""
        return tuple(name for block in self.in_file_order for name in block.sd_columns)


MASS_CENTRE_LAYOUT = Layout((POSITION, VELOCITY, CENTRE, ATTITUDE, RATE, RATIOS))
"""Yu 2019: 20 states, of a target with a model."""
MOTION_LAYOUT = Layout((POSITION, VELOCITY, ATTITUDE, RATE, RATIOS))
"""Hu 2024 and Segal 2011: 17 states of a target without a model."""
ROTATION_LAYOUT = Layout((ATTITUDE, RATE, RATIOS))
"""Deng 2024: 11 states, from attitudes alone."""
ATTITUDE_LAYOUT = Layout((ATTITUDE,))
"""Appl. Sci. 2022: the attitude of a chain of images; rates follow from it without deviations."""
POSE_LAYOUT = Layout(())
"""Estimators that give poses alone."""
