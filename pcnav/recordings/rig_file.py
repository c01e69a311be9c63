"""rig.toml: the stereo rig, the chaser's orbit and where the rig looks, of a track recording."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tomli_w
from pydantic import BaseModel, ConfigDict, Field

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.files.toml_file import read_toml_model

RIG_FILE = "rig.toml"

_Positive = Annotated[float, Field(gt=0.0)]
_PositiveInt = Annotated[int, Field(gt=0)]
_Two = Annotated[list[float], Field(min_length=2, max_length=2)]
_TwoCounts = Annotated[list[_PositiveInt], Field(min_length=2, max_length=2)]
_Three = Annotated[list[float], Field(min_length=3, max_length=3)]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, strict=True)


class _RigTable(_Table):
    baseline_m: _Positive
    focal_px: _Positive
    centre_px: _Two
    size_px: _TwoCounts
    pixel_sigma_px: _Positive


class _OrbitTable(_Table):
    mean_motion_rad_s: Annotated[float, Field(ge=0.0)] = 0.0
    eccentricity: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.0
    true_anomaly_deg: float = 0.0


class _PointingTable(_Table):
    boresight_hill: _Three


class _RigFile(_Table):
    rig: _RigTable
    orbit: _OrbitTable = _OrbitTable()
    pointing: _PointingTable | None = None


def read_rig_file(path: Path) -> tuple[StereoRig, KeplerOrbit, FloatArray | None]:
    """Rig, orbit and, where the file says it, the (3,) boresight in Hill axes.

    Raises `InputError`.
    """
    content = read_toml_model(path, _RigFile)
    table, orbit = content.rig, content.orbit
    rig = StereoRig(
        baseline_m=table.baseline_m,
        focal_px=table.focal_px,
        centre_px=(table.centre_px[0], table.centre_px[1]),
        size_px=(table.size_px[0], table.size_px[1]),
        pixel_sigma_px=table.pixel_sigma_px,
    )
    anomaly = float(np.deg2rad(orbit.true_anomaly_deg))
    kepler = KeplerOrbit(orbit.mean_motion_rad_s, orbit.eccentricity, anomaly)
    if content.pointing is None:
        return rig, kepler, None
    boresight = np.array(content.pointing.boresight_hill)
    if not boresight.any():
        raise InputError(path, "pointing.boresight_hill", "expected a direction, got 0, 0, 0")
    return rig, kepler, boresight


def write_rig_file(path: Path, rig: StereoRig, orbit: KeplerOrbit) -> None:
    """Write rig.toml without [pointing]: the attitude of every frame is stored beside it."""
    tables = {
        "rig": {
            "baseline_m": rig.baseline_m,
            "focal_px": rig.focal_px,
            "centre_px": list(rig.centre_px),
            "size_px": list(rig.size_px),
            "pixel_sigma_px": rig.pixel_sigma_px,
        },
        "orbit": {
            "mean_motion_rad_s": orbit.mean_motion_rad_s,
            "eccentricity": orbit.eccentricity,
            "true_anomaly_deg": float(np.rad2deg(orbit.true_anomaly_rad)),
        },
    }
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")
