"""[region]: which part of a depth frame may be the target."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import NonNegative, Positive, Table

_Pixel = Annotated[int, Field(ge=0, le=16_384)]
OWN_MASKS = "visib"
"""Name of the masks that a BOP scene carries itself."""


class RegionTable(Table):
    """What is left of a frame before anything is looked for in it.

    Outside the masks, beyond the far gate and at the background a frame then has no return.
    Outside the box and nearer than the near gate nothing is known of it.
    """

    masks: Annotated[str, Field(min_length=1)] | None = None
    """Folder of PNG masks, not 0 where the target is, named 000000.png or 000000_000000.png after
    the frame; or `visib`, the `mask_visib` of the recording, which are part of its truth."""
    mask_object: Annotated[int, Field(ge=0, le=999_999)] | None = None
    """Place of the target among the objects of a frame, where there are masks of several."""
    min_range_m: NonNegative | None = None
    """Near gate, along the ray."""
    max_range_m: Positive | None = None
    """Far gate, along the ray."""
    box_px: tuple[_Pixel, _Pixel, _Pixel, _Pixel] | None = None
    """First column and row that belong to it, and first column and row that do not any more."""
    background: Annotated[str, Field(min_length=1)] | None = None
    """Depth image of the scene without the target, in the form of the recording's own."""

    @model_validator(mode="after")
    def _ends_come_after_beginnings(self) -> Self:
        if self.max_range_m is not None and self.max_range_m <= (self.min_range_m or 0.0):
            raise ValueError("max_range_m: expected more than min_range_m")
        if self.box_px is not None:
            u0, v0, u1, v1 = self.box_px
            if not (u0 < u1 and v0 < v1):
                raise ValueError("box_px: expected u0 v0 u1 v1 with u0 < u1 and v0 < v1")
        if self.mask_object is not None and self.masks is None:
            raise ValueError("mask_object: expected masks, of which it is")
        return self
