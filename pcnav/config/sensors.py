"""Tables of the pipeline file for what is simulated of a motion: cameras, rig, points, faults."""

from dataclasses import replace
from enum import StrEnum
from typing import Annotated, Self

import numpy as np
from pydantic import Field, Strict, model_validator

from pcnav.config.table import (
    Direction,
    Fraction,
    Many,
    NonNegative,
    Pixels,
    Positive,
    Table,
    Vector3,
)
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera, R_cam_hill
from pcnav.core.distortion import COEFFICIENTS, Distortion, DistortionModel
from pcnav.core.stereo import StereoRig

_MAX_PIXELS = 16_777_216
"""Of a simulated image: rays and ranges of all of them are in memory."""


class CameraTable(Table):
    """[camera]: a pinhole depth camera at the chaser's mass centre, fixed in the Hill frame."""

    width_px: Pixels = 256
    height_px: Pixels = 256
    horizontal_fov_deg: Annotated[float, Field(gt=0.0, lt=170.0)] = 25.0
    boresight_hill: Direction = (1.0, 0.0, 0.0)
    """Direction the camera looks along, Hill axes; image down is nadir where that is possible."""
    pixel_aspect: Positive = 1.0
    """Vertical over horizontal focal length, in pixels: not 1 where pixels are not square."""
    distortion_model: DistortionModel = DistortionModel.OPENCV
    distortion: tuple[float, ...] = ()
    """k1, k2, p1, p2(, k3(, k4, k5, k6)), or k1 to k4 of "fisheye". The field of view is that of
    the focal length."""
    position_sd_m: NonNegative = 0.0
    """Standard deviation of each component of the camera's recorded position, white from frame to
    frame."""
    attitude_sd_deg: NonNegative = 0.0
    """Standard deviation of its recorded attitude about each of its axes, likewise."""
    row_readout_s: NonNegative = 0.0
    """Time from the exposure of the first row to that of the last; the time of a frame is that of
    its middle row."""

    @model_validator(mode="after")
    def _image_fits_into_memory(self) -> Self:
        if self.width_px * self.height_px > _MAX_PIXELS:
            raise ValueError(f"expected at most {_MAX_PIXELS:,} pixels, width by height")
        return self

    @property
    def pinhole(self) -> PinholeCamera:
        """Its intrinsics."""
        fov_rad = float(np.deg2rad(self.horizontal_fov_deg))
        camera = PinholeCamera.from_field_of_view(self.width_px, self.height_px, fov_rad)
        lens = Distortion(self.distortion_model, self.distortion) if any(self.distortion) else None
        return replace(camera, fy=camera.fy * self.pixel_aspect, distortion=lens)

    @model_validator(mode="after")
    def _coefficients_fit_the_model(self) -> Self:
        counts = COEFFICIENTS[self.distortion_model]
        if self.distortion and len(self.distortion) not in counts:
            expected = " or ".join(map(str, counts))
            raise ValueError(f"distortion: expected {expected} numbers, got {len(self.distortion)}")
        return self

    @property
    def R_cam_hill(self) -> FloatArray:
        """(3, 3) attitude, OpenCV axes."""
        return R_cam_hill(np.array(self.boresight_hill))


class Footprint(StrEnum):
    """What of a pixel's area must be covered by surfaces for it to return."""

    CENTRE_RAY = "centre_ray"
    """Its centre: one ray, the pixel has no area."""
    ANY = "any"
    QUARTER = "quarter"
    HALF = "half"

    @property
    def threshold(self) -> float:
        """Smallest covered share."""
        return {Footprint.QUARTER: 0.25, Footprint.HALF: 0.5}.get(self, 0.0)


