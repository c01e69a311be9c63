"""sequence.toml: what holds for a whole sequence of our own format."""

import math
import os
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Self

import tomli_w
from pydantic import Field, Strict, model_validator

from pcnav.config.length_unit import LengthUnit
from pcnav.config.table import NonNegative, Positive, StrictTable
from pcnav.core.distortion import COEFFICIENTS, DistortionModel
from pcnav.core.errors import InputError
from pcnav.files.toml_file import read_toml_model
from pcnav.recordings.calibration import NOT_STATED, Calibration
from pcnav.recordings.cloud_axes import CloudAxes
from pcnav.recordings.depth_form import PLAIN, DepthForm, DepthIs
from pcnav.recordings.first_pose import prior_of, table_of
from pcnav.recordings.sequence import InitialPrior, SequenceInfo

SEQUENCE_FILE = "sequence.toml"


class _SequenceTable(StrictTable):
    name: str | None = None
    time_zero_s: float | None = None
    target_mesh: str | None = None
    mesh_unit: Annotated[LengthUnit, Strict(False)] | None = None


class _OrbitTable(StrictTable):
    mean_motion_rad_s: Annotated[float, Field(ge=0.0)] = 0.0


class _SensorTable(StrictTable):
    range_sigma_m: Positive | None = None
    invalid_depth: Annotated[int | float, Field(ge=0)] | None = None
    depth_is: Annotated[DepthIs, Strict(False)] = DepthIs.Z
    axes: Annotated[CloudAxes, Strict(False)] | None = None
    camera_position_sd_m: NonNegative = 0.0
    camera_attitude_sd_deg: NonNegative = 0.0
    row_readout_s: NonNegative = 0.0
    distortion_model: Annotated[DistortionModel, Strict(False)] = DistortionModel.OPENCV
    distortion: Annotated[tuple[float, ...], Strict(False)] = ()

    @model_validator(mode="after")
    def _coefficients_fit_the_model(self) -> Self:
        counts = COEFFICIENTS[self.distortion_model]
        if self.distortion and len(self.distortion) not in counts:
            expected = " or ".join(str(count) for count in counts)
            raise ValueError(f"distortion: expected {expected} numbers, got {len(self.distortion)}")
        return self

    @property
    def form(self) -> DepthForm:
        """What it says of the images."""
        model = self.distortion_model
        return DepthForm(self.invalid_depth, self.depth_is, model, self.distortion)


class _CalibrationTable(StrictTable):
    """What is not stated is as `Calibration` has it."""

    focal_sd: NonNegative = NOT_STATED.focal_sd
    centre_sd_px: NonNegative = NOT_STATED.centre_sd_px
    range_offset_sd_m: NonNegative = NOT_STATED.range_offset_sd_m
    range_scale_sd: NonNegative = NOT_STATED.range_scale_sd
    mesh_scale_sd: NonNegative = NOT_STATED.mesh_scale_sd
    stamp_jitter_sd_s: NonNegative = NOT_STATED.stamp_jitter_sd_s
    time_offset_sd_s: NonNegative = NOT_STATED.time_offset_sd_s
    mount_position_sd_m: NonNegative = NOT_STATED.mount_position_sd_m
    mount_attitude_sd_deg: NonNegative = math.degrees(NOT_STATED.mount_attitude_sd_rad)

    @property
    def calibration(self) -> Calibration:
        """What it says."""
        stated = self.model_dump()
        turn_rad = math.radians(stated.pop("mount_attitude_sd_deg"))
        return Calibration(**stated, mount_attitude_sd_rad=turn_rad)

    @staticmethod
    def of(calibration: Calibration) -> "_CalibrationTable":
        """The table that says it."""
        stated = asdict(calibration)
        turn_deg = math.degrees(stated.pop("mount_attitude_sd_rad"))
        return _CalibrationTable(**stated, mount_attitude_sd_deg=turn_deg)


