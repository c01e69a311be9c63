"""sequence.toml: what holds for a whole sequence of our own format."""

import os
from pathlib import Path
from typing import Annotated

import tomli_w
from pydantic import Field

from pcnav.config.table import Positive, StrictTable
from pcnav.core.errors import InputError
from pcnav.files.toml_file import read_toml_model
from pcnav.recordings.sequence import InitialPrior, SequenceInfo

SEQUENCE_FILE = "sequence.toml"


class _SequenceTable(StrictTable):
    name: str | None = None
    target_mesh: str | None = None


class _OrbitTable(StrictTable):
    mean_motion_rad_s: Annotated[float, Field(ge=0.0)] = 0.0


class _SensorTable(StrictTable):
    range_sigma_m: Positive
    invalid_depth: Annotated[int, Field(ge=0, le=65535)] | None = None


class SequenceFile(StrictTable):
    """The tables of sequence.toml; an unknown key is an error."""

    sequence: _SequenceTable = _SequenceTable()
    orbit: _OrbitTable = _OrbitTable()
    sensor: _SensorTable
    initial: InitialPrior | None = None


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
        initial=content.initial,
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
        tables["initial"] = info.initial.model_dump(exclude_none=True)
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")


def _relative(target: Path, folder: Path) -> str:
    try:
        return Path(os.path.relpath(target.resolve(), folder.resolve())).as_posix()
    except ValueError:
        # Two drives of a Windows machine have no relative path between them.
        return target.resolve().as_posix()
