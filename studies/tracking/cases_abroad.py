"""Scenes as real sensors see them: what is beside the target, how it moves, what the sensor does.

Each case is a change of a pipeline whose truth is the seed's, and names the case that shows the
same frames without the fault.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.config.pipeline_file import Pipeline
from pcnav.simulation.random_truth import Satellite, Spread, random_truth, satellite

Tables = Mapping[str, Mapping[str, Any]]
"""Keys of the pipeline by table."""


@dataclass(frozen=True)
class Base:
    """Which satellite is seen, from where and how often."""

    satellite: str
    spread: Spread
    frame_rate_hz: float

    def truth(self, seed: int, frames: int) -> Pipeline:
        """The pipeline of a seed's truth."""
        rate = self.frame_rate_hz
        return random_truth(self.found, self.spread, seed, frames=frames, frame_rate_hz=rate)

    @property
    def found(self) -> Satellite:
        """The satellite with its pipeline."""
        return satellite(self.satellite)


ORBIT = Base("boxsat", Spread((15.0, 30.0), (1.0, 5.0), 0.02), 2.0)
"""A tumbling satellite seen at 2 Hz."""
FAST = Base("boxsat", Spread((15.0, 30.0), (12.0, 12.0), 0.02), 5.0)
LABORATORY = Base("cubesat6u", Spread((1.2, 2.2), (0.0, 0.0), 0.0), 30.0)
"""A CubeSat that is carried before a camera of 30 Hz."""


@dataclass(frozen=True)
class Setting:
    """What a case may depend on."""

    sigma_m: float
    diameter_m: float
    distance_m: float
    duration_s: float
    direction_hill: tuple[float, float, float]
    """From camera to target."""


@dataclass(frozen=True)
class AbroadCase:
    """One case."""

    change: Callable[[Setting], Tables]
    """What its pipeline has that the seed's truth has not."""
    base: Base = ORBIT
    beside: str | None = "clean"
    """The case of the same frames without the fault; None of one without any."""
    loses_information: bool = False
    """Whether the best estimate is worse than without the fault."""

    def pipeline(self, seed: int, frames: int) -> Pipeline:
        """The scenario of a seed."""
        truth = self.base.truth(seed, frames)
        return _with(truth, self.change(_setting(self.base, truth)))


def _setting(base: Base, truth: Pipeline) -> Setting:
    place = np.array(truth.orbit.r_hill_m)
    distance = float(np.linalg.norm(place))
    x, y, z = (place / distance).tolist()
    scenario = truth.scenario
    return Setting(
        sigma_m=truth.noise.range_sigma_m,
        diameter_m=base.found.target.diameter_m,
        distance_m=distance,
        duration_s=scenario.frames / scenario.frame_rate_hz,
        direction_hill=(x, y, z),
    )


def _with(pipeline: Pipeline, tables: Tables) -> Pipeline:
    found: dict[str, Any] = pipeline.model_dump()
    for table, keys in tables.items():
        found[table] = {**found[table], **keys}
    return Pipeline.model_validate(found)


def _set(table: str, **keys: Any) -> Callable[[Setting], Tables]:
    return lambda _: {table: keys}


def _earth(of: Setting) -> Tables:
    """A ball whose nearest point is two diameters behind the target, larger than the view."""
    return {
        "background": {
            "kind": "earth",
            "behind_m": 2.0 * of.diameter_m,
            "earth_radius_m": 8.0 * of.diameter_m,
        }
    }


def _wall_near(of: Setting) -> Tables:
    """Behind the middle by little more than half the diameter: a panel may all but touch it."""
    return {"background": {"kind": "wall", "behind_m": 0.55 * of.diameter_m}}


def _wall_rough(of: Setting) -> Tables:
    return {"background": {"kind": "wall", "roughness_m": 0.03 * of.diameter_m}}


def _holes(of: Setting) -> Tables:
    """Slanted faces and dark patches do not return."""
    patches = {"dark_fraction": 0.15, "dark_patch_m": 0.05 * of.diameter_m}
    return {"noise": {"hole_incidence_deg": 70.0, **patches}}