class NoiseTable(Table):
    """[noise]: the faults of the simulated depth sensor.

    The standard deviation along the ray at a range r is
    ``range_sigma_m + range_sigma_per_m r + range_sigma_per_m2 r^2``.
    """

    range_sigma_m: NonNegative = 0.02
    """Standard deviation of Gaussian noise along the ray, its part that does not grow."""
    range_sigma_per_m: NonNegative = 0.0
    """Its growth per metre of range."""
    range_sigma_per_m2: NonNegative = 0.0
    """Its growth per square metre of range."""
    stated_range_sigma_m: Positive | None = None
    """What the recording states; None states the true one, where it grows that of the first
    frame's distance."""
    states_range_sigma: bool = True
    """Whether it states any."""
    quantisation_m: Positive = 0.001
    """Step of the stored z-depth (one unit of the 16-bit image)."""
    max_range_m: Positive | None = None
    """Beyond it nothing returns; None for what 16 bits hold."""
    dropout_fraction: Fraction = 0.0
    """Share of returns lost at random."""
    outlier_fraction: Fraction = 0.0
    """Share of the target's returns replaced by a uniform draw over the depth span of the
    target."""
    mixed_pixel_fraction: Fraction = 0.0
    """Share of the pixels on a depth edge that return a range between the two surfaces."""
    false_return_fraction: Fraction = 0.0
    """Share of all pixels, empty sky included, that return a range of nothing that is there."""
    false_return_span_m: Annotated[tuple[NonNegative, Positive], Strict(False)] | None = None
    """Between which ranges false returns are uniform; None takes half to one and a half times the
    target's distance in the first frame."""
    frame_offset_sd_m: NonNegative = 0.0
    """Standard deviation of a range offset common to a frame."""
    frame_offset_correlation_s: NonNegative = 0.0
    """Time over which it varies; 0 draws it anew for every frame."""
    face_offset_sd_m: NonNegative = 0.0
    """Standard deviation of a range offset common to a flat face of the target."""
    face_tilt_sd_deg: NonNegative = 0.0
    """Standard deviation of the angle by which a face's ranges are tilted, about each image
    axis."""
    face_correlation_s: NonNegative = 0.0
    """Time over which offset and tilt of a face vary; 0 draws them anew for every frame."""
    hole_incidence_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 90.0
    """Between ray and normal, beyond which a surface does not return."""
    dark_fraction: Fraction = 0.0
    """Share of the target's surface that does not return, in patches fixed to it."""
    dark_patch_m: Positive = 0.1
    """Size of these patches."""
    multipath_fraction: Fraction = 0.0
    """Share of the light on a point that others of the target's surfaces throw on it, where they
    fill all it sees: lengthens ranges in concave corners."""
    footprint: Footprint = Footprint.CENTRE_RAY
    """How much of a pixel must be covered; its range is the mean over the nearest surface."""
    footprint_rays: Annotated[int, Field(ge=2, le=16)] = 5
    """Along each side of a pixel that has an edge in it."""
    footprint_mixes: bool = False
    """Whether the range is the mean over all surfaces in the pixel."""
    stamp_jitter_s: NonNegative = 0.0
    """Standard deviation of the recorded time from the true one; cut off where frames would change
    their order."""
    stamp_step_s: NonNegative = 0.0
    """Step that recorded times are rounded to."""

    def sigma_at(self, range_m: FloatArray | float) -> FloatArray:
        """Standard deviation along the ray, m, at ranges (...)."""
        growth = self.range_sigma_per_m * range_m + self.range_sigma_per_m2 * np.square(range_m)
        return np.asarray(self.range_sigma_m + growth)

    @model_validator(mode="after")
    def _span_has_a_length(self) -> Self:
        span = self.false_return_span_m
        if span is not None and not span[0] < span[1]:
            raise ValueError("false_return_span_m: expected the smaller range first")
        return self


class MiscalibrationTable(Table):
    """[miscalibration]: by how much the simulated camera and the target differ from what is said of
    them; one draw a recording of each."""

    focal_sd: NonNegative = 0.0
    """Standard deviation of the focal length, over itself."""
    centre_sd_px: NonNegative = 0.0
    """Of each coordinate of the principal point."""
    range_offset_sd_m: NonNegative = 0.0
    """Of an offset that all ranges share."""
    range_scale_sd: NonNegative = 0.0
    """Of the scale of all ranges."""
    mesh_scale_sd: NonNegative = 0.0
    """Of the target's size, over that of its mesh."""
    is_stated: bool = True
    """Whether the recording states these deviations, and that of the time stamps."""


class Boresight(StrEnum):
    """Where a stereo rig looks."""

    TARGET = "target"
    """At the target."""
    HILL = "hill"
    """Along the boresight, fixed in the Hill frame."""


class StereoTable(Table):
    """[stereo]: a stereo rig whose left camera sits at the chaser's mass centre."""

    baseline_m: Positive = 1.0
    focal_px: Positive = 1000.0
    width_px: Pixels = 1024
    height_px: Pixels = 1024
    pixel_sigma_px: Positive = 0.1
    """Standard deviation of each measured coordinate."""
    pointing: Boresight = Boresight.TARGET
    boresight_hill: Direction = (1.0, 0.0, 0.0)
    """Direction the rig looks along when it is fixed in the Hill frame; image down is nadir where
    that is possible."""
    pointing_error_deg: NonNegative = 0.3
    """Standard deviation of a constant offset about each axis of a rig that looks at the target:
    it holds the target in view, it does not know where the mass centre is."""

    @property
    def rig(self) -> StereoRig:
        """Its geometry; the optical axis goes through the middle of the image."""
        return StereoRig(
            baseline_m=self.baseline_m,
            focal_px=self.focal_px,
            centre_px=(0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1)),
            size_px=(self.width_px, self.height_px),
            pixel_sigma_px=self.pixel_sigma_px,
        )


