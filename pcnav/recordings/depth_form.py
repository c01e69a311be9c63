"""What a stored pixel of a depth image means, and through what lens it was seen."""

from dataclasses import dataclass
from enum import StrEnum

from pcnav.core.distortion import Distortion, DistortionModel


class DepthIs(StrEnum):
    """What is stored of a return."""

    Z = "z"
    """Its distance along the optical axis."""
    RANGE = "range"
    """Its distance from the camera's centre."""


@dataclass(frozen=True)
class DepthForm:
    """How the images of a recording state depth, where it is not a plain z-depth image."""

    invalid_units: float | None = None
    """The stored unit that means no return besides 0."""
    depth_is: DepthIs = DepthIs.Z
    distortion_model: DistortionModel = DistortionModel.OPENCV
    distortion: tuple[float, ...] = ()
    """Coefficients in the model's order; empty without distortion."""

    @staticmethod
    def through(lens: Distortion | None) -> "DepthForm":
        """Of plain z-depths seen through a lens."""
        return (
            PLAIN
            if lens is None
            else DepthForm(distortion_model=lens.model, distortion=lens.coefficients)
        )

    @property
    def lens(self) -> Distortion | None:
        """The distortion, if there is any."""
        return Distortion(self.distortion_model, self.distortion) if any(self.distortion) else None


PLAIN = DepthForm()
"""z-depth through a pinhole, whose holes are 0."""
