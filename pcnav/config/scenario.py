"""Tables of the pipeline file for what moves: the scenario, the orbits, the target's body."""

from enum import StrEnum
from typing import Annotated, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from pcnav.config.table import NonNegative, Positive, Table, Vector3, Vector5
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia


def _of_a_body(ratios: Vector5) -> Vector5:
    if not is_physical_inertia(inertia_from_ratios(np.array(ratios))):
        raise ValueError(
            "expected ratios of a physical inertia matrix: positive principal moments, none larger "
            "than the other two together"
        )
    return ratios


InertiaRatios = Annotated[Vector5, AfterValidator(_of_a_body)]
"""Iyy, Izz, Ixy, Ixz, Iyz over Ixx."""


class RecordingKind(StrEnum):
    """What a recording is made of."""

    DEPTH = "depth"
    STEREO_TRACKS = "stereo_tracks"
    IMAGES = "images"
    """Images of one camera, or tracks of points in them."""
    ATTITUDES = "attitudes"


class OrbitModel(StrEnum):
    """How the true relative orbit is integrated."""

    HILL = "hill"
    TWO_BODY = "two_body"
    """Two point masses, the chaser on a circle."""
    KEPLER = "kepler"
    """Two point masses, the chaser on an ellipse; feature tracks only."""


class ScenarioTable(Table):
    """[scenario]: what is simulated and for how long."""

    # Bounded, since memory is allocated by it.
    frames: Annotated[int, Field(gt=0, le=200_000)] = 200
    frame_rate_hz: Positive = 2.0
    recording: RecordingKind | None = None
    """What is simulated; None takes what the estimator of the pipeline lives on."""
    states_first_pose: bool = False
    """Whether simulated depth frames come with the pose of the first, off by a draw."""
    first_pose_position_sd_m: Positive | None = None
    """Deviation of each component of its position; None takes 2 % of the distance."""
    first_pose_attitude_sd_deg: Positive = 5.0
    """Deviation of its attitude about each axis."""


class OrbitTable(Table):
    """[orbit]: the chaser's orbit and the relative orbit of the target at time 0."""

    model: OrbitModel = OrbitModel.HILL
    mean_motion_rad_s: NonNegative = 0.0
    eccentricity: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    """Of the chaser's ellipse, with model = "kepler"; the other models are circles."""
    true_anomaly_deg: float = 0.0
    """Of the chaser at time 0."""
    r_hill_m: Vector3 = (25.0, 0.0, 0.0)
    v_hill_m_s: Vector3 = (0.0, 0.0, 0.0)

    @property
    def kepler(self) -> KeplerOrbit:
        """The chaser's orbit."""
        anomaly = float(np.deg2rad(self.true_anomaly_deg))
        return KeplerOrbit(self.mean_motion_rad_s, self.eccentricity, anomaly)

    @model_validator(mode="after")
    def _ellipses_are_kepler(self) -> Self:
        if self.eccentricity > 0.0 and self.model is not OrbitModel.KEPLER:
            raise ValueError(
                f'eccentricity = {self.eccentricity:g} needs model = "kepler", '
                f'"{self.model}" is a circle'
            )
        return self


class BodyTable(Table):
    """[body]: the true rotation and mass properties of the target."""

    attitude_rotvec_deg: Vector3 = (0.0, 0.0, 0.0)
    """Rotation vector of R_world_body at time 0."""
    omega_body_deg_s: Vector3 = (0.0, 0.0, 1.0)
    com_model_m: Vector3 | None = None
    """Mass centre; None takes the nominal one of the mesh, or the origin where there is none."""
    inertia_ratios: InertiaRatios | None = None
    """Iyy, Izz, Ixy, Ixz, Iyz over Ixx; None takes the nominal ones of the mesh, or a ball's."""

    @property
    def com_model(self) -> FloatArray:
        """(3,) m."""
        return np.array(self.com_model_m or (0.0, 0.0, 0.0))

    @property
    def ratios(self) -> FloatArray:
        """(5,) of the inertia."""
        return np.array(self.inertia_ratios or (1.0, 1.0, 0.0, 0.0, 0.0))
