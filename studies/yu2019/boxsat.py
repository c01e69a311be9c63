"""Ray-cast frames of a whole satellite: single-frame poses, and the filter on a sequence."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import NoiseTable
from pcnav.config.shipped import shipped_mesh
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import log_rotation, make_transform
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
)
from pcnav.estimators.depth.single_frame import single_frame_pose
from pcnav.estimators.depth.tracker import Tracker
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.files.text_table import TextTable, number
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.simulation.noise import add_sensor_faults
from pcnav.simulation.scenario import pinhole_camera, true_motion
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target, load_target

from ..progress import Progress

NOISES_M = (0.1, 0.02)
_MODES = (PerceptionMode.PAPER, PerceptionMode.AREA_WEIGHTED)
_OFF_AXIS_M = 0.5
_WRONG_RAD = 0.35
"""A pose further off than this is another hypothesis, not an error of measurement."""
_BLOCKS = (
    ("position", "mm", R_HILL, 1e3),
    ("velocity", "mm/s", V_HILL, 1e3),
    ("mass centre", "mm", COM_MODEL, 1e3),
    ("attitude", "deg", THETA_BODY, float(np.rad2deg(1.0))),
    ("rate", "deg/s", OMEGA_BODY, float(np.rad2deg(1.0))),
    ("inertia ratios", "1", INERTIA_RATIOS, 1.0),
)


@dataclass(frozen=True)
class PoseErrors:
    """Single-frame poses of the whole satellite at random attitudes."""

    mode: PerceptionMode
    noise_m: float
    frames: int
    none: int
    """Frames without any pose."""
    wrong: int
    """Frames whose best hypothesis was another attitude."""
    position_m: FloatArray
    """(n,) of the model origin, in the others."""
    attitude_rad: FloatArray
    """(n,)"""
    faces: FloatArray
    """(n,) rectangles each pose rests on."""


@dataclass(frozen=True)
class SequenceErrors:
    """A filter on a sequence of ray-cast frames."""

    mode: PerceptionMode
    noise_m: float
    time_s: FloatArray
    """(n,) of all frames."""
    errors: FloatArray
    """(n, 20), nan in frames without an estimate."""
    pose_m: FloatArray
    """(n,) error of the model origin in the camera, nan likewise."""
    nees: FloatArray
    """(n,) per degree of freedom, nan likewise."""
    statuses: tuple[str, ...]
    rectangles: float
    """Mean number of rectangles accepted in frames with an estimate."""


def satellite(pipeline: Pipeline) -> Target:
    """The pipeline's satellite, a shipped one. Raises `InputError` when there is none."""
    name = pipeline.target_mesh or ""
    mesh = shipped_mesh(name)
    if mesh is None:
        raise InputError("yu2019_boxsat.toml", "target_mesh", "expected a shipped satellite")
    return load_target(mesh)


def settings_of(pipeline: Pipeline, mode: PerceptionMode) -> PerceptionTable:
    """Rectangles in either mode, whatever frames are measured by elsewhere: they are compared."""
    change = {"mode": mode, "measurements": Measurements.RECTANGLES}
    return pipeline.perception.model_copy(update=change)


@dataclass(frozen=True)
class _Setting:
    """One mode at one noise level, over so many frames."""

    pipeline: Pipeline
    noise_m: float
    mode: PerceptionMode
    count: int

    def __str__(self) -> str:
        return f"{self.pipeline.target_mesh}, {self.noise_m:g} m, {self.mode}"


def _settings(pipeline: Pipeline, count: int) -> list[_Setting]:
    return [_Setting(pipeline, noise_m, mode, count) for noise_m in NOISES_M for mode in _MODES]


def pose_errors(
    count: int, pipeline: Pipeline, workers: Workers, progress: Progress
) -> list[PoseErrors]:
    """Both modes at both noise levels, on the same random attitudes."""
    settings, share = _settings(pipeline, count), 0.8 * count
    return run_all(_pose_errors, settings, workers, lambda: progress.add(share))


def _pose_errors(setting: _Setting) -> PoseErrors:
    count, pipeline = setting.count, setting.pipeline
    noise_m, mode, target = setting.noise_m, setting.mode, satellite(pipeline)
    camera = pinhole_camera(pipeline.camera)
    renderer = DepthRenderer(target.mesh, camera)
    settings = settings_of(pipeline, mode)
    reader = FrameReader(target, settings, noise_m, pipeline.seed)
    noise = NoiseTable(range_sigma_m=noise_m, quantisation_m=pipeline.noise.quantisation_m)
    none = wrong = 0
    position, attitude, faces = [], [], []
    for k, T_true in enumerate(_random_poses(count, pipeline)):
        depth_m = add_sensor_faults(renderer.render(T_true), noise, pipeline.seed, k)
        frame = Frame(k, 0.0, depth_m, camera, np.eye(4))
        pose = single_frame_pose(frame, reader)
        if pose is None:
            none += 1
            continue
        turn = float(np.linalg.norm(log_rotation(pose.T_cam_model[:3, :3].T @ T_true[:3, :3])))
        if turn > _WRONG_RAD:
            wrong += 1
            continue
        position.append(np.linalg.norm(pose.T_cam_model[:3, 3] - T_true[:3, 3]))
        attitude.append(turn)
        faces.append(len(pose.used))
    return PoseErrors(
        mode, noise_m, count, none, wrong, np.array(position), np.array(attitude), np.array(faces)
    )


def _random_poses(count: int, pipeline: Pipeline) -> list[FloatArray]:
    generator = np.random.default_rng([pipeline.seed, 2])
    range_m = float(np.linalg.norm(pipeline.orbit.r_hill_m))
    attitudes = Rotation.random(count, rng=generator).as_matrix()
    off_axis = generator.uniform(-_OFF_AXIS_M, _OFF_AXIS_M, (count, 2))
    return [
        make_transform(R, np.array([*p, range_m])) for R, p in zip(attitudes, off_axis, strict=True)
    ]


