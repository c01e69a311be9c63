"""Ray-cast frames of a panel and of a whole satellite: what a depth camera gives the method."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pcnav.batch.monte_carlo import Case, Run
from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.core.statistics import mean, percentile, root_mean_square
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.depth.single_frame import single_frame_pose
from pcnav.files.text_table import TextTable
from pcnav.perception.association import as_rectangle
from pcnav.perception.perceive import perceive
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame
from pcnav.report.panels import panels_figure
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import TrueMotion
from pcnav.simulation.random_truth import satellite
from pcnav.target.catalogue import Rectangle
from pcnav.target.satellite import Target

from ..blocks import BLOCKS, WHOLE
from ..folder import StudyFigure
from ..following import JudgedRun, follow
from ..panels import error_panel
from ..tables import Claim, as_printed, below, table, table_of

_READ = tuple(product((0.1, 0.02), (PerceptionMode.PAPER, PerceptionMode.AREA_WEIGHTED)))
"""Noises and modes: the paper's noise first."""
_POSITION_GOAL_MM, _ATTITUDE_GOAL_DEG = 10.0, 0.2
_PANEL_FRAMES_PER_RUN, _RUNS_PER_SATELLITE_FRAME = 3, 2
_PANEL_WORK, _SATELLITE_WORK, _SEQUENCE_WORK = 0.03, 0.8, 0.08
"""Of a frame."""
_MAX_NEES = 2.0
"""Median over the last third of a run, over its degrees of freedom: of a right one it is 1."""
MAX_INCIDENCE_DEG = 70.0
_PANEL_OFF_AXIS_M, _SATELLITE_OFF_AXIS_M = 1.0, 0.5
_GUESS_RAD = (0.1, -0.05, 0.08)
"""How far the prediction that solves the ambiguity of the panel is off."""
_FLIPPED_RAD = 0.5 * np.pi
_WRONG_RAD = 0.35
"""A pose of the satellite further off than this is another hypothesis, not an error of
measurement."""

PANEL = Rectangle(
    name="panel",
    T_model_rect=make_transform(np.eye(3), np.zeros(3)),
    length_m=4.0,
    width_m=1.5,
    two_sided=True,
)


@dataclass(frozen=True)
class Setting:
    """A sensor and a way to read its frames."""

    pipeline: Pipeline
    noise_m: float
    mode: PerceptionMode
    frames: int


@dataclass(frozen=True)
class PoseErrors:
    """Errors of poses from single frames, axes of the target."""

    setting: Setting
    position_m: FloatArray
    """(n, 3)"""
    attitude_rad: FloatArray
    """(n, 3)"""
    support: FloatArray
    """(n,) of the panel the deviation (rad) that the measurement states of the attitude, root of
    the summed variances; of the satellite the number of rectangles each pose rests on."""

    @property
    def angle_rad(self) -> FloatArray:
        """(n,) of the attitude's error."""
        return np.asarray(np.linalg.norm(self.attitude_rad, axis=1))

    @property
    def position_mm(self) -> FloatArray:
        """(n,) length of the position's error."""
        return np.asarray(1e3 * np.linalg.norm(self.position_m, axis=1))

    @property
    def none(self) -> int:
        """Frames without any pose."""
        return self.setting.frames - len(self.position_m)

    @property
    def right(self) -> "PoseErrors":
        """Those of the frames whose hypothesis was the right one."""
        kept = self.angle_rad <= _WRONG_RAD
        return PoseErrors(
            self.setting, self.position_m[kept], self.attitude_rad[kept], self.support[kept]
        )


def _runs(name: str, pipeline: Pipeline, frames: int, work: float) -> list[Run[Setting]]:
    settings = (Setting(pipeline, noise_m, mode, frames) for noise_m, mode in _READ)
    return [
        Run(Case(f"{name}, {each.noise_m:g} m, {each.mode}", each, work * frames), 0, pipeline.seed)
        for each in settings
    ]


