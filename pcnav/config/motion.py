"""Table of the pipeline file for how the true target, or the camera, moves where it is not free."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from pcnav.config.table import NonNegative, Positive, Table, Vector3

_Band = Annotated[tuple[Positive, Positive], Strict(False)]


class MotionKind(StrEnum):
    """How the true target moves."""

    FREE = "free"
    """A free rigid body on its orbit, from the state in [orbit] and [body]."""
    IMPULSE = "impulse"
    """Free, but for a change of velocity and rate at one time."""
    TORQUE = "torque"
    """Free, but for a constant torque from one time on."""
    SPIN = "spin"
    """Turned at a constant rate about an axis fixed in the body, as on a turntable."""
    SWAY = "sway"
    """Sinusoidal in position and attitude about the start."""
    PATH = "path"
    """From one drawn pose to the next with the least jerk, as by a robot arm."""
    HAND = "hand"
    """Random accelerations in a band of frequencies, as of what a person carries."""


class Mover(StrEnum):
    """What a prescribed motion is that of."""

    TARGET = "target"
    CAMERA = "camera"
    """The camera is carried about the target, which moves freely; its poses are recorded."""


class MotionTable(Table):
    """[motion]: how the true target moves; the keys of the other kinds are not read."""

    kind: MotionKind = MotionKind.FREE
    mover: Mover = Mover.TARGET
    """Of the kinds sway, path and hand."""
    at_s: NonNegative = 10.0
    """Time of the impulse, or from which on the torque acts."""
    impulse_v_m_s: Vector3 = (0.0, 0.01, 0.01)
    """Change of velocity, Hill axes."""
    impulse_omega_deg_s: Vector3 = (1.0, -1.5, 1.0)
    """Change of rate, body axes."""
    torque_deg_s2: Vector3 = (0.05, 0.0, -0.05)
    """Angular acceleration that the torque gives a body at rest, body axes."""
    period_s: Positive = 8.0
    """Of the sway."""
    extent_m: NonNegative = 0.0
    """Amplitude of the sway; largest distance from the start, along each axis, of a path's
    poses."""
    extent_deg: Annotated[float, Field(ge=0.0, lt=180.0)] = 25.0
    """The same of the attitude."""
    leg_s: Positive = 4.0
    """Between two poses of a path."""
    acceleration_m_s2: NonNegative = 0.4
    """Standard deviation of the acceleration of what a hand carries, along each axis."""
    angular_acceleration_deg_s2: NonNegative = 40.0
    """The same of the second derivative of the rotation vector from the start."""
    band_hz: _Band = (0.2, 2.0)
    """Lowest and highest frequency of these accelerations."""

    @model_validator(mode="after")
    def _fits_itself(self) -> Self:
        low, high = self.band_hz
        if not low < high:
            raise ValueError("band_hz: expected the lower frequency first")
        if self.mover is Mover.CAMERA and not self.is_displaced:
            raise ValueError('mover = "camera": expected kind = "sway", "path" or "hand"')
        return self

    @property
    def is_displaced(self) -> bool:
        """Whether a drawn displacement is added to where target or camera would be."""
        return self.kind in (MotionKind.SWAY, MotionKind.PATH, MotionKind.HAND)