class SequenceFile(StrictTable):
    """The tables of sequence.toml; an unknown key is an error."""

    sequence: _SequenceTable = _SequenceTable()
    orbit: _OrbitTable = _OrbitTable()
    sensor: _SensorTable = _SensorTable()
    calibration: _CalibrationTable | None = None
    initial: InitialPrior | None = None


def read_sequence_file(
    path: Path, target_mesh: Path | None = None
) -> tuple[SequenceInfo, DepthForm]:
    """What sequence.toml says, of the recording and of the form of its images.

    ``target_mesh`` replaces the mesh the file names, which then need not exist. Raises
    `InputError`.
    """
    content = read_toml_model(path, SequenceFile)
    stated = content.sequence.target_mesh
    if target_mesh is None and stated is not None:
        target_mesh = Path(os.path.normpath(path.parent / stated))
        if not target_mesh.is_file():
            expected = "expected a mesh file (path relative to this folder)"
            raise InputError(path, "sequence.target_mesh", f"{expected}, {target_mesh} is none")
    sensor = content.sensor
    info = SequenceInfo(
        name=content.sequence.name or path.absolute().parent.name,
        mean_motion_rad_s=content.orbit.mean_motion_rad_s,
        range_sigma_m=sensor.range_sigma_m,
        target_mesh=target_mesh,
        mesh_unit=content.sequence.mesh_unit,
        initial=content.initial,
        camera_position_sd_m=sensor.camera_position_sd_m,
        camera_attitude_sd_rad=math.radians(sensor.camera_attitude_sd_deg),
        row_readout_s=sensor.row_readout_s,
        first_pose=prior_of(content.initial),
        calibration=None if content.calibration is None else content.calibration.calibration,
    )
    return info, sensor.form


def stated_axes(path: Path) -> CloudAxes | None:
    """The axes of clouds that sequence.toml states; None where it, or the file, is not there.

    Raises `InputError`.
    """
    return read_toml_model(path, SequenceFile).sensor.axes if path.exists() else None


def stated_time_zero(path: Path) -> float | None:
    """Stamp that sequence.toml calls time 0; None where it, or the file, is not there.

    Raises `InputError`.
    """
    if not path.exists():
        return None
    return read_toml_model(path, SequenceFile).sequence.time_zero_s


def write_sequence_file(path: Path, info: SequenceInfo, form: DepthForm = PLAIN) -> None:
    """Write sequence.toml; the target's mesh becomes a path relative to its folder."""
    sequence: dict[str, object] = {"name": info.name}
    if info.time_zero_s:
        sequence["time_zero_s"] = info.time_zero_s
    if info.target_mesh is not None:
        sequence["target_mesh"] = _relative(info.target_mesh, path.parent)
    if info.mesh_unit is not None:
        sequence["mesh_unit"] = info.mesh_unit.value
    tables: dict[str, object] = {
        "sequence": sequence,
        "orbit": {"mean_motion_rad_s": info.mean_motion_rad_s},
        "sensor": _sensor_table(info, form),
    }
    if info.calibration is not None:
        tables["calibration"] = _CalibrationTable.of(info.calibration).model_dump()
    initial = {} if info.initial is None else info.initial.model_dump(exclude_none=True)
    if info.first_pose is not None:
        initial |= table_of(info.first_pose).model_dump()
    if initial:
        tables["initial"] = initial
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")


def _sensor_table(info: SequenceInfo, form: DepthForm) -> dict[str, Any]:
    """What [sensor] has to say: only what is known, and is not the default."""
    stated = _SensorTable(
        range_sigma_m=info.range_sigma_m,
        invalid_depth=form.invalid_units,
        depth_is=form.depth_is,
        camera_position_sd_m=info.camera_position_sd_m,
        camera_attitude_sd_deg=math.degrees(info.camera_attitude_sd_rad),
        row_readout_s=info.row_readout_s,
        distortion_model=form.distortion_model,
        distortion=form.distortion,
    )
    return stated.model_dump(mode="json", exclude_defaults=True)


def _relative(target: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:
        # Two drives of a Windows machine have no relative path between them.
        return target.resolve().as_posix()