class FeaturesTable(Table):
    """[features]: simulated points of the target and how their tracks behave."""

    count: Many = 10
    """Points drawn at random when none are listed."""
    half_extent_m: Positive = 1.5
    """The points drawn are uniform in a cube of this half side about the mass centre."""
    points_m: tuple[Vector3, ...] = ()
    """Body axes, from the mass centre; replaces the points drawn."""
    normals_body: tuple[Vector3, ...] = ()
    """Outward surface normals of the points listed; without any, a point's own direction."""
    hidden_by_normals: bool = False
    """Whether a point is seen only while its normal faces the rig."""
    max_view_angle_deg: Annotated[float, Field(gt=0.0, le=90.0)] = 90.0
    """Between the normal and the direction to the rig, beyond which a point is hidden."""
    blackouts_s: tuple[tuple[float, float], ...] = ()
    """Spans of time, end excluded, in which nothing is seen."""
    mean_tracked_s: Positive | None = None
    """Mean time until a single track is lost; None for never."""
    mean_lost_s: Positive = 5.0
    """Mean time until a lost track is found again."""
    wrong_match_fraction: Fraction = 0.0
    """Share of observations that are those of another feature or of a random place."""
    acceleration_psd_m2_s3: NonNegative = 0.0
    """Power spectral density of a white disturbance acceleration of the true target."""
    angular_acceleration_psd_rad2_s3: NonNegative = 0.0
    """Power spectral density of a white disturbance angular acceleration of the true target."""

    def is_lit(self, times_s: FloatArray) -> BoolArray:
        """(n,) whether times lie outside all blackouts."""
        lit = np.ones(len(times_s), dtype=np.bool_)
        for start, end in self.blackouts_s:
            lit &= (times_s < start) | (times_s >= end)
        return lit

    @model_validator(mode="after")
    def _spans_and_normals_fit(self) -> Self:
        if any(end <= start for start, end in self.blackouts_s):
            raise ValueError("blackouts_s: expected spans [start, end] with end after start")
        if self.normals_body and len(self.normals_body) != len(self.points_m):
            raise ValueError("normals_body: expected one for every one of points_m")
        if any(x == y == z == 0.0 for x, y, z in self.normals_body):
            raise ValueError("normals_body: expected directions, got 0, 0, 0")
        return self


class ImageCameraTable(Table):
    """[image_camera]: a simulated camera at the chaser's mass centre.

    It is fixed in the Hill frame and looks along ``boresight_hill`` of [camera]. The defaults are
    the paper's.
    """

    images: bool = False
    """Whether shaded images of the target's mesh are simulated; otherwise the tracks alone."""

    width_px: Pixels = 2048
    height_px: Pixels = 2048
    focal_px: Positive = 2909.0
    centre_px: tuple[float, float] | None = None
    """Principal point; None takes the middle of the image."""
    pixel_sigma_px: NonNegative = 0.1
    """Noise of each coordinate of simulated tracks."""

    @property
    def pinhole(self) -> PinholeCamera:
        """Its intrinsics."""
        middle = (0.5 * (self.width_px - 1), 0.5 * (self.height_px - 1))
        focal, centre = self.focal_px, self.centre_px or middle
        return PinholeCamera(self.width_px, self.height_px, focal, focal, *centre)


class ShadingTable(Table):
    """[shading]: how simulated images look."""

    sun_hill: Direction = (-0.8, 0.3, -0.5)
    """Direction to the sun, Hill axes at time 0; it stays where it is among the stars."""
    ambient: Fraction = 0.15
    """Light from everywhere, as a share of the sun's."""
    texture_cell_m: Positive = 0.12
    """Size of the blobs of the texture, which is fixed to the target."""
    texture_contrast: Fraction = 0.8
    noise_levels: NonNegative = 1.0
    """Standard deviation of the sensor noise, grey levels of 255."""
    supersampling: Annotated[int, Field(ge=1, le=4)] = 2
    """Rays per pixel and axis."""