def panel_runs(pipeline: Pipeline, runs: int) -> list[Run[Setting]]:
    """Single frames of the panel: both modes at both noise levels, on the same attitudes."""
    return _runs("panel", pipeline, _PANEL_FRAMES_PER_RUN * runs, _PANEL_WORK)


def satellite_runs(pipeline: Pipeline, runs: int) -> list[Run[Setting]]:
    """Single frames of the satellite likewise."""
    frames = max(1, runs // _RUNS_PER_SATELLITE_FRAME)
    return _runs("boxsat", pipeline, frames, _SATELLITE_WORK)


def sequence_runs(pipeline: Pipeline) -> list[Run[Setting]]:
    """The filter on the pipeline's sequence likewise."""
    return _runs("boxsat sequence", pipeline, pipeline.scenario.frames, _SEQUENCE_WORK)


Measure = Callable[[Frame, FloatArray], tuple[FloatArray, float] | None]
"""From a frame and its true pose (4, 4) to the measured one and its support; None without any. The
truth serves to solve the ambiguity of a single rectangle only."""


def panel_errors(run: Run[Setting]) -> PoseErrors:
    """Single frames of the panel: the plane seen first."""
    setting, seed = run.case.settings, run.seed
    perception = PerceptionTable(mode=setting.mode)
    turn = make_transform(exp_rotation(np.array(_GUESS_RAD)), np.zeros(3))

    def measure(frame: Frame, T_true: FloatArray) -> tuple[FloatArray, float] | None:
        perceived = perceive(frame, (PANEL,), perception, setting.noise_m, seed)
        if not perceived.seen:
            return None
        face = as_rectangle(perceived.seen[0], PANEL, T_true @ turn)
        return face.T_cam_rect, float(np.sqrt(np.trace(face.covariance[3:, 3:])))

    return _pose_errors(setting, _sheet(), _panel_poses(setting), measure)


def satellite_errors(run: Run[Setting]) -> PoseErrors:
    """Single frames of the satellite, without any prediction."""
    setting, target = run.case.settings, target_of(run.case.settings.pipeline)
    perception = settings_of(setting.pipeline, setting.mode)
    reader = FrameReader(target, perception, setting.noise_m, run.seed)

    def measure(frame: Frame, T_true: FloatArray) -> tuple[FloatArray, float] | None:
        pose = single_frame_pose(frame, reader)
        return None if pose is None else (pose.T_cam_model, float(len(pose.used)))

    return _pose_errors(setting, target.mesh, _satellite_poses(setting), measure)


def follow_sequence(run: Run[Setting]) -> tuple[Setting, JudgedRun]:
    """The filter on a sequence of the satellite."""
    setting = run.case.settings
    pipeline = setting.pipeline
    noise = pipeline.noise.model_copy(update={"range_sigma_m": setting.noise_m})
    changes = {"noise": noise, "perception": settings_of(pipeline, setting.mode)}
    target = target_of(pipeline)
    scene = Scene.of(pipeline.model_copy(update=changes), target.mesh)
    return setting, follow(scene, target)


def target_of(pipeline: Pipeline) -> Target:
    """The pipeline's satellite, a shipped one. Raises `InputError` when there is none."""
    return satellite(pipeline.target_mesh or "").target


def settings_of(pipeline: Pipeline, mode: PerceptionMode) -> PerceptionTable:
    """Rectangles in either mode, whatever frames are measured by elsewhere: they are compared."""
    change = {"mode": mode, "measurements": Measurements.RECTANGLES}
    return pipeline.perception.model_copy(update=change)


def _pose_errors(
    setting: Setting, mesh: trimesh.Trimesh, poses: Sequence[FloatArray], measure: Measure
) -> PoseErrors:
    noise = NoiseTable(
        range_sigma_m=setting.noise_m, quantisation_m=setting.pipeline.noise.quantisation_m
    )
    still = np.tile(np.eye(4), (len(poses), 1, 1))
    truth = Trajectory(np.zeros(len(poses)), POSE_LAYOUT, T_cam_target=np.stack(poses))
    motion = TrueMotion(truth, still, still[:, :3, :3])
    scene = Scene(setting.pipeline.model_copy(update={"noise": noise}), motion, mesh)
    measured = [(T, measure(frame, T)) for T, frame in zip(poses, scene.frames(), strict=True)]
    found = [(T_true, *each) for T_true, each in measured if each is not None]
    position = [T_true[:3, :3].T @ (T[:3, 3] - T_true[:3, 3]) for T_true, T, _ in found]
    attitude = [log_rotation(T_true[:3, :3].T @ T[:3, :3]) for T_true, T, _ in found]
    return PoseErrors(
        setting,
        np.array(position).reshape(-1, 3),
        np.array(attitude).reshape(-1, 3),
        np.array([support for *_, support in found]),
    )


def _sheet() -> trimesh.Trimesh:
    corners = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=np.float64)
    corners *= [PANEL.width_m, PANEL.length_m, 1.0]
    return trimesh.Trimesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), process=False)


