"""[scan]: a simulated sensor that looks along beams of its own, one after the other."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import Many, NonNegative, Table

_MAX_BEAMS = 2_000_000
_Angle = Annotated[float, Field(gt=0.0, le=160.0)]


class ScanPattern(StrEnum):
    """Where the beams of a scan look, and in which order."""

    NONE = "none"
    """No scan: a depth image."""
    FLASH = "flash"
    """Along all pixels of [camera] at once."""
    RASTER = "raster"
    """Along the pixels of [camera], row after row."""
    RINGS = "rings"
    """Along rings of one elevation each, all at the same azimuth, which turns: a spinning LiDAR.
    Beams outside the field of view of [camera] are not there."""
    ROSETTE = "rosette"
    """Along the petals of two turning prisms, over a circle that is the field of view of [camera]
    wide."""


class ScanTable(Table):
    """[scan]: scans instead of depth images."""

    pattern: ScanPattern = ScanPattern.NONE
    duration_s: NonNegative = 0.1
    """From the first beam of a scan to the last, the time of the frame in the middle; of rings that
    of a whole turn."""
    states_times: bool = True
    """Whether the recording tells when each beam was seen."""
    beams: Many = 20_000
    """Of a rosette."""
    prism_turns: tuple[float, float] = (31.4, -18.2)
    """Of a rosette: turns of its two prisms in a scan."""
    rings: Annotated[int, Field(ge=1, le=1024)] = 64
    ring_fov_deg: _Angle = 30.0
    """From the lowest ring to the highest."""
    azimuth_step_deg: Annotated[float, Field(ge=0.001, le=10.0)] = 0.2
    """Of rings, from beam to beam."""
    divergence_mrad: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Full angle of a beam: at an edge it returns as [noise] footprint says."""

    @property
    def is_used(self) -> bool:
        """Whether scans are simulated."""
        return self.pattern is not ScanPattern.NONE

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        if self.rings * 360.0 / self.azimuth_step_deg > _MAX_BEAMS:
            raise ValueError(f"azimuth_step_deg: expected at most {_MAX_BEAMS:,} beams a turn")
        return self
