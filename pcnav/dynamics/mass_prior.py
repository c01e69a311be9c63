"""The prior of a target's mass, before the first frame."""

from dataclasses import dataclass

from pcnav.core.arrays import FloatArray


@dataclass(frozen=True)
class PriorMass:
    """Covariances of the mass centre and of the inertia ratios that a filter was started with."""

    com_covariance_m2: FloatArray
    """(3, 3) of the mass centre in the model frame, m^2."""
    ratio_covariance: FloatArray
    """(5, 5) of Iyy, Izz, Ixy, Ixz, Iyz over Ixx."""