def _panel_poses(setting: Setting) -> list[FloatArray]:
    """Random attitudes under the largest incidence, centres up to a metre off the boresight."""
    generator = np.random.default_rng(setting.pipeline.seed)
    least = np.cos(np.deg2rad(MAX_INCIDENCE_DEG))
    range_m = float(np.linalg.norm(setting.pipeline.orbit.r_hill_m))
    poses: list[FloatArray] = []
    while len(poses) < setting.frames:
        R = Rotation.random(rng=generator).as_matrix()
        if abs(R[2, 2]) < least:
            continue
        off_axis = generator.uniform(-_PANEL_OFF_AXIS_M, _PANEL_OFF_AXIS_M, 2)
        poses.append(make_transform(R, np.array([*off_axis, range_m])))
    return poses


def _satellite_poses(setting: Setting) -> list[FloatArray]:
    generator = np.random.default_rng([setting.pipeline.seed, 2])
    range_m = float(np.linalg.norm(setting.pipeline.orbit.r_hill_m))
    attitudes = Rotation.random(setting.frames, rng=generator).as_matrix()
    limit = _SATELLITE_OFF_AXIS_M
    off_axis = generator.uniform(-limit, limit, (setting.frames, 2))
    return [
        make_transform(R, np.array([*p, range_m])) for R, p in zip(attitudes, off_axis, strict=True)
    ]


@dataclass(frozen=True)
class RayCast:
    """All that was found on ray-cast frames."""

    panel: Sequence[PoseErrors]
    satellite: Sequence[PoseErrors]
    sequences: Sequence[tuple[Setting, JudgedRun]]

    @property
    def best_panel(self) -> PoseErrors:
        """At the paper's noise, area-weighted."""
        return self.panel[1]


def tables(found: RayCast) -> list[TextTable]:
    """Single frames of a panel and of a satellite, and the filter on a sequence of the latter."""
    return [
        _panel_table(found.panel),
        _satellite_table(found.satellite),
        _sequence_table(found.sequences),
    ]


def figures(found: RayCast) -> list[StudyFigure]:
    """The sequences with an estimate, area-weighted."""
    return [
        _figure(setting, run)
        for setting, run in found.sequences
        if setting.mode is PerceptionMode.AREA_WEIGHTED and np.isfinite(run.position_m).any()
    ]


