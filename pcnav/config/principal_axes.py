"""Settings of the estimator in principal axes, on stereo tracks (Hu 2024)."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import Count, NonNegative, Positive, Probability, Table


class FeatureMeasurements(StrEnum):
    """What the filter of the principal axes takes from a frame."""

    PIXELS = "pixels"
    """The pixels of every feature, once."""
    PRINTED = "attitude_and_points"
    """Triangulated points and the attitude made of them, as if independent (Hu 2024 (33))."""


class Identification(StrEnum):
    """How the inertia is found that the principal axes start from."""

    ARC = "arc"
    """Torque-free rotation fitted to the attitudes of an arc."""
    ERRORS_IN_VARIABLES = "errors_in_variables"
    """Conservation of momentum, with the noise of the differentiated rates."""
    PRINTED = "least_squares"
    """Conservation of momentum by plain least squares (Hu 2024 (13)), biased by that noise."""


class PrincipalAxesTable(Table):
    """[principal_axes]: settings of `pcnav.estimators.principal_axes.estimator` (Hu 2024).

    The paper's process noise is 2e-6 m^2/s^3 and 2.5e-5 rad^2/s^3, for which 20 s without features
    cost 15 degrees of attitude; the values here are those of a body left to itself.
    """

    unique_frame: bool = True
    """Whether axes are ordered by their moments and signed (17), once and for all; otherwise they
    are taken as the eigen-decomposition comes, anew whenever features re-appear."""
    measurements: FeatureMeasurements = FeatureMeasurements.PIXELS
    identification: Identification = Identification.ARC
    arc_s: Positive = 10.0
    """Time that features are watched for before the first try to start."""
    max_arc_s: Positive = 40.0
    """By then the filter starts even where the principal axes are not determined."""
    acceleration_psd_m2_s3: NonNegative = 1e-10
    angular_acceleration_psd_rad2_s3: NonNegative = 1e-10
    """About the axis of the largest moment; the others by their moments (22)."""
    gate_probability: Probability = 0.9999
    """A true observation of a point passes the gate with this probability."""
    max_iterations: Count = 5
    """Of the iterated update by printed measurements; pixels are smoothed over a gap."""
    max_features: Annotated[int, Field(ge=3)] = 30
    """Points in the state; the one not seen for longest makes room."""
    max_rejections: Count = 5
    """So often rejected in a row, a point is begun anew; with all of them, the target is lost."""

    @model_validator(mode="after")
    def _arcs_are_in_order(self) -> Self:
        if self.max_arc_s < self.arc_s:
            raise ValueError(f"max_arc_s: expected arc_s = {self.arc_s:g} or more")
        return self