def _limb(of: Setting) -> Tables:
    radius, altitude = 4.0 * of.diameter_m, of.distance_m + of.diameter_m
    # The limb passes the target's middle.
    limb = float(np.rad2deg(np.arcsin(radius / (radius + altitude))))
    return {
        "background": {
            "kind": "earth",
            "behind_m": of.diameter_m,
            "earth_radius_m": radius,
            "earth_offset_deg": limb,
        }
    }


def _crossing(of: Setting) -> Tables:
    times = {"start_s": 0.3 * of.duration_s, "end_s": 0.7 * of.duration_s}
    return {"occluder": {"kind": "arm", **times}}


def _receding(of: Setting) -> Tables:
    """The distance grows by the root of three over the run."""
    speed = (np.sqrt(3.0) - 1.0) * of.distance_m / of.duration_s
    x, y, z = of.direction_hill
    return {"orbit": {"v_hill_m_s": (speed * x, speed * y, speed * z)}}


def _growing(of: Setting) -> Tables:
    """Grows with the square of the range, from what is stated at first to three times that."""
    return {"noise": {"range_sigma_m": 0.0, "range_sigma_per_m2": of.sigma_m / of.distance_m**2}}


def _table(of: Setting) -> Tables:
    """The camera looks down on it by 35 degrees, and is carried: nobody knows its poses."""
    return {"background": {"kind": "table", "clutter_count": 6}}


def _standing(of: Setting) -> Tables:
    """+z of the model up in the image, tilted towards the camera, turned at random about it."""
    return {"body": {"attitude_rotvec_deg": _upright_deg(of)}, "motion": {"kind": "hand"}}


def _upright_deg(of: Setting) -> tuple[float, float, float]:
    # The camera looks along +x of Hill and nadir, +z, is down: up is -z, towards it is -x.
    heading = 1e4 * of.distance_m % 360.0
    R = (
        Rotation.from_euler("y", 35.0, degrees=True)
        * Rotation.from_euler("x", 180.0, degrees=True)
        * Rotation.from_euler("z", heading, degrees=True)
    )
    x, y, z = R.as_rotvec(degrees=True).tolist()
    return x, y, z


def _impulse(of: Setting) -> Tables:
    return {"motion": {"kind": "impulse", "at_s": 0.5 * of.duration_s}}


def _torque(of: Setting) -> Tables:
    return {"motion": {"kind": "torque", "at_s": 0.4 * of.duration_s}}


def _offset(of: Setting) -> Tables:
    return {"noise": {"frame_offset_sd_m": 5.0 * of.sigma_m}}


def _uneven(of: Setting) -> Tables:
    """Errors of a face as large as the noise of a pixel, and half as much as a tilt across it."""
    return {"noise": {"face_offset_sd_m": of.sigma_m, "face_tilt_sd_deg": 0.3}}


def _mixed(_: Setting) -> Tables:
    """Pixels that average what is in them, the target's rim and the wall behind it among that."""
    return {"noise": {"footprint": "any", "footprint_mixes": True}}


def _stated(factor: float) -> Callable[[Setting], Tables]:
    return lambda of: {"noise": {"stated_range_sigma_m": factor * of.sigma_m}}


def _calibrated_to(is_stated: bool = True) -> Callable[[Setting], Tables]:
    """As well as a good calibration does it, which a recording states or leaves open."""
    errors = {"focal_sd": 0.002, "centre_sd_px": 0.5, "range_offset_sd_m": 0.005}
    scales = {"range_scale_sd": 0.002, "mesh_scale_sd": 0.002}
    return _set("miscalibration", **errors, **scales, is_stated=is_stated)


def _all_of(*changes: Callable[[Setting], Tables]) -> Callable[[Setting], Tables]:
    def joined(of: Setting) -> Tables:
        tables: dict[str, dict[str, Any]] = {}
        for change in changes:
            for name, keys in change(of).items():
                tables[name] = {**tables.get(name, {}), **keys}
        return tables

    return joined


def _plain(_: Setting) -> Tables:
    return {}