def claims(found: RayCast) -> list[Claim]:
    """The panel's errors against what the paper prints for its idealised cloud."""
    panel = found.best_panel
    worst = np.rad2deg(_axes_rms(panel.attitude_rad).max())
    position, angle = (
        root_mean_square(panel.position_mm),
        np.rad2deg(root_mean_square(panel.angle_rad)),
    )
    return [
        as_printed("ray-cast", f"panel, 0.1 m: {name}", goal, ours)
        for name, goal, ours in (
            ("position RMS, mm", _POSITION_GOAL_MM, position),
            ("attitude RMS, worst axis, deg", _ATTITUDE_GOAL_DEG, worst),
            ("attitude RMS, whole angle, deg", _ATTITUDE_GOAL_DEG, angle),
        )
    ] + [
        below(
            "ray-cast",
            f"NEES of the filter, {setting.mode}, {setting.noise_m:g} m, over its degrees of "
            "freedom",
            [percentile(run.nees(WHOLE)[2 * len(run) // 3 :] / WHOLE.size, 50)],
            _MAX_NEES,
        )
        for setting, run in found.sequences
    ]


_READ_COLUMNS: dict[str, Callable[[PoseErrors], object]] = {
    "noise, m": lambda e: e.setting.noise_m,
    "mode": lambda e: e.setting.mode,
}


def _panel_table(errors: Sequence[PoseErrors]) -> TextTable:
    return table_of(
        "panel",
        errors,
        {
            **_READ_COLUMNS,
            "frames": lambda e: len(e.position_m),
            "position RMS, mm": lambda e: root_mean_square(e.position_mm),
            "short / long / normal, mm": lambda e: 1e3 * _axes_rms(e.position_m),
            "attitude RMS, deg": lambda e: np.rad2deg(root_mean_square(e.angle_rad)),
            "about short / long / normal, deg": lambda e: np.rad2deg(_axes_rms(e.attitude_rad)),
            "stated attitude RMS, deg": lambda e: np.rad2deg(root_mean_square(e.support)),
            "wrong case": lambda e: np.count_nonzero(e.angle_rad > _FLIPPED_RAD),
            "missed": lambda e: e.none,
        },
        text_columns=2,
    )


def _axes_rms(errors: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0)))


def _satellite_table(errors: Sequence[PoseErrors]) -> TextTable:
    return table_of(
        "boxsat_single_frame",
        errors,
        {
            **_READ_COLUMNS,
            "frames": lambda e: e.setting.frames,
            "no pose": lambda e: e.none,
            "wrong hypothesis": lambda e: len(e.position_m) - len(e.right.position_m),
            "position median, mm": lambda e: percentile(e.right.position_mm, 50),
            "position RMS, mm": lambda e: root_mean_square(e.right.position_mm),
            "attitude median, deg": lambda e: np.rad2deg(percentile(e.right.angle_rad, 50)),
            "attitude RMS, deg": lambda e: np.rad2deg(root_mean_square(e.right.angle_rad)),
            "faces used": lambda e: mean(e.right.support),
        },
        text_columns=2,
    )


def _sequence_table(sequences: Sequence[tuple[Setting, JudgedRun]]) -> TextTable:
    rows = []
    for setting, run in sequences:
        last = slice(2 * len(run) // 3, None)
        found = np.isfinite(run.position_m)
        norms = (np.linalg.norm(b.shown(run.state_error[last]), axis=1) for b in BLOCKS.values())
        rows.append(
            (
                *(setting.noise_m, setting.mode),
                f"{run.time_s[found][0]:.1f}" if found.any() else None,
                f"{np.mean([status == 'locked' for status in run.said.status]):.0%}",
                run.said.notes["n_rectangles"][found].mean() if found.any() else 0.0,
                percentile(1e3 * run.position_m[last], 50),
                *(percentile(values, 50) for values in norms),
                percentile(run.nees(WHOLE)[last] / WHOLE.size, 50),
            )
        )
    return table(
        "boxsat_filter",
        (
            *("noise, m", "mode", "first estimate, s", "frames locked", "rectangles"),
            *("model origin, mm", *(block.label for block in BLOCKS.values()), "NEES"),
        ),
        rows,
        text_columns=2,
    )


def _figure(setting: Setting, run: JudgedRun) -> StudyFigure:
    found = np.isfinite(run.position_m)
    centre = BLOCKS["mass centre"].shown(run.state_error[found])
    half = int(np.count_nonzero(found)) // 2
    panels = [error_panel("model origin, mm", 1e3 * run.position_m[found], settled_from=half)]
    panels += [
        error_panel(f"mass centre {axis}, mm", centre[:, k], settled_from=half)
        for k, axis in enumerate("xyz")
    ]
    return StudyFigure(
        f"boxsat_{1e3 * setting.noise_m:03.0f}mm", panels_figure(run.time_s[found], panels)
    )
