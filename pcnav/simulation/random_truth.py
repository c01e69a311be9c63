"""The shipped satellites and random truths of them: what a Monte Carlo run starts from."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.scenario import BodyTable
from pcnav.config.shipped import shipped_mesh, shipped_pipeline
from pcnav.config.table import Vector3, Vector5
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.inertia_parameters import (
    MIN_SHARE,
    parameters_from_ratios,
    ratios_from_parameters,
    shares,
)
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.target.satellite import Target, load_target

_CENTRAL_SHARE = 0.1
"""A target too large for the image has its centre within this share of the field about the axis."""


@dataclass(frozen=True)
class Satellite:
    """A shipped target and the pipeline that is shipped with it: camera, noise, settings, orbit."""

    target: Target
    pipeline: Pipeline

    @property
    def name(self) -> str:
        """As the mesh is called."""
        return self.target.name


@dataclass(frozen=True)
class Spread:
    """Between which limits a truth is drawn, all uniformly."""

    range_m: tuple[float, float]
    """Distance of the target's middle along the optical axis."""
    rate_deg_s: tuple[float, float]
    """Magnitude of the angular rate; its direction is uniform."""
    speed_m_s: float
    """Largest magnitude of the relative velocity; its direction is uniform."""

    def scaled(self, factor: float) -> "Spread":
        """Lengths times a factor, for a target of another size."""
        low, high = self.range_m
        return Spread((low * factor, high * factor), self.rate_deg_s, self.speed_m_s * factor)


@lru_cache(maxsize=8)
def satellite(name: str) -> Satellite:
    """A shipped satellite by name, read once. Raises `InputError` when there is none."""
    mesh, pipeline = shipped_mesh(name), shipped_pipeline(name)
    if mesh is None or pipeline is None:
        raise InputError(name, "satellite", "expected a mesh and a pipeline shipped by this name")
    return Satellite(load_target(mesh), read_pipeline(pipeline))


def random_truth(
    of: Satellite, spread: Spread, seed: int, *, frames: int, frame_rate_hz: float
) -> Pipeline:
    """The satellite's pipeline with a random motion and random mass properties.

    Attitude uniform on SO(3); mass centre and inertia from the normal prior of the target, drawn
    again until a body can have them that is not too thin. The middle of the target's bounding box
    is so far off the optical axis that the target stays within the image, or close to the axis
    where it does not fit. The seed also draws the noise.
    """
    generator = np.random.default_rng(seed)
    attitude = Rotation.random(rng=generator)
    mass = of.target.mass
    ratios = _physical_ratios(mass, generator)
    com = generator.multivariate_normal(mass.com_model, mass.com_covariance_m2, method="cholesky")
    rate = generator.uniform(*spread.rate_deg_s) * _direction(generator)
    middle_cam = _placed(of, generator.uniform(*spread.range_m), generator)
    R_hill_cam = of.pipeline.camera.R_cam_hill.T
    middle_model = np.asarray(of.target.mesh.bounds).mean(axis=0)
    # The world is the Hill frame at time 0.
    r_hill = R_hill_cam @ middle_cam + attitude.as_matrix() @ (com - middle_model)
    velocity = generator.uniform(0.0, spread.speed_m_s) * _direction(generator)
    body = BodyTable(
        attitude_rotvec_deg=_vector3(np.rad2deg(attitude.as_rotvec())),
        omega_body_deg_s=_vector3(rate),
        com_model_m=_vector3(com),
        inertia_ratios=_vector5(ratios),
    )
    scenario = of.pipeline.scenario.model_copy(
        update={"frames": frames, "frame_rate_hz": frame_rate_hz}
    )
    orbit = of.pipeline.orbit.model_copy(
        update={"r_hill_m": _vector3(r_hill), "v_hill_m_s": _vector3(velocity)}
    )
    changed = {"seed": seed, "scenario": scenario, "orbit": orbit, "body": body}
    return of.pipeline.model_copy(update=changed)


def _physical_ratios(mass: MassBelief, generator: np.random.Generator) -> FloatArray:
    """(5,) of a body. A prior about one that can be holds many, however wide it is."""
    mean = parameters_from_ratios(mass.inertia_ratios)
    while True:
        drawn = generator.multivariate_normal(mean, mass.parameter_covariance, method="cholesky")
        if shares(drawn)[0][0] > MIN_SHARE:
            return ratios_from_parameters(drawn)


def _placed(of: Satellite, range_m: float, generator: np.random.Generator) -> FloatArray:
    """(3,) middle of the target in the camera."""
    camera = of.pipeline.camera
    half_width = np.tan(0.5 * np.deg2rad(camera.horizontal_fov_deg))
    half = np.array([half_width, half_width * camera.height_px / camera.width_px])
    room = half - 0.5 * of.target.diameter_m / range_m
    tangent = np.maximum(room, _CENTRAL_SHARE * half) * generator.uniform(-1.0, 1.0, 2)
    return np.asarray(range_m * np.array([*tangent, 1.0]))


def _direction(generator: np.random.Generator) -> FloatArray:
    vector = generator.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))


def _vector3(values: FloatArray) -> Vector3:
    x, y, z = (float(value) for value in values)
    return x, y, z


def _vector5(values: FloatArray) -> Vector5:
    a, b, c, d, e = (float(value) for value in values)
    return a, b, c, d, e