def pose_table(errors: list[PoseErrors]) -> TextTable:
    """Median and RMS errors by noise and mode."""
    rows = []
    for each in errors:
        mm, deg = 1e3 * each.position_m, np.rad2deg(each.attitude_rad)
        rows.append(
            (
                number(each.noise_m),
                str(each.mode),
                str(each.frames),
                str(each.none),
                str(each.wrong),
                *(_statistic(values, name) for values in (mm, deg) for name in ("median", "rms")),
                _statistic(each.faces, "mean"),
            )
        )
    header = (
        "noise, m",
        "mode",
        "frames",
        "no pose",
        "wrong hypothesis",
        "position median, mm",
        "position RMS, mm",
        "attitude median, deg",
        "attitude RMS, deg",
        "faces used",
    )
    return TextTable(
        "boxsat_single_frame",
        "The whole satellite at 25 m, one ray-cast frame, no prediction",
        header,
        tuple(rows),
        "Random attitudes. Errors are those of the frames with the right hypothesis (within 20 "
        "degrees); the others are counted. Position is that of the model's origin.",
        text_columns=2,
    )


def _statistic(values: FloatArray, name: str) -> str:
    if values.size == 0:
        return "-"
    of = {
        "median": np.median(values),
        "rms": np.sqrt(np.mean(values.astype(np.float64) ** 2)),
        "mean": np.mean(values),
    }
    return number(float(of[name]))


def sequence_errors(
    pipeline: Pipeline, workers: Workers, progress: Progress
) -> list[SequenceErrors]:
    """The filter on the pipeline's sequence in both modes at both noise levels."""
    frames = pipeline.scenario.frames
    settings, share = _settings(pipeline, frames), 0.08 * frames
    return run_all(_sequence_errors, settings, workers, lambda: progress.add(share))


def _sequence_errors(setting: _Setting) -> SequenceErrors:
    pipeline, noise_m, mode = setting.pipeline, setting.noise_m, setting.mode
    target = satellite(pipeline)
    motion = true_motion(pipeline, "yu2019_boxsat.toml")
    camera = pinhole_camera(pipeline.camera)
    renderer = DepthRenderer(target.mesh, camera)
    noise = pipeline.noise.model_copy(update={"range_sigma_m": noise_m})
    settings = settings_of(pipeline, mode)
    info = SequenceInfo("yu2019", pipeline.orbit.mean_motion_rad_s, noise_m, target.mesh_path)
    tracker = Tracker(target, info, settings, pipeline.filter, pipeline.seed)
    n = len(motion.times_s)
    errors = np.full((n, STATE_SIZE), np.nan)
    pose_m, nees, rectangles, statuses = np.full(n, np.nan), np.full(n, np.nan), [], []
    for k in range(n):
        T_true = motion.T_cam_model(k)
        depth_m = add_sensor_faults(renderer.render(T_true), noise, pipeline.seed, k)
        frame = Frame(k, float(motion.times_s[k]), depth_m, camera, motion.T_cam_world[k])
        estimate, _ = tracker.step(frame)
        statuses.append(estimate.status)
        if estimate.state is not None and estimate.T_cam_model is not None:
            errors[k] = estimate.state.ratio_error(motion.states[k])
            pose_m[k] = np.linalg.norm(estimate.T_cam_model[:3, 3] - T_true[:3, 3])
            assert estimate.covariance is not None, "state and covariance come together"
            squared = squared_normalised_errors(errors[k : k + 1], estimate.covariance[None])
            nees[k] = squared[0] / STATE_SIZE
            rectangles.append(estimate.n_rectangles)
    mean = float(np.mean(rectangles)) if rectangles else 0.0
    return SequenceErrors(
        mode, noise_m, motion.times_s, errors, pose_m, nees, tuple(statuses), mean
    )


def sequence_table(sequences: list[SequenceErrors]) -> TextTable:
    """Median error norms over the last third, and how the track went."""
    rows = []
    for each in sequences:
        last = slice(2 * len(each.time_s) // 3, None)
        cells = []
        for _, _, block, scale in _BLOCKS:
            norms = scale * np.linalg.norm(each.errors[last, block], axis=1)
            cells.append(_statistic(norms[np.isfinite(norms)], "median"))
        pose, nees = each.pose_m[last], each.nees[last]
        locked = np.mean([status == "locked" for status in each.statuses])
        found = np.flatnonzero(np.isfinite(each.pose_m))
        rows.append(
            (
                number(each.noise_m),
                str(each.mode),
                f"{each.time_s[found[0]]:.1f}" if found.size else "-",
                f"{locked:.0%}",
                number(each.rectangles),
                _statistic(1e3 * pose[np.isfinite(pose)], "median"),
                *cells,
                _statistic(nees[np.isfinite(nees)], "median"),
            )
        )
    header = (
        "noise, m",
        "mode",
        "first estimate, s",
        "frames locked",
        "rectangles",
        "model origin, mm",
        *(f"{name}, {unit}" if unit != "1" else name for name, unit, _, _ in _BLOCKS),
        "NEES",
    )
    return TextTable(
        "boxsat_filter",
        "The filter on ray-cast frames of the whole satellite: median error, last third",
        header,
        tuple(rows),
        f"{len(sequences[0].time_s)} frames at "
        f"{1.0 / (sequences[0].time_s[1] - sequences[0].time_s[0]):g} Hz. NEES per degree of "
        "freedom, median.",
        text_columns=2,
    )
