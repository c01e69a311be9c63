"""Feature points of a tumbling target as a stereo rig sees them, with the faults of real tracks."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import OrbitModel, OrbitTable
from pcnav.config.sensors import Boresight, FeaturesTable, StereoTable
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import R_cam_hill
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.recordings.tracks import TrackFrame, Tracks
from pcnav.simulation.feature_motion import FeatureTruth as FeatureTruth
from pcnav.simulation.feature_motion import InitialMotion, relative_orbit, rotation

_NEAREST_M = 0.1
"""Nothing closer to the plane of the two cameras than this is seen."""


@dataclass(frozen=True)
class FeatureScenario:
    """What is simulated; `dataclasses.replace` and `model_copy` make variants of it."""

    name: str
    times_s: FloatArray
    """(n,) increasing; world equals Hill at time 0."""
    orbit: KeplerOrbit
    orbit_model: OrbitModel
    start: InitialMotion
    """At the first time."""
    inertia: FloatArray
    """(3, 3) of any scale, body axes."""
    stereo: StereoTable
    features: FeaturesTable


def feature_scenario(pipeline: Pipeline, source: Path | str = "pipeline") -> FeatureScenario:
    """The scenario of a pipeline file. ``source`` is what an `InputError` names.

    Raised when no body has the inertia ratios or a rig fixed in the Hill frame has no direction.
    """
    body, table = pipeline.body, pipeline.orbit
    inertia = inertia_from_ratios(np.array(body.inertia_ratios))
    if not is_physical_inertia(inertia):
        expected = "expected ratios of a physical inertia matrix: positive principal moments"
        expected += ", none larger than the other two together"
        raise InputError(source, "body.inertia_ratios", expected)
    if not any(pipeline.stereo.boresight_hill):
        raise InputError(source, "stereo.boresight_hill", "expected a direction, got 0, 0, 0")
    if any(body.com_model_m):
        expected = "expected 0, 0, 0: feature points are given from the mass centre"
        raise InputError(source, "body.com_model_m", expected)
    return FeatureScenario(
        name=Path(source).stem,
        times_s=np.arange(pipeline.scenario.frames) / pipeline.scenario.frame_rate_hz,
        orbit=kepler_orbit(table),
        orbit_model=table.model,
        start=InitialMotion(
            r_hill=np.array(table.r_hill_m),
            v_hill=np.array(table.v_hill_m_s),
            R_world_body=exp_rotation(np.deg2rad(np.array(body.attitude_rotvec_deg))),
            omega_body=np.deg2rad(np.array(body.omega_body_deg_s)),
        ),
        inertia=inertia,
        stereo=pipeline.stereo,
        features=pipeline.features,
    )


def kepler_orbit(table: OrbitTable) -> KeplerOrbit:
    """The chaser's orbit of an [orbit] table."""
    anomaly = float(np.deg2rad(table.true_anomaly_deg))
    return KeplerOrbit(table.mean_motion_rad_s, table.eccentricity, anomaly)


def stereo_rig(table: StereoTable) -> StereoRig:
    """The rig of a [stereo] table; its optical axis goes through the middle of the image."""
    return StereoRig(
        baseline_m=table.baseline_m,
        focal_px=table.focal_px,
        centre_px=(0.5 * (table.width_px - 1), 0.5 * (table.height_px - 1)),
        size_px=(table.width_px, table.height_px),
        pixel_sigma_px=table.pixel_sigma_px,
    )


def simulate_features(
    scenario: FeatureScenario, rng: np.random.Generator
) -> tuple[Tracks, FeatureTruth]:
    """Tracks of a scenario and the truth behind them.

    Points, motion, pointing, tracking and noise draw from streams of their own: two scenarios that
    differ in one of them share the draws of the others.
    """
    points, motion, observation = rng.spawn(3)
    truth = simulate_motion(scenario, draw_points(scenario.features, points), motion)
    return observe(scenario, truth, observation), truth


def draw_points(table: FeaturesTable, rng: np.random.Generator) -> FloatArray:
    """(N, 3) points in body axes, m: those listed, or uniform in the cube (Segal 2011 (15))."""
    if table.points_m:
        return np.array(table.points_m)
    return rng.uniform(-table.half_extent_m, table.half_extent_m, (table.count, 3))


def simulate_motion(
    scenario: FeatureScenario, points: FloatArray, rng: np.random.Generator
) -> FeatureTruth:
    """The true motion of a scenario with points (N, 3) in body axes."""
    table, times_s, start = scenario.features, scenario.times_s, scenario.start
    on_orbit, on_body = rng.spawn(2)
    orbit = relative_orbit(
        *(scenario.orbit_model, scenario.orbit, start, times_s),
        *(table.acceleration_psd_m2_s3, on_orbit),
    )
    R_world_body, omega_body = rotation(
        start, scenario.inertia, times_s, table.angular_acceleration_psd_rad2_s3, on_body
    )
    return FeatureTruth(
        times_s=times_s,
        r_hill=orbit[:, :3],
        v_hill=orbit[:, 3:],
        R_world_body=R_world_body,
        omega_body=omega_body,
        inertia=scenario.inertia,
        points=points,
    )


