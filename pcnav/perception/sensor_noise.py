"""The noise of a depth sensor, as far as it is known: what errs, by how much, and how it is shared.

Returns err along their rays by white noise, which may grow with range. A real sensor errs in other
ways as well, which many pixels share: over a face (wrinkles, the correlation window of a stereo
matcher), over a frame (a common offset), and at the outline (a pixel returns from more or from less
than half its area). Each is zero until it is known to be there.
"""

from dataclasses import dataclass
from typing import overload

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray

Offsets = tuple[float, float, float, float]

OUTLINE_PRIOR_SD_PX = 0.3
"""How far off an outline may be seen, before any frame: pixels return from none to all of their
area covered, which displaces it by up to half a pixel."""
_UNFELT = 1e-4
_CLEAR_SD, _EXACT_PX = 3.0, 0.02
"""An outline is known to be displaced where it is by so many deviations, and more than that."""


@dataclass(frozen=True)
class SensorNoise:
    """What is known of the noise of the frames of one sensor."""

    sigma_m: float
    """Standard deviation of the white noise along a ray, at the reference range."""
    growth: int = 0
    """Power of the range that it grows by: 0 is constant, 1 linear, 2 quadratic."""
    reference_m: float = 1.0
    """The range at which ``sigma_m`` holds."""
    face_sd_m: float = 0.0
    """Standard deviation of the offset of a whole face along its normal, drawn anew for every face
    and frame."""
    face_tilt_sd_m: float = 0.0
    """That of each of its two tilts, at one standard deviation of its pixels."""
    unweighed_face_sd_m: float = 0.0
    """That of the offset of a face which ranges are not weighed by, but which is considered: where
    the outline is no witness of it it would hold the pose, and few frames do not rule it out."""
    unweighed_face_tilt_sd_m: float = 0.0
    """That of each of its two tilts, likewise."""
    unweighed_frame_sd_m: float = 0.0
    """That of an offset of the whole frame which few frames do not rule out."""
    unweighed_are_shown: bool = True
    """Whether frames show these errors. Else few frames do not rule them out, with a long tail."""
    face_correlation: float = 1.0
    """Of the errors of a face in successive frames."""
    frame_sd_m: float = 0.0
    """Standard deviation of an offset along the rays that a whole frame shares."""
    outline_offset_px: Offsets = (0.0, 0.0, 0.0, 0.0)
    """How far outward the outline is seen, along pixel rows or columns, in all frames alike: before
    space where it runs along the grid, and by how much more per unit of its slope against the grid;
    before another surface, likewise."""
    outline_offset_sd_px: Offsets = (0.0, 0.0, 0.0, 0.0)
    """How well they are known."""
    outline_sd_px: float = 0.0
    """Standard deviation by which a stretch of the outline is displaced, beyond the pixel grid."""

    @staticmethod
    def of(noise: "SensorNoise | float") -> "SensorNoise":
        """White noise of a standard deviation in metres, or noise that is known in full."""
        return noise if isinstance(noise, SensorNoise) else SensorNoise(float(noise))

    @staticmethod
    def before_any_frame(sigma_m: float) -> "SensorNoise":
        """White noise as it is stated, and an outline that may be seen anywhere near."""
        sd = OUTLINE_PRIOR_SD_PX
        return SensorNoise(sigma_m, outline_offset_sd_px=(sd, sd, sd, sd))

    @property
    def has_footprint(self) -> bool:
        """Whether pixels are known to see an area and not a line: beside an edge they then mix what
        lies on both sides."""
        both = zip(self.outline_offset_px, self.outline_offset_sd_px, strict=True)
        return any(abs(offset) > max(_CLEAR_SD * sd, _EXACT_PX) for offset, sd in both)

    @property
    def may_have_footprint(self) -> bool:
        """Whether they may, for all that is known."""
        return any(self.outline_offset_px) or any(self.outline_offset_sd_px)

    @property
    def is_white(self) -> bool:
        """Whether the errors of all returns and edges are independent."""
        return not self.has_face_errors and not self.has_shared_errors

    @property
    def has_face_errors(self) -> bool:
        """Whether the pixels of a face err in common."""
        return self.face_sd_m > 0.0 or self.face_tilt_sd_m > 0.0

    @property
    def has_unweighed_errors(self) -> bool:
        """Whether pixels may err in common by more than they are weighed by."""
        of_faces = self.unweighed_face_sd_m, self.unweighed_face_tilt_sd_m
        return any(sd > 0.0 for sd in (*of_faces, self.unweighed_frame_sd_m))

    @property
    def face_variance_m2(self) -> float:
        """Mean over the pixels of a face, seen face on, of the variance of what they have in
        common."""
        return self.face_sd_m**2 + 2.0 * self.face_tilt_sd_m**2

    @property
    def has_shared_errors(self) -> bool:
        """Whether there are errors that the faces of a frame share."""
        return self.frame_sd_m > 0.0 or any(self.outline_offset_sd_px)

    @property
    def shared_sd_m(self) -> float:
        """Standard deviation of what the pixels of a face have in common, along their rays."""
        return float(np.sqrt(self.frame_sd_m**2 + self.face_variance_m2))

    @property
    def frame_unit_m(self) -> float:
        """What an offset of a frame is counted in: its deviation, or what is too little to matter
        where none is known to be there, which keeps what frames tell of it."""
        return max(self.frame_sd_m, _UNFELT * self.sigma_m)

    @property
    def n_shared(self) -> int:
        """How many there are: the offset of a frame, and those of the outline."""
        return 1 + len(self.outline_offset_sd_px) if self.has_shared_errors else 0

    @overload
    def sigma_at(self, range_m: float) -> float: ...

    @overload
    def sigma_at(self, range_m: FloatArray) -> float | FloatArray: ...

    def sigma_at(self, range_m: float | FloatArray) -> float | FloatArray:
        """Standard deviation of the white noise at ranges (...), m; one number if constant."""
        if self.growth == 0:
            return self.sigma_m
        return self.sigma_m * (range_m / self.reference_m) ** self.growth

    def sigma_in(self, depth_m: DepthImage) -> float:
        """At the typical depth of an image (height, width) of z-depths, 0 where none returned."""
        if self.growth == 0:
            return self.sigma_m
        seen = depth_m[depth_m > 0.0]
        return float(self.sigma_at(float(np.median(seen)))) if len(seen) else self.sigma_m
