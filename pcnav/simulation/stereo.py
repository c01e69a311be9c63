"""Feature points of a tumbling target as a stereo rig sees them, with the faults of real tracks."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import OrbitModel
from pcnav.config.sensors import Boresight, FeaturesTable, StereoTable
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import R_cam_hill
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.blocks import ATTITUDE, POSITION
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.state import NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.stereo_tracks import write_stereo_tracks
from pcnav.recordings.tracks import StereoTracks, TrackFrame
from pcnav.simulation.motion import (
    disturbed_orbit,
    disturbed_rotation,
    frame_times,
    start_of,
    trajectory_of,
)
from pcnav.simulation.simulation import OnFrame, Simulation, features_seen

_NEAREST_M = 0.1
"""Nothing closer to the plane of the two cameras than this is seen."""


@dataclass(frozen=True)
class StereoScenario:
    """What is simulated; `dataclasses.replace` and `model_copy` make variants of it."""

    name: str
    times_s: FloatArray
    """(n,) increasing; world equals Hill at time 0."""
    orbit: KeplerOrbit
    orbit_model: OrbitModel
    start: NavigationState
    """At the first time."""
    stereo: StereoTable
    features: FeaturesTable


def simulate_stereo(
    pipeline: Pipeline, source: Path | str = "pipeline", target_mesh: Path | None = None
) -> Simulation[StereoTracks]:
    """Tracks of a pipeline's scenario; the same pipeline, the same numbers. A mesh is not needed.

    ``source`` is the pipeline's file, which an `InputError` names.
    """
    return simulate_tracks(stereo_scenario(pipeline, source), np.random.default_rng(pipeline.seed))


def stereo_scenario(pipeline: Pipeline, source: Path | str = "pipeline") -> StereoScenario:
    """The scenario of a pipeline file. ``source`` is what an `InputError` names."""
    if np.any(pipeline.body.com_model):
        expected = "expected 0, 0, 0: feature points are given from the mass centre"
        raise InputError(source, "body.com_model_m", expected)
    return StereoScenario(
        name=Path(source).stem,
        times_s=frame_times(pipeline),
        orbit=pipeline.orbit.kepler,
        orbit_model=pipeline.orbit.model,
        start=start_of(pipeline),
        stereo=pipeline.stereo,
        features=pipeline.features,
    )


def simulate_tracks(scenario: StereoScenario, rng: np.random.Generator) -> Simulation[StereoTracks]:
    """Tracks of a scenario and the truth behind them.

    Points, motion, pointing, tracking and noise draw from streams of their own: two scenarios that
    differ in one of them share the draws of the others.
    """
    on_points, on_motion, on_tracks = rng.spawn(3)
    points = draw_points(scenario.features, on_points)
    truth = simulate_motion(scenario, on_motion)
    return with_truth(observe(scenario, truth, points, on_tracks), truth, points)


def with_truth(
    tracks: StereoTracks, truth: Trajectory, points: FloatArray
) -> Simulation[StereoTracks]:
    """Tracks of points (N, 3) that were observed in a true motion."""

    def store(out: Path, overwrite: bool, on_frame: OnFrame | None) -> str:
        write_stereo_tracks(out, tracks, truth, points, overwrite)
        seen = features_seen(out, tracks)
        return (
            f"tracks: {out} ({len(seen)} frames, {int((seen == 0).sum())} of them empty; "
            f"median of {float(np.median(seen)):g} of {len(points)} features each)"
        )

    return Simulation(tracks, truth, store, points)


def draw_points(table: FeaturesTable, rng: np.random.Generator) -> FloatArray:
    """(N, 3) points in body axes, m: those listed, or uniform in the cube (Segal 2011 (15))."""
    if table.points_m:
        return np.array(table.points_m)
    return rng.uniform(-table.half_extent_m, table.half_extent_m, (table.count, 3))


def simulate_motion(scenario: StereoScenario, rng: np.random.Generator) -> Trajectory:
    """The true motion of a scenario."""
    table, times_s, start = scenario.features, scenario.times_s, scenario.start
    on_orbit, on_body = rng.spawn(2)
    orbit = disturbed_orbit(
        *(scenario.orbit_model, scenario.orbit, start, times_s),
        *(table.acceleration_psd_m2_s3, on_orbit),
    )
    R, omega = disturbed_rotation(start, times_s, table.angular_acceleration_psd_rad2_s3, on_body)
    return trajectory_of(times_s, start, orbit, R, omega)


def observe(
    scenario: StereoScenario, truth: Trajectory, points: FloatArray, rng: np.random.Generator
) -> StereoTracks:
    """What the rig of a scenario sees of points (N, 3), body axes, in a true motion."""
    pointing, tracking, noise, matching = rng.spawn(4)
    table, rig, times_s = scenario.features, scenario.stereo.rig, truth.time_s
    R_hill_world = np.stack([scenario.orbit.R_hill_world(t) for t in times_s])
    R_hill_body = R_hill_world @ truth[ATTITUDE]
    R_rig_hill = _pointed(scenario.stereo, truth[POSITION], pointing)
    from_centre = points @ np.swapaxes(R_hill_body, 1, 2)
    p_hill = truth[POSITION][:, None] + from_centre
    p_rig = p_hill @ np.swapaxes(R_rig_hill, 1, 2)
    seen = (
        in_view(rig, p_rig)
        & table.is_lit(times_s)[:, None]
        & _tracked(table, times_s, len(points), tracking)
    )
    if table.hidden_by_normals:
        seen &= _facing(table, points, R_hill_body, p_hill)
    pixels = np.full((*p_rig.shape[:2], 4), np.nan)
    pixels[seen] = rig.project(p_rig[seen])
    pixels += rig.pixel_sigma_px * noise.standard_normal(pixels.shape)
    pixels = _mismatched(table.wrong_match_fraction, rig, pixels, seen, matching)
    # No matcher pairs a point with one behind the rig.
    seen &= rig.disparity(np.where(seen[..., None], pixels, 0.0)) > 0.0
    frames = tuple(
        TrackFrame(float(t), R, np.flatnonzero(visible), row[visible])
        for t, R, visible, row in zip(times_s, R_rig_hill @ R_hill_world, seen, pixels, strict=True)
    )
    return StereoTracks(scenario.name, rig, scenario.orbit, frames)


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
