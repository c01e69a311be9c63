"""Settings of the estimator on depth frames: from a frame to evidence, and the filter."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import Count, NonNegative, Positive, Probability, Table


class PerceptionMode(StrEnum):
    """Which statistics the rectangles are recognised from."""

    PAPER = "paper"
    AREA_WEIGHTED = "area_weighted"


class Measurements(StrEnum):
    """What a frame is measured by once a pose is predicted."""

    RECTANGLES = "rectangles"
    """Poses of recognised rectangles, from the moments of segmented planes."""
    REFINED = "refined"
    """The frame against the view rendered at the prediction, pixel by pixel."""
    BOTH = "both"
    """As refined; and every frame is searched for rectangles, as a check on the track."""


class ModalityName(StrEnum):
    """What a frame is compared with the rendered view by."""

    RANGES = "ranges"
    """How faces are displaced along the line of sight, and tilted."""
    OUTLINE = "outline"
    """How they are displaced across."""


MODALITIES_BY_DEFAULT = (ModalityName.RANGES, ModalityName.OUTLINE)


class PerceptionTable(Table):
    """[perception]: from a depth frame to recognised rectangles."""

    mode: PerceptionMode = PerceptionMode.AREA_WEIGHTED
    measurements: Measurements | None = None
    """None takes `refined`, and in paper mode, which has nothing else, `rectangles`."""
    modalities: Annotated[tuple[ModalityName, ...], Field(min_length=1)] = MODALITIES_BY_DEFAULT
    """Of the comparison with the rendered view, see `pcnav.perception.render_compare`."""
    range_sigma_m: Positive | None = None
    """Noise along the ray; None takes the value the sequence states."""
    mesh_scale_sd: Annotated[float, Field(ge=0.0, le=0.1)] = 0.01
    """By which share the target may be larger or smaller than its mesh, one standard deviation:
    where the frames show that it is, it is followed at the size that they show. 0 takes the mesh's
    for right."""
    ransac_success_probability: Probability = 0.999
    """Phi of Yu 2019 (2)."""
    minimum_plane_points: Annotated[int, Field(ge=10)] = 40
    plane_threshold_sigma: Positive = 3.0
    """RANSAC inlier distance in standard deviations of the range noise."""
    size_gate_sigma: Positive = 4.0
    """Recognition gate on sides and area, in standard deviations of their difference."""

    @model_validator(mode="after")
    def _modalities_count_once(self) -> Self:
        if len(set(self.modalities)) < len(self.modalities):
            raise ValueError("modalities: expected each once")
        return self

    @model_validator(mode="after")
    def _paper_mode_measures_rectangles(self) -> Self:
        if self.mode is PerceptionMode.PAPER and self.measured_by is not Measurements.RECTANGLES:
            raise ValueError(
                'mode = "paper" has rectangles only: expected measurements absent or "rectangles"'
            )
        return self

    @property
    def measured_by(self) -> Measurements:
        """The choice in force."""
        if self.measurements is not None:
            return self.measurements
        paper = self.mode is PerceptionMode.PAPER
        return Measurements.RECTANGLES if paper else Measurements.REFINED


class MotionChoice(StrEnum):
    """How the target is taken to move."""

    AUTO = "auto"
    """As a free body while that explains the frames, in any way while it does not."""
    TORQUE_FREE = "torque_free"
    """As a free body."""
    KINEMATIC = "kinematic"
    """In any way: pose and twist, with accelerations that are learnt. No mass is estimated."""


class FilterTable(Table):
    """[filter]: motion, priors and process noise of the 20-state filter."""

    motion: MotionChoice = MotionChoice.AUTO
    acceleration_psd_m2_s3: NonNegative = 1e-14
    """Power spectral density of the white disturbance acceleration of a free body."""
    angular_acceleration_psd_rad2_s3: NonNegative = 1e-16
    """Power spectral density of the white disturbance angular acceleration of a free body."""
    com_sd_m: Positive | None = None
    """Prior of the mass centre about the mesh's; None takes the target's own uncertainty."""
    inertia_ratio_sd: Positive | None = None
    """Prior of the inertia ratios about the mesh's; None takes the target's own uncertainty."""
    gate_probability: Probability = 0.9999
    """A measurement is rejected when its squared innovation exceeds this chi-square quantile."""
    iterations: Count = 5
    """Most Gauss-Newton steps of an iterated update; 1 is the plain EKF."""
