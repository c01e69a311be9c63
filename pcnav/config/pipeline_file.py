"""The typed pipeline file: one frozen model per TOML table, the unit in every field name.

A pipeline file describes a scenario to simulate and what to estimate with. Every table has
defaults, so a file says only what differs; an unknown key or a value out of range raises
`InputError` naming the file and the key.
"""

import math
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Self, TypeVar

from pydantic import ConfigDict, Field, model_validator

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.depth import FilterTable, PerceptionTable
from pcnav.config.first_pose import FirstPoseTable
from pcnav.config.image_motion import FeatureTrackerTable, ImageMotionTable
from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.config.length_unit import LengthUnit
from pcnav.config.motion import MotionTable
from pcnav.config.principal_axes import PrincipalAxesTable
from pcnav.config.recording import RecordingTable
from pcnav.config.region import RegionTable
from pcnav.config.scan import ScanTable
from pcnav.config.scenario import BodyTable, OrbitTable, ScenarioTable
from pcnav.config.sensors import (
    CameraTable,
    FeaturesTable,
    ImageCameraTable,
    MiscalibrationTable,
    NoiseTable,
    ShadingTable,
    StereoTable,
)
from pcnav.config.surroundings import BackgroundTable, OccluderTable
from pcnav.config.table import Place, Table
from pcnav.core.errors import InputError
from pcnav.files.toml_file import checked, read_toml_model

Settings = TypeVar("Settings", bound=Table)


_MAX_TURN_RAD = 1e6
_MAX_SIGHTINGS = 50_000_000


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


SETTINGS: Mapping[str, tuple[str, ...]] = {
    EstimatorKind.DEPTH: ("perception", "filter", "region", "recording"),
    EstimatorKind.PRINCIPAL_AXES: ("principal_axes", "orbit"),
    EstimatorKind.INERTIA_BANK: ("inertia_bank", "orbit"),
    EstimatorKind.IMAGE_MOTION: ("image_motion", "feature_tracker", "attitude_inertia"),
    EstimatorKind.ATTITUDE_INERTIA: ("attitude_inertia", "image_motion", "feature_tracker"),
}
"""The tables that a run with an estimator reads, beside [estimator]. The view turns stereo tracks
without their recording by the orbit."""
_UNSAID = ("time_zero_s", "skip_bad_frames", "region", "recording")
"""What a run states only where it was asked for."""
_OF_A_RUN = (
    *(
        "seed",
        "target_mesh",
        "mesh_unit",
        "sequence",
        "written_to",
        "initial_pose",
        "time_zero_s",
        "skip_bad_frames",
    ),
    "estimator",
)


class EstimatorTable(Table):
    """[estimator]: which estimator a run uses.

    The settings of its kind are in the table of that name, or here beside the kind. An estimator
    that has no table in `Pipeline` has all of its settings here, see `settings`.
    """

    model_config = ConfigDict(extra="allow")

    kind: Annotated[EstimatorKind | str, Field(union_mode="left_to_right")] = EstimatorKind.DEPTH
    """A name in `pcnav.estimators.registry`."""

    def settings(self, table: type[Settings], source: Path | str = "pipeline") -> Settings:
        """The settings beside the kind. Raises `InputError`, which names the source."""
        return checked(source, table, self.model_extra or {}, "estimator")

    @model_validator(mode="after")
    def _known_kinds_have_their_tables(self) -> Self:
        if isinstance(self.kind, EstimatorKind) and self.model_extra:
            raise ValueError(f"unknown key {next(iter(self.model_extra))}")
        return self


