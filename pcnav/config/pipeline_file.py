"""The typed pipeline file: one frozen model per TOML table, the unit in every field name.

A pipeline file describes a scenario to simulate, how to perceive and how to filter. Every table
has defaults, so a file says only what differs; an unknown key or a value out of range raises
`InputError` naming the file and the key.
"""

import tomllib
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Self, TypeVar

from pydantic import BaseModel, Field, ValidationError, model_validator

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.features import (
    EstimatorTable,
    FeaturesTable,
    InertiaBankTable,
    PrincipalAxesTable,
    StereoTable,
)
from pcnav.config.images import (
    FeatureTrackerTable,
    ImageCameraTable,
    ImageMotionTable,
    ShadingTable,
)
from pcnav.config.table import Fraction, NonNegative, Positive, Table, Vector3, Vector5
from pcnav.core.errors import InputError

Model = TypeVar("Model", bound=BaseModel)


class OrbitModel(StrEnum):
    """How the true relative orbit is integrated."""

    HILL = "hill"
    TWO_BODY = "two_body"
    """Two point masses, the chaser on a circle."""
    KEPLER = "kepler"
    """Two point masses, the chaser on an ellipse; feature tracks only."""


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


class ScenarioTable(Table):
    """[scenario]: what is simulated and for how long."""

    frames: Annotated[int, Field(gt=0)] = 200
    frame_rate_hz: Positive = 2.0


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
    com_model_m: Vector3 = (0.0, 0.0, 0.0)
    inertia_ratios: Vector5 = (1.0, 1.0, 0.0, 0.0, 0.0)
    """Iyy, Izz, Ixy, Ixz, Iyz over Ixx."""


class CameraTable(Table):
    """[camera]: a pinhole depth camera at the chaser's mass centre, fixed in the Hill frame."""

    width_px: Annotated[int, Field(gt=0)] = 256
    height_px: Annotated[int, Field(gt=0)] = 256
    horizontal_fov_deg: Annotated[float, Field(gt=0.0, lt=170.0)] = 25.0
    boresight_hill: Vector3 = (1.0, 0.0, 0.0)
    """Direction the camera looks along, Hill axes; image down is nadir where that is possible."""


class NoiseTable(Table):
    """[noise]: the faults of the simulated depth sensor."""

    range_sigma_m: NonNegative = 0.02
    """Standard deviation of Gaussian noise along the ray."""
    quantisation_m: Positive = 0.001
    """Step of the stored z-depth (one unit of the 16-bit image)."""
    dropout_fraction: Fraction = 0.0
    """Share of returns lost at random."""
    outlier_fraction: Fraction = 0.0
    """Share of returns replaced by a uniform draw over the depth span of the target."""
    mixed_pixel_fraction: Fraction = 0.0
    """Share of the pixels on a depth edge that return a range between the two surfaces."""


class PerceptionTable(Table):
    """[perception]: from a depth frame to recognised rectangles."""

    mode: PerceptionMode = PerceptionMode.AREA_WEIGHTED
    measurements: Measurements | None = None
    """None takes `refined`, and in paper mode, which has nothing else, `rectangles`."""
    range_sigma_m: Positive | None = None
    """Noise along the ray; None takes the value the sequence states."""
    ransac_success_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.999
    """Phi of Yu 2019 (2)."""
    minimum_plane_points: Annotated[int, Field(ge=10)] = 40
    plane_threshold_sigma: Positive = 3.0
    """RANSAC inlier distance in standard deviations of the range noise."""
    size_gate_sigma: Positive = 4.0
    """Recognition gate on sides and area, in standard deviations of their difference."""

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


class FilterTable(Table):
    """[filter]: priors and process noise of the 20-state filter."""

    acceleration_psd_m2_s3: NonNegative = 1e-14
    """Power spectral density of the white disturbance acceleration."""
    angular_acceleration_psd_rad2_s3: NonNegative = 1e-16
    """Power spectral density of the white disturbance angular acceleration."""
    com_sd_m: Positive | None = None
    """Prior of the mass centre about the mesh's; None takes the target's own uncertainty."""
    inertia_ratio_sd: Positive | None = None
    """Prior of the inertia ratios about the mesh's; None takes the target's own uncertainty."""
    gate_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9999
    """A measurement is rejected when its squared innovation exceeds this chi-square quantile."""
    iterations: Annotated[int, Field(ge=1)] = 5
    """Most Gauss-Newton steps of an iterated update; 1 is the plain EKF."""


class Pipeline(Table):
    """A whole pipeline file."""

    seed: Annotated[int, Field(ge=0)] = 0
    target_mesh: str | None = None
    """Mesh of the target: a path relative to the pipeline file, or the name of a shipped one."""
    sequence: str | None = None
    """Folder the run was made from, written by `pcnav run`, ignored otherwise."""
    scenario: ScenarioTable = ScenarioTable()
    orbit: OrbitTable = OrbitTable()
    body: BodyTable = BodyTable()
    camera: CameraTable = CameraTable()
    noise: NoiseTable = NoiseTable()
    perception: PerceptionTable = PerceptionTable()
    filter: FilterTable = FilterTable()
    estimator: EstimatorTable = EstimatorTable()
    stereo: StereoTable = StereoTable()
    features: FeaturesTable = FeaturesTable()
    principal_axes: PrincipalAxesTable = PrincipalAxesTable()
    inertia_bank: InertiaBankTable = InertiaBankTable()
    image_motion: ImageMotionTable = ImageMotionTable()
    image_camera: ImageCameraTable = ImageCameraTable()
    feature_tracker: FeatureTrackerTable = FeatureTrackerTable()
    shading: ShadingTable = ShadingTable()
    attitude_inertia: AttitudeInertiaTable = AttitudeInertiaTable()


_TABLES_OF_A_GRID = ("batch", "base", "grid")


def read_pipeline(path: Path) -> Pipeline:
    """Read and check a pipeline file. Raises `InputError`."""
    try:
        return read_toml_model(path, Pipeline)
    except InputError as error:
        if error.field not in _TABLES_OF_A_GRID:
            raise
        expected = "expected a pipeline; this is a grid of cases, which is for `pcnav table`"
        raise InputError(path, error.field, expected) from error


def read_toml_model(path: Path, model: type[Model]) -> Model:
    """A TOML file checked against a pydantic model. Raises `InputError` in one line."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            path, "file", f"expected a readable TOML file ({error.strerror})"
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"expected valid TOML ({error})") from error
    try:
        return model.model_validate(table)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "file"
        if first["type"] == "extra_forbidden":
            raise InputError(
                path, field, "unknown key; expected one of the documented keys"
            ) from error
        if first["type"] == "missing":
            raise InputError(path, field, "missing; expected a value") from error
        raise InputError(path, field, f"{first['msg']}, got {first.get('input')!r}") from error
