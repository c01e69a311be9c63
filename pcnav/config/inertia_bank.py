"""Settings of the bank of filters, on stereo tracks (Segal 2011)."""

from enum import StrEnum
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from pcnav.config.table import Count, NonNegative, Positive, Probability, Table, Vector3
from pcnav.core.arrays import FloatArray

Vector4 = tuple[float, float, float, float]
Vector6 = tuple[float, float, float, float, float, float]


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
    gate_probability: Probability = 0.9999
    """A true observation of a point passes the gate with this probability."""
    max_iterations: Count = 5
    """Of the iterated update."""
    max_features: Annotated[int, Field(ge=3)] = 40
    """Points in the state; the one not seen for longest makes room."""
    max_rejections: Count = 5
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