class Pipeline(Table):
    """A whole pipeline file."""

    seed: Annotated[int, Field(ge=0)] = 0
    target_mesh: Place | None = None
    """Mesh of the target: a path relative to the pipeline file, or the name of a shipped one."""
    mesh_unit: LengthUnit | None = None
    """Unit of its coordinates; None takes the one that the TOML beside it states, else the one it
    declares, else metres."""
    sequence: Place | None = None
    """Folder the run was made from, as seen from that of this file; written by `pcnav run`, ignored
    otherwise."""
    written_to: Place | None = None
    """Where the result was when its run wrote this file, from which what moved is looked for."""
    initial_pose: FirstPoseTable | None = None
    """Of the target in the first depth frame; replaces the one a sequence states."""
    time_zero_s: float = 0.0
    """Time stamp of the recording that is time 0 of the run, written by `pcnav run`, ignored
    otherwise."""
    skip_bad_frames: bool = False
    """Whether depth images may be missing or damaged: the estimator coasts over them."""
    scenario: ScenarioTable = ScenarioTable()
    orbit: OrbitTable = OrbitTable()
    body: BodyTable = BodyTable()
    motion: MotionTable = MotionTable()
    camera: CameraTable = CameraTable()
    scan: ScanTable = ScanTable()
    noise: NoiseTable = NoiseTable()
    miscalibration: MiscalibrationTable = MiscalibrationTable()
    background: BackgroundTable = BackgroundTable()
    occluder: OccluderTable = OccluderTable()
    stereo: StereoTable = StereoTable()
    features: FeaturesTable = FeaturesTable()
    image_camera: ImageCameraTable = ImageCameraTable()
    shading: ShadingTable = ShadingTable()
    estimator: EstimatorTable = EstimatorTable()
    perception: PerceptionTable = PerceptionTable()
    filter: FilterTable = FilterTable()
    region: RegionTable = RegionTable()
    recording: RecordingTable = RecordingTable()
    principal_axes: PrincipalAxesTable = PrincipalAxesTable()
    inertia_bank: InertiaBankTable = InertiaBankTable()
    image_motion: ImageMotionTable = ImageMotionTable()
    feature_tracker: FeatureTrackerTable = FeatureTrackerTable()
    attitude_inertia: AttitudeInertiaTable = AttitudeInertiaTable()

    def stated(self, of_a_run: bool = False) -> dict[str, Any]:
        """Its tables, every default spelled out, as a file can state them.

        Keys whose value is None are left out: TOML has no null, and None is their default.
        ``of_a_run`` leaves out what a run does not read, and of `_UNSAID`, and of an estimator that
        is not listed here, settings that are the default.
        """
        default, read = Pipeline(), SETTINGS.get(self.estimator.kind)
        unsaid = set(_UNSAID)
        if read is None:
            read = tuple(set[str]().union(*SETTINGS.values()))
            unsaid |= set(read)
        unsaid = {name for name in unsaid if getattr(self, name) == getattr(default, name)}
        # The orbit of a run on a recording is the recording's.
        of_none = self.sequence is None and self.orbit != default.orbit
        orbit = ("orbit",) if of_none else ()
        names = {*_OF_A_RUN, *read, *orbit} - unsaid if of_a_run else None
        return self.model_dump(mode="json", exclude_none=True, include=names)

    @model_validator(mode="after")
    def _scenario_comes_to_an_end(self) -> Self:
        """What is integrated in steps of an angle, and what memory is allocated by, is bounded."""
        duration_s = self.scenario.frames / self.scenario.frame_rate_hz
        omega_rad_s = math.radians(math.hypot(*self.body.omega_body_deg_s))
        turn_rad = duration_s * max(omega_rad_s, self.orbit.mean_motion_rad_s)
        if not turn_rad <= _MAX_TURN_RAD:
            raise ValueError(
                f"scenario: expected a motion of at most {_MAX_TURN_RAD:g} rad in all its frames, "
                f"got {turn_rad:g}"
            )
        points = self.features.points_m or range(self.features.count)
        if self.scenario.frames * len(points) > _MAX_SIGHTINGS:
            raise ValueError(
                f"scenario: expected at most {_MAX_SIGHTINGS:,} sightings, frames by features"
            )
        return self

    @model_validator(mode="before")
    @classmethod
    def _take_settings_beside_the_kind(cls, found: Any) -> Any:
        """[estimator] may hold what the table named after its kind may."""
        estimator = found.get("estimator") if isinstance(found, dict) else None
        if not isinstance(estimator, dict):
            return found
        kind, beside = estimator.get("kind"), dict(estimator)
        beside.pop("kind", None)
        table = found.get(kind, {}) if isinstance(kind, str) and kind in SETTINGS else None
        if not beside or kind not in cls.model_fields or not isinstance(table, dict):
            return found
        twice = sorted(set(beside) & set(table))
        if twice:
            raise ValueError(f"{twice[0]} stands in [estimator] and in [{kind}]")
        return {**found, "estimator": {"kind": kind}, kind: {**table, **beside}}


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
