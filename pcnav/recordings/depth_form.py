"""What a stored pixel of a depth image means, and through what lens it was seen."""

from dataclasses import dataclass
from enum import StrEnum


class DepthIs(StrEnum):
    """What is stored of a return."""

    Z = "z"
    """Its distance along the optical axis."""
    RANGE = "range"
    """Its distance from the camera's centre."""


class DistortionModel(StrEnum):
    """How a lens departs from a pinhole."""

    OPENCV = "opencv"
    """Radial and tangential: k1, k2, p1, p2 and, where there are more, k3 or k3 to k6."""
    FISHEYE = "fisheye"
    """k1 to k4 of the angle to the optical axis."""


@dataclass(frozen=True)
class DepthForm:
    """How the images of a recording state depth, where it is not a plain z-depth image."""

    invalid_units: float | None = None
    """The stored unit that means no return besides 0."""
    depth_is: DepthIs = DepthIs.Z
    distortion_model: DistortionModel = DistortionModel.OPENCV
    distortion: tuple[float, ...] = ()
    """Coefficients in the model's order; empty without distortion."""


PLAIN = DepthForm()
"""z-depth through a pinhole, whose holes are 0."""
