"""How a frame is to be drawn, and numbers as viser takes them."""

from dataclasses import dataclass
from enum import StrEnum

from pcnav.arrays import FloatArray
from pcnav.spatial import xyzw_from_rotation
from pcnav.viewer.frames import ColourBy


class Layer(StrEnum):
    """What can be shown or hidden."""

    POINTS = "points"
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    NAMES = "names"
    MESH = "mesh"
    TRUTH = "true mesh"
    SENSOR = "sensor"
    BODY = "body axes"
    PRINCIPAL = "principal axes"
    COM = "mass centre"
    POSITION = "position"
    ATTITUDE = "attitude"
    RATE = "rate"
    MOMENTUM = "angular momentum"
    TRAIL = "trail"


DEFAULT_LAYERS = frozenset(Layer) - {Layer.PRINCIPAL, Layer.ATTITUDE, Layer.MOMENTUM}


@dataclass(frozen=True)
class Look:
    """How a frame is to be drawn."""

    layers: frozenset[Layer] = DEFAULT_LAYERS
    colour_by: ColourBy = ColourBy.PLANE
    magnified: float = 10.0
    """Ellipsoids and cone are drawn so many times larger than 3 sigma."""


def wxyz_of(R: FloatArray) -> tuple[float, float, float, float]:
    """The order of viser, the only place that has it."""
    x, y, z, w = (float(value) for value in xyzw_from_rotation(R))
    return w, x, y, z


def vector(values: FloatArray) -> tuple[float, float, float]:
    """Three plain numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z
