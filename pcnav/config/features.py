"""Tables of the pipeline file for targets without a model: stereo rig, features, estimators."""

from enum import StrEnum
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from pcnav.config.table import Fraction, NonNegative, Positive, Table, Vector3
from pcnav.core.arrays import FloatArray

Vector4 = tuple[float, float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


class EstimatorKind(StrEnum):
    """What a run estimates with."""

    DEPTH = "depth"
    """Rectangles of a target with a model, from depth frames."""
    PRINCIPAL_AXES = "principal_axes"
    """Feature tracks in the unique frame of principal axes (Hu 2024)."""
    INERTIA_BANK = "inertia_bank"
    """Feature tracks under several hypotheses of the inertia (Segal 2011)."""
    IMAGE_MOTION = "image_motion"
    """Images of one camera, or feature tracks of them (Appl. Sci. 2022)."""
    ATTITUDE_INERTIA = "attitude_inertia"
    """Attitudes alone, recorded or from images of one camera (Deng 2024)."""


class EstimatorTable(Table):
    """[estimator]: which estimator a run uses; its settings are in the table of its own name."""

    kind: EstimatorKind = EstimatorKind.DEPTH


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
    width_px: Annotated[int, Field(gt=0)] = 1024
    height_px: Annotated[int, Field(gt=0)] = 1024
    pixel_sigma_px: Positive = 0.1
    """Standard deviation of each measured coordinate."""
    pointing: Boresight = Boresight.TARGET
    boresight_hill: Vector3 = (1.0, 0.0, 0.0)
    """Direction the rig looks along when it is fixed in the Hill frame; image down is nadir where
    that is possible."""
    pointing_error_deg: NonNegative = 0.3
    """Standard deviation of a constant offset about each axis of a rig that looks at the target:
    it holds the target in view, it does not know where the mass centre is."""


class FeaturesTable(Table):
    """[features]: simulated points of the target and how their tracks behave."""

    count: Annotated[int, Field(ge=1)] = 10
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

    @model_validator(mode="after")
    def _spans_and_normals_fit(self) -> Self:
        if any(end <= start for start, end in self.blackouts_s):
            raise ValueError("blackouts_s: expected spans [start, end] with end after start")
        if self.normals_body and len(self.normals_body) != len(self.points_m):
            raise ValueError("normals_body: expected one for every one of points_m")
        if any(x == y == z == 0.0 for x, y, z in self.normals_body):
            raise ValueError("normals_body: expected directions, got 0, 0, 0")
        return self


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
    gate_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9999
    """A true observation of a point passes the gate with this probability."""
    max_iterations: Annotated[int, Field(ge=1)] = 5
    """Of the iterated update."""
    max_features: Annotated[int, Field(ge=3)] = 30
    """Points in the state; the one not seen for longest makes room."""
    max_rejections: Annotated[int, Field(ge=1)] = 5
    """So often rejected in a row, a point is begun anew; with all of them, the target is lost."""

    @model_validator(mode="after")
    def _arcs_are_in_order(self) -> Self:
        if self.max_arc_s < self.arc_s:
            raise ValueError(f"max_arc_s: expected arc_s = {self.arc_s:g} or more")
        return self


class Likelihood(StrEnum):
    """How a bank of filters weighs innovations."""

    INNOVATION = "innovation"
    """Against their own covariance."""
    PRINTED = "printed"
    """Against the measurement noise alone (Segal 2011 (12))."""


class BankEstimate(StrEnum):
    """What a bank of filters reports."""

    MAP = "map"
    """The most probable filter (Segal 2011 (13))."""
    WEIGHTED = "weighted"
    """The mean of all, by their probabilities, with a covariance that holds their spread."""


_COARSE_BANK = (
    (1.0, 1.0, 1.0, 0.0, 0.0, 0.0),
    (0.5, 1.0, 1.0, 0.0, 0.0, 0.0),
    (1.0, 0.5, 1.0, 0.0, 0.0, 0.0),
    (1.0, 1.0, 0.5, 0.0, 0.0, 0.0),
    (1.6, 1.0, 1.0, 0.0, 0.0, 0.0),
    (1.0, 1.6, 1.0, 0.0, 0.0, 0.0),
    (1.0, 1.0, 1.6, 0.0, 0.0, 0.0),
)
"""A ball, three rods and three plates along the body axes."""


class InertiaBankTable(Table):
    """[inertia_bank]: settings of `pcnav.estimators.inertia_bank.estimator` (Segal 2011).

    The paper prints neither initial uncertainty nor process noise: the values here are pcnav's.
    """

    hypotheses: tuple[Vector6, ...] = _COARSE_BANK
    """Inertia matrices Ixx, Iyy, Izz, Ixy, Ixz, Iyz (entries of the matrix) of any scale, in the
    body axes that the initial attitude speaks of."""
    prior: tuple[Positive, ...] = ()
    """Weight of every hypothesis before the first frame; equal when none are given."""
    allow_unphysical: bool = False
    """Whether hypotheses may violate the triangle inequality of the principal moments, as most of
    those do that the paper draws."""
    likelihood: Likelihood = Likelihood.INNOVATION
    estimate: BankEstimate = BankEstimate.MAP
    kinematic_coupling: bool = True
    """Whether errors of points and rate are carried in Hill axes by (25); see
    `pcnav.estimators.inertia_bank.relative_state`."""
    attitude_xyzw: Vector4 = (0.0, 0.0, 0.0, 1.0)
    """R_hill_body at the first frame: which way the axes of the hypotheses lie."""
    attitude_sd_deg: Positive = 5.0
    mass_centre_sd_m: Positive = 1.0
    """Of the mass centre about the median of the points of the first frame, per axis."""
    velocity_m_s: Vector3 = (0.0, 0.0, 0.0)
    """Of the mass centre at the first frame, Hill axes."""
    velocity_sd_m_s: Positive = 0.1
    rate_deg_s: Vector3 = (0.0, 0.0, 0.0)
    """Inertial rate at the first frame, body axes."""
    rate_sd_deg_s: Positive = 0.5
    acceleration_psd_m2_s3: NonNegative = 1e-12
    angular_acceleration_psd_rad2_s3: NonNegative = 1e-14
    gate_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9999
    """A true observation of a point passes the gate with this probability."""
    max_iterations: Annotated[int, Field(ge=1)] = 5
    """Of the iterated update."""
    max_features: Annotated[int, Field(ge=3)] = 40
    """Points in the state; the one not seen for longest makes room."""
    max_rejections: Annotated[int, Field(ge=1)] = 5
    """So often rejected in a row, a point is begun anew; with all of them, the target is lost."""

    @model_validator(mode="after")
    def _bank_is_possible(self) -> Self:
        if not self.hypotheses:
            raise ValueError("hypotheses: expected at least one")
        if self.prior and len(self.prior) != len(self.hypotheses):
            raise ValueError("prior: expected one for every one of hypotheses")
        if not any(self.attitude_xyzw):
            raise ValueError("attitude_xyzw: expected a quaternion, got 0, 0, 0, 0")
        for values in self.hypotheses:
            moments = np.linalg.eigvalsh(inertia_matrix(values))
            if not moments[0] > 0.0:
                raise ValueError(f"hypotheses: {values} has no positive principal moments")
            if moments[0] + moments[1] < moments[2] and not self.allow_unphysical:
                raise ValueError(
                    f"hypotheses: {values} is no body's inertia (its largest principal moment "
                    "exceeds the sum of the others); allow_unphysical takes it"
                )
        return self


def inertia_matrix(values: Vector6) -> FloatArray:
    """(3, 3) of Ixx, Iyy, Izz, Ixy, Ixz, Iyz."""
    xx, yy, zz, xy, xz, yz = values
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
