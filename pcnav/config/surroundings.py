"""Tables of the pipeline file for what a simulated depth frame shows beside the target."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import Direction, Fraction, NonNegative, Positive, Table


class BackgroundKind(StrEnum):
    """What lies behind or under the target."""

    NONE = "none"
    """Empty space."""
    WALL = "wall"
    """A plane behind the target, at rest in the Hill frame."""
    EARTH = "earth"
    """A sphere behind the target, at rest in the Hill frame."""
    TABLE = "table"
    """A square plate that the target stands on."""


class BackgroundTable(Table):
    """[background]: what lies behind or under the simulated target."""

    kind: BackgroundKind = BackgroundKind.NONE
    behind_m: NonNegative | None = None
    """From the target's middle at time 0 along the boresight to the wall, or to the nearest point
    of the Earth; None takes one diameter of the target for a wall, 400 km for the Earth."""
    tilt_deg: Annotated[float, Field(ge=0.0, le=80.0)] = 0.0
    """Between the wall's normal and the boresight, about a drawn axis."""
    roughness_m: NonNegative = 0.0
    """Standard deviation of the height of a wall or a table."""
    earth_radius_m: Positive = 6.371e6
    earth_offset_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    """Between the boresight and the Earth's middle, in a drawn direction: brings the limb into
    view."""
    table_up_model: Direction = (0.0, 0.0, 1.0)
    """Normal of the table, model axes; it touches the mesh's lowest point along it."""
    table_moves: bool = True
    """Whether the table moves with the target, as under a carried camera; else it keeps the place
    that it has at time 0, and a target that turns about another axis than its normal sinks in."""
    table_width_m: Positive | None = None
    """None takes four diameters of the target."""
    clutter_count: Annotated[int, Field(ge=0, le=100)] = 0
    """Boxes, cylinders and balls of 0.2 to 0.7 diameters of the target: on the table, else
    about it in space, at rest in the Hill frame."""
    return_fraction: Fraction = 1.0
    """Share of the background's pixels that return, drawn in every frame."""


class OccluderKind(StrEnum):
    """What stands before the target."""

    NONE = "none"
    HAND = "hand"
    """Forearm, palm, thumb and fingers that hold the target and move with it."""
    ARM = "arm"
    """A chain of three rods that swings across the target's place."""
    BEAM = "beam"
    """A part of the servicer, at rest in the camera's frame."""


class OccluderTable(Table):
    """[occluder]: what stands before the simulated target."""

    kind: OccluderKind = OccluderKind.NONE
    share_fraction: Annotated[float, Field(gt=0.0, le=0.9)] = 0.4
    """Of the target's pixels in the first frame, those that hand or beam cover."""
    turns: bool = True
    """Whether the hand turns with the target; else it goes with its middle and stays before it."""
    start_s: NonNegative = 5.0
    """Time at which the arm enters the view."""
    end_s: Positive = 15.0
    """Time at which it has left it."""
    radius_m: Positive | None = None
    """Of the arm's rods and the beam; None takes 0.06 diameters of the target."""

    @model_validator(mode="after")
    def _ends_after_it_starts(self) -> Self:
        if not self.start_s < self.end_s:
            raise ValueError("end_s: expected a time after start_s")
        return self
