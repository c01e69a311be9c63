"""Table of the pipeline file for the filter on attitudes alone (Deng 2024)."""

from enum import StrEnum
from typing import Self

import numpy as np
from pydantic import model_validator

from pcnav.config.table import Count, NonNegative, Positive, Probability, Table, Vector3, Vector5
from pcnav.dynamics.rigid_body import is_physical_inertia


class Propagation(StrEnum):
    """How the filter moves its state between attitudes."""

    INTEGRATED = "integrated"
    """Fourth order, in steps that keep the turn of each small."""
    EULER = "euler"
    """A single Euler step, and ``1 + C dT`` for the transition, as printed (Deng 2024 (34))."""


class AttitudeInertiaTable(Table):
    """[attitude_inertia]: settings of `pcnav.estimators.attitude_inertia.estimator` (Deng 2024).

    The paper prints process and measurement noise (0.001 of an identity each) without unit or step;
    the values here are pcnav's.
    """

    propagation: Propagation = Propagation.INTEGRATED
    rate_deg_s: Vector3 = (0.0, 0.0, 0.0)
    """Angular rate at the first attitude, body axes."""
    rate_sd_deg_s: Positive = 5.0
    inertia_ratios_zz: Vector5 = (1.0, 1.0, 0.0, 0.0, 0.0)
    """Jxx, Jyy, Jxy, Jxz, Jyz over Jzz, entries of the inertia matrix (Deng 2024 (15))."""
    inertia_ratio_sd: Positive = 0.3
    angular_acceleration_psd_rad2_s3: NonNegative = 1e-14
    """Power spectral density of a white disturbance angular acceleration."""
    attitude_sd_deg: Positive = 0.5
    """About each axis, of attitudes that come without a covariance."""
    gate_probability: Probability = 0.9999
    """A true attitude passes the gate with this probability."""
    max_iterations: Count = 5
    """Of the iterated update; 1 is the plain EKF of the paper."""

    @model_validator(mode="after")
    def _ratios_are_those_of_a_body(self) -> Self:
        xx, yy, xy, xz, yz = self.inertia_ratios_zz
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, 1.0]])
        if not is_physical_inertia(inertia):
            raise ValueError(
                "inertia_ratios_zz: expected those of a body, whose principal moments are positive "
                "and none larger than the other two together"
            )
        return self
