"""How a frame is to be drawn, and numbers as viser takes them."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import viser

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.viewer.frames import MAX_POINTS, ColourBy
from pcnav.viewer.palette import Rgb


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
    MOMENTUM = "momentum"
    TRAIL = "trail"


DEFAULT_LAYERS = frozenset(Layer) - {Layer.PRINCIPAL, Layer.ATTITUDE, Layer.MOMENTUM}


CAMERA_FOV_RAD = float(np.radians(40.0))
"""Of a camera that is not the chaser's."""


@dataclass(frozen=True)
class RenderOptions:
    """How a frame is to be drawn."""

    layers: frozenset[Layer] = DEFAULT_LAYERS
    colour_by: ColourBy = ColourBy.PLANE
    magnified: float | None = None
    """Ellipsoids and cone are drawn so many times larger than 3 sigma; None for what is seen."""
    max_points: int = MAX_POINTS
    point_size: float = 1.0
    """Over the distance of neighbouring returns."""
    forecast_s: float | None = None
    """The ghost of the future is drawn so far ahead of the last estimate; None for none."""
    residual_scale_m: float | None = None
    """End of the scale of residuals; None for that of the sensor's noise."""


def wxyz_of(R: FloatArray) -> tuple[float, float, float, float]:
    """The order of viser, the only place that has it."""
    x, y, z, w = (float(value) for value in xyzw_from_rotation(R))
    return w, x, y, z


def place(node: viser.SceneNodeHandle, T: FloatArray) -> None:
    """Put a node at a (4, 4) pose."""
    node.wxyz, node.position = wxyz_of(T[:3, :3]), vector(T[:3, 3])


def line_colour(colour: Rgb) -> Rgb:
    """A colour as lines and arrows need it: the browser takes theirs for linear light."""
    linear = np.round(255.0 * (np.array(colour) / 255.0) ** 2.2).astype(int)
    return int(linear[0]), int(linear[1]), int(linear[2])


def vector(values: FloatArray) -> tuple[float, float, float]:
    """Three plain numbers."""
    x, y, z = (float(value) for value in values)
    return x, y, z
