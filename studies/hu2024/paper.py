"""The settings that Hu 2024 prints (section 5), and those that it leaves open."""

from functools import lru_cache

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.principal_axes import PrincipalAxesTable
from pcnav.simulation.stereo import StereoScenario, stereo_scenario

from ..pipelines import shipped

NAME = "hu2024"
LEVELS_RAD = (0.1e-5, 0.5e-5, 2e-5, 5e-5)
"""Angular resolutions of Fig. 5."""
IDENTIFICATION_RUNS = 500
"""Of every level."""
LAST_S = 50.0
"""The end of a run, over which errors are told in the tables."""
ACCELERATION_PSD = 2e-6
"""m^2/s^3; printed as the covariance of the orbital disturbance, m^2/s^4."""
ANGULAR_ACCELERATION_PSD = 2.5e-5
"""rad^2/s^3, about the axis of the largest moment."""
CALM = 1e-4
"""Share of the printed disturbances at which momentum is conserved well enough for (10)."""


@lru_cache(maxsize=1)
def pipeline() -> Pipeline:
    """The shipped pipeline of the paper's scenario."""
    return shipped(NAME)


def scenario() -> StereoScenario:
    """The paper's scenario as the pipeline has it."""
    return stereo_scenario(pipeline(), NAME)


def blackouts_s() -> tuple[tuple[float, float], ...]:
    """When nothing is seen."""
    return pipeline().features.blackouts_s


def settings(share: float) -> PrincipalAxesTable:
    """The pipeline's settings with a share of the printed process noise."""
    return pipeline().principal_axes.model_copy(
        update={
            "acceleration_psd_m2_s3": share * ACCELERATION_PSD,
            "angular_acceleration_psd_rad2_s3": share * ANGULAR_ACCELERATION_PSD,
        }
    )
