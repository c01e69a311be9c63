"""The TOML file beside a mesh: the target's name, mass properties and names of its rectangles."""

import os
import tempfile
from pathlib import Path
from typing import Annotated

import tomli_w
from pydantic import Field, field_validator

from pcnav.config.length_unit import LengthUnit
from pcnav.config.scenario import InertiaRatios
from pcnav.config.table import Direction, Positive, Table, Vector3
from pcnav.core.errors import InputError
from pcnav.files.toml_file import read_toml_model

_Name = Annotated[str, Field(min_length=1)]


class MassTable(Table):
    """[mass]: nominal mass properties; None takes those of the uniform mesh."""

    com_model_m: Vector3 | None = None
    com_sd_m: Positive | None = None
    inertia_ratios: InertiaRatios | None = None
    """Iyy, Izz, Ixy, Ixz, Iyz over Ixx, entries of the inertia matrix about the mass centre."""
    inertia_ratio_sd: Positive | None = None


class RectangleName(Table):
    """[[rectangles.names]]: the name of the rectangle at this centroid, facing this way."""

    name: _Name
    centroid_model_m: Vector3
    normal_model: Direction


class RectanglesTable(Table):
    """[rectangles]."""

    names: tuple[RectangleName, ...] = ()

    @field_validator("names")
    @classmethod
    def _unique(cls, names: tuple[RectangleName, ...]) -> tuple[RectangleName, ...]:
        if len({entry.name for entry in names}) < len(names):
            raise ValueError("expected every name once")
        return names


class Sidecar(Table):
    """The whole file; every table may be left out."""

    name: _Name | None = None
    mesh_unit: LengthUnit | None = None
    """Unit of the coordinates in the mesh file; None takes the one it declares, else metres."""
    mass: MassTable = MassTable()
    rectangles: RectanglesTable = RectanglesTable()

    @staticmethod
    def of(
        name: str,
        mass: MassTable,
        names: tuple[RectangleName, ...],
        mesh_unit: LengthUnit | None = None,
    ) -> "Sidecar":
        """A sidecar of its parts."""
        rectangles = RectanglesTable(names=names)
        return Sidecar(name=name, mesh_unit=mesh_unit, mass=mass, rectangles=rectangles)


def read_sidecar(path: Path) -> Sidecar:
    """Read and check a sidecar. Raises `InputError`, also on an unknown key."""
    return read_toml_model(path, Sidecar)


def write_sidecar(sidecar: Sidecar, path: Path, comment: str = "") -> None:
    """Write a sidecar as TOML, under a temporary name first. Raises `InputError`."""
    text = "".join(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
    # Numbers keep every digit, so reading gives back what was written.
    text += tomli_w.dumps(sidecar.model_dump(mode="json", exclude_none=True, exclude_defaults=True))
    try:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(path, "file", f"expected a writable folder ({error.strerror})") from error
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
            file.write(text)
        # A temporary file is private by default; a result is as readable as its neighbours.
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except OSError as error:
        Path(temporary).unlink(missing_ok=True)
        raise InputError(path, "file", f"expected a writable file ({error.strerror})") from error
