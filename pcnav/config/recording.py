"""[recording]: what a recording does not say of itself, and which of its frames are taken."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import Count, Positive, Table

_Name = Annotated[str, Field(min_length=1, max_length=1000)]


class RecordingTable(Table):
    """How depth frames are opened. A key that a format has no use for is refused."""

    camera_px: tuple[float, float, float, float] | None = None
    """fx, fy, cx, cy of a pinhole, px; replaces what the recording says. Pixel centres are at
    integer coordinates."""
    unit_m: Positive | None = None
    """Metres of one stored unit; replaces what the recording says."""
    frame_rate_hz: Positive | None = None
    """Of frames without time stamps."""
    topic: _Name | None = None
    """Of a bag: the depth images or organised clouds."""
    camera_topic: _Name | None = None
    """Of a bag: the CameraInfo of the images."""
    object: Annotated[int, Field(ge=0, le=999_999)] | None = None
    """obj_id of the target among the objects of a BOP scene."""
    start: Annotated[int, Field(ge=0)] = 0
    """Place of the first frame that is taken, counted from 0."""
    frames: Count | None = None
    """How many are taken at most; None takes all."""
    every: Count = 1
    """Only every so many of them."""

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        if self.camera_px is not None and not (self.camera_px[0] > 0.0 and self.camera_px[1] > 0.0):
            raise ValueError("camera_px: expected fx fy cx cy with focal lengths above 0")
        return self

    @property
    def rows(self) -> slice:
        """The frames that are taken."""
        end = None if self.frames is None else self.start + self.frames * self.every
        return slice(self.start, end, self.every)

    @property
    def selects(self) -> bool:
        """Whether frames are left out."""
        return self.rows != slice(0, None, 1)


AS_IT_IS = RecordingTable()
"""Nothing said: all frames of a recording that speaks for itself."""