_HAND = _set("motion", kind="hand")
_SPUN = _set("body", omega_body_deg_s=(9.0, 14.0, -8.0))
_WALL = _set("background", kind="wall")
CASES: Mapping[str, AbroadCase] = {
    # The same frames without a fault.
    "clean": AbroadCase(_plain, beside=None),
    "fast": AbroadCase(_plain, FAST, None),
    "receding": AbroadCase(_receding, beside=None),
    "laboratory": AbroadCase(_SPUN, LABORATORY, None),
    # What stands behind.
    "wall": AbroadCase(_set("background", kind="wall", tilt_deg=20.0)),
    "wall_near": AbroadCase(_wall_near),
    "wall_rough": AbroadCase(_wall_rough),
    "earth": AbroadCase(_earth),
    "earth_limb": AbroadCase(_limb),
    # What stands before.
    "occluder_40": AbroadCase(_set("occluder", kind="hand", turns=False), loses_information=True),
    "arm": AbroadCase(_crossing, loses_information=True),
    "beam": AbroadCase(_set("occluder", kind="beam", share_fraction=0.25), loses_information=True),
    # What the sensor does.
    "false_1": AbroadCase(_set("noise", false_return_fraction=0.01)),
    "false_5": AbroadCase(_set("noise", false_return_fraction=0.05)),
    "false_20": AbroadCase(_set("noise", false_return_fraction=0.2), loses_information=True),
    "replaced_30": AbroadCase(_set("noise", outlier_fraction=0.3), loses_information=True),
    "replaced_50": AbroadCase(_set("noise", outlier_fraction=0.5), loses_information=True),
    "offset_5": AbroadCase(_offset, loses_information=True),
    "growing": AbroadCase(_all_of(_receding, _growing), beside="receding", loses_information=True),
    "stated_third": AbroadCase(_stated(1.0 / 3.0)),
    "stated_triple": AbroadCase(_stated(3.0)),
    "unstated": AbroadCase(_set("noise", states_range_sigma=False)),
    "uneven": AbroadCase(_uneven, loses_information=True),
    "uneven_rim": AbroadCase(
        _all_of(_uneven, _set("noise", footprint="any")), loses_information=True
    ),
    "multipath": AbroadCase(_set("noise", multipath_fraction=0.05), loses_information=True),
    "holes": AbroadCase(_holes, loses_information=True),
    "footprint_any": AbroadCase(_set("noise", footprint="any")),
    "footprint_quarter": AbroadCase(_set("noise", footprint="quarter")),
    "footprint_half": AbroadCase(_set("noise", footprint="half")),
    "mixed_wall": AbroadCase(_all_of(_WALL, _mixed), loses_information=True),
    "distorted": AbroadCase(_set("camera", distortion=(-0.25, 0.08, 0.001, -0.0005))),
    "jitter": AbroadCase(_set("noise", stamp_jitter_s=0.02), FAST, "fast"),
    # How well it is calibrated.
    "calibrated": AbroadCase(_calibrated_to(), loses_information=True),
    "uncalibrated": AbroadCase(_calibrated_to(is_stated=False), loses_information=True),
    # How the target moves.
    "impulse": AbroadCase(_impulse),
    "torque": AbroadCase(_torque),
    "spin": AbroadCase(_all_of(_SPUN, _set("motion", kind="spin")), LABORATORY, "laboratory"),
    "sway": AbroadCase(_set("motion", kind="sway", extent_m=0.1), LABORATORY, "laboratory"),
    "path": AbroadCase(
        _set("motion", kind="path", extent_m=0.15, leg_s=2.0), LABORATORY, "laboratory"
    ),
    "hand": AbroadCase(_HAND, LABORATORY, "laboratory"),
    "camera_hand": AbroadCase(
        _set("motion", kind="hand", mover="camera"), LABORATORY, "laboratory"
    ),
    "held": AbroadCase(
        _all_of(_HAND, _set("occluder", kind="hand")), LABORATORY, "hand", loses_information=True
    ),
    "standing": AbroadCase(_standing, LABORATORY, "laboratory"),
    "table": AbroadCase(_all_of(_standing, _table), LABORATORY, "standing"),
}
"""By name."""