def observe(scenario: FeatureScenario, truth: FeatureTruth, rng: np.random.Generator) -> Tracks:
    """What the rig of a scenario sees of a true motion."""
    pointing, tracking, noise, matching = rng.spawn(4)
    rig = stereo_rig(scenario.stereo)
    R_hill_world = np.stack([scenario.orbit.R_hill_world(t) for t in truth.times_s])
    R_hill_body = R_hill_world @ truth.R_world_body
    R_rig_hill = _pointed(scenario.stereo, truth.r_hill, pointing)
    from_centre = truth.points @ np.swapaxes(R_hill_body, 1, 2)
    p_hill = truth.r_hill[:, None] + from_centre
    p_rig = p_hill @ np.swapaxes(R_rig_hill, 1, 2)
    seen = (
        in_view(rig, p_rig)
        & _lit(scenario.features, truth.times_s)[:, None]
        & _tracked(scenario.features, truth.times_s, len(truth.points), tracking)
    )
    if scenario.features.hidden_by_normals:
        seen &= _facing(scenario.features, truth.points, R_hill_body, p_hill)
    pixels = np.full((*p_rig.shape[:2], 4), np.nan)
    pixels[seen] = rig.project(p_rig[seen])
    pixels += rig.pixel_sigma_px * noise.standard_normal(pixels.shape)
    pixels = _mismatched(scenario.features.wrong_match_fraction, rig, pixels, seen, matching)
    # No matcher pairs a point with one behind the rig.
    seen &= rig.disparity(np.where(seen[..., None], pixels, 0.0)) > 0.0
    frames = tuple(
        TrackFrame(float(t), R, np.flatnonzero(visible), row[visible])
        for t, R, visible, row in zip(
            truth.times_s, R_rig_hill @ R_hill_world, seen, pixels, strict=True
        )
    )
    return Tracks(scenario.name, rig, scenario.orbit, frames)


def in_view(rig: StereoRig, p_rig: FloatArray) -> BoolArray:
    """(...,) whether points (..., 3) lie before the rig and inside both of its images."""
    before = p_rig[..., 2] > _NEAREST_M
    pixels = rig.project(np.where(before[..., None], p_rig, [0.0, 0.0, 1.0]))
    width, height = rig.size_px
    u, v = pixels[..., [0, 2]], pixels[..., 1]
    # Pixel centres are whole numbers, so the image reaches half a pixel beyond them.
    inside = ((u >= -0.5) & (u <= width - 0.5)).all(axis=-1) & (v >= -0.5) & (v <= height - 0.5)
    return np.asarray(before & inside)


def _pointed(table: StereoTable, r_hill: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n, 3, 3) R_rig_hill."""
    offset = exp_rotation(np.deg2rad(table.pointing_error_deg) * rng.standard_normal(3))
    if table.pointing is Boresight.TARGET:
        return np.asarray(offset @ R_cam_hill(r_hill))
    fixed = R_cam_hill(np.array(table.boresight_hill))
    return np.broadcast_to(fixed, (len(r_hill), 3, 3))


def _lit(table: FeaturesTable, times_s: FloatArray) -> BoolArray:
    """(n,) whether a time lies outside all blackouts."""
    lit = np.ones(len(times_s), dtype=np.bool_)
    for start, end in table.blackouts_s:
        lit &= (times_s < start) | (times_s >= end)
    return lit


def _tracked(
    table: FeaturesTable, times_s: FloatArray, count: int, rng: np.random.Generator
) -> BoolArray:
    """(n, N) whether every track is alive: it is lost and found again at constant rates."""
    alive = np.ones((len(times_s), count), dtype=np.bool_)
    if table.mean_tracked_s is None:
        return alive
    steps = np.diff(times_s, prepend=times_s[0])
    lost = 1.0 - np.exp(-steps / table.mean_tracked_s)
    found = 1.0 - np.exp(-steps / table.mean_lost_s)
    draws = rng.uniform(size=alive.shape)
    for k in range(1, len(alive)):
        alive[k] = np.where(alive[k - 1], draws[k] >= lost[k], draws[k] < found[k])
    return alive


def _facing(
    table: FeaturesTable, points: FloatArray, R_hill_body: FloatArray, p_hill: FloatArray
) -> BoolArray:
    """(n, N) whether a point's normal is within the largest angle of the direction to the rig."""
    normals = np.array(table.normals_body) if table.normals_body else points
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    normals_hill = normals @ np.swapaxes(R_hill_body, 1, 2)
    cosine = -np.sum(normals_hill * p_hill, axis=-1) / np.linalg.norm(p_hill, axis=-1)
    return np.asarray(cosine > np.cos(np.deg2rad(table.max_view_angle_deg)))


def _mismatched(
    fraction: float,
    rig: StereoRig,
    pixels: FloatArray,
    seen: BoolArray,
    rng: np.random.Generator,
) -> FloatArray:
    """(n, N, 4) the pixels with a share of those seen replaced by those of something else.

    Half of them are the pixels of another feature of the frame, where there is one; the others lie
    anywhere in the image, at a distance of the same order.
    """
    if fraction == 0.0:
        return pixels
    wrong = seen & (rng.uniform(size=seen.shape) < fraction)
    changed = pixels.copy()
    width, height = rig.size_px
    for k, i in zip(*np.nonzero(wrong), strict=True):
        others = np.flatnonzero(seen[k] & (np.arange(seen.shape[1]) != i))
        if len(others) and rng.uniform() < 0.5:
            changed[k, i] = pixels[k, rng.choice(others)]
            continue
        disparity = float(rig.disparity(pixels[k, i])) * rng.uniform(0.7, 1.4)
        u, v = rng.uniform(disparity, max(width, disparity + 1.0)), rng.uniform(0.0, height)
        changed[k, i] = [u, v, u - disparity, v + rig.pixel_sigma_px * rng.standard_normal()]
    return changed
