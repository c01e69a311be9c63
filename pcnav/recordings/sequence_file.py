"""sequence.toml: what holds for a whole sequence of our own format."""

import os
from pathlib import Path
from typing import Annotated

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.files.toml_file import read_toml_model
from pcnav.recordings.sequence import InitialPrior, SequenceInfo

SEQUENCE_FILE = "sequence.toml"

_Positive = Annotated[float, Field(gt=0.0)]
_Three = Annotated[list[float], Field(min_length=3, max_length=3)]
_ThreePositive = Annotated[list[_Positive], Field(min_length=3, max_length=3)]
_Five = Annotated[list[float], Field(min_length=5, max_length=5)]
_FivePositive = Annotated[list[_Positive], Field(min_length=5, max_length=5)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class _SequenceTable(_Table):
    name: str | None = None
    target_mesh: str | None = None


class _OrbitTable(_Table):
    mean_motion_rad_s: Annotated[float, Field(ge=0.0)] = 0.0


class _SensorTable(_Table):
    range_sigma_m: _Positive
    invalid_depth: Annotated[int, Field(ge=0, le=65535)] | None = None


class _InitialTable(_Table):
    com_model_m: _Three | None = None
    com_sd_m: _ThreePositive | None = None
    inertia_ratios: _Five | None = None
    inertia_ratios_sd: _FivePositive | None = None


class SequenceFile(_Table):
    """The tables of sequence.toml; an unknown key is an error."""

    sequence: _SequenceTable = _SequenceTable()
    orbit: _OrbitTable = _OrbitTable()
    sensor: _SensorTable
    initial: _InitialTable | None = None


def read_sequence_file(
    path: Path, target_mesh: Path | None = None
) -> tuple[SequenceInfo, int | None]:
    """What sequence.toml says, and the stored unit that means no return besides 0.

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
    info = SequenceInfo(
        name=content.sequence.name or path.absolute().parent.name,
        mean_motion_rad_s=content.orbit.mean_motion_rad_s,
        range_sigma_m=content.sensor.range_sigma_m,
        target_mesh=target_mesh,
        initial=_prior(path, content.initial),
    )
    return info, content.sensor.invalid_depth


def write_sequence_file(path: Path, info: SequenceInfo) -> None:
    """Write sequence.toml; the target's mesh becomes a path relative to its folder."""
    sequence = {"name": info.name}
    if info.target_mesh is not None:
        sequence["target_mesh"] = _relative(info.target_mesh, path.parent)
    tables: dict[str, object] = {
        "sequence": sequence,
        "orbit": {"mean_motion_rad_s": info.mean_motion_rad_s},
        "sensor": {"range_sigma_m": info.range_sigma_m},
    }
    if info.initial is not None:
        known = {
            "com_model_m": info.initial.com_model_m,
            "com_sd_m": info.initial.com_sd_m,
            "inertia_ratios": info.initial.inertia_ratios,
            "inertia_ratios_sd": info.initial.inertia_ratios_sd,
        }
        tables["initial"] = {key: v.tolist() for key, v in known.items() if v is not None}
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")


def _relative(target: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:
        # Two drives of a Windows machine have no relative path between them.
        return target.resolve().as_posix()


def _prior(path: Path, table: _InitialTable | None) -> InitialPrior | None:
    if table is None:
        return None
    prior = InitialPrior(
        com_model_m=_array(table.com_model_m),
        com_sd_m=_array(table.com_sd_m),
        inertia_ratios=_array(table.inertia_ratios),
        inertia_ratios_sd=_array(table.inertia_ratios_sd),
    )
    ratios = prior.inertia_ratios
    if ratios is not None and not is_physical_inertia(inertia_from_ratios(ratios)):
        raise InputError(
            path, "initial.inertia_ratios", "expected the ratios of a physical inertia matrix"
        )
    return prior


def _array(values: list[float] | None) -> FloatArray | None:
    return None if values is None else np.array(values, dtype=np.float64)
