"""Depth frames of a scenario: rendered one by one, with the faults of a sensor."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import pixels_without_ray
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform, nearest_orthogonal
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.depth_png import MAXIMUM_UNITS
from pcnav.recordings.first_pose import POSITION_SD_SHARE
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.scan import Scan, grid_of
from pcnav.recordings.sequence import FirstPosePrior, Frame, SequenceInfo
from pcnav.recordings.writer import write_sequence
from pcnav.simulation.camera_pose import recorded_poses
from pcnav.simulation.footprint import FootprintSampler
from pcnav.simulation.miscalibration import Miscalibration, stated_calibration
from pcnav.simulation.motion import TrueMotion, frame_times, true_motion
from pcnav.simulation.noise import add_sensor_faults
from pcnav.simulation.readout import RowTimes
from pcnav.simulation.scan_patterns import Pattern, pattern_of
from pcnav.simulation.scans import FineMotion, Scanner
from pcnav.simulation.simulation import OnFrame, Simulation, counted
from pcnav.simulation.stamps import recorded_times
from pcnav.simulation.surroundings.part import Part
from pcnav.simulation.surroundings.scenery import scenery
from pcnav.simulation.surroundings.view import SceneRenderer
from pcnav.simulation.systematic import SystematicErrors
from pcnav.target.satellite import Target, load_target

_FIRST_POSE_STREAM = 5
"""Beside the seed: whether a first pose is stated changes no frame."""
_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class Scene:
    """A motion, the sensor that sees it and the body that is there; not the target as modelled.

    It is a recording in memory, whose frames are rendered when they are asked for.
    """

    kind: ClassVar[RecordingKind] = RecordingKind.DEPTH
    name: ClassVar[str] = "simulated"
    path: ClassVar[None] = None

    pipeline: Pipeline
    motion: TrueMotion
    mesh: trimesh.Trimesh
    """The target as it is, model frame, m."""
    parts: tuple[Part, ...] = ()
    """What else the frames show."""
    mesh_path: Path | None = None
    """The file of the target's mesh, which a recording on disk is given."""

    @staticmethod
    def of(pipeline: Pipeline, mesh: trimesh.Trimesh, source: Path | str = "pipeline") -> "Scene":
        """The scene of a pipeline. ``source`` is the file that an `InputError` names."""
        scans = pipeline.scan.is_used
        motion = FineMotion.of(pipeline, source)[1] if scans else true_motion(pipeline, source)
        mesh = Miscalibration.of(pipeline).true_mesh(mesh)
        parts = scenery(pipeline, motion, mesh, source)
        # The truth of a frame is that of its true time, under the time that is recorded.
        times_s = recorded_times(motion.truth.time_s, pipeline.noise, pipeline.seed, source)
        motion = replace(motion, truth=replace(motion.truth, time_s=times_s))
        return Scene(pipeline, motion, mesh, parts)

    @staticmethod
    def showing(target: Target, pipeline: Pipeline, source: Path | str = "pipeline") -> "Scene":
        """As `of`, of a target whose mesh a recording on disk is given."""
        return replace(Scene.of(pipeline, target.mesh, source), mesh_path=target.mesh_path)

    @property
    def truth(self) -> Trajectory:
        """All blocks and poses at every frame."""
        return self.motion.truth

    @property
    def simulation(self) -> "Simulation[Scene]":
        """Itself with its truth."""
        return Simulation(self, self.truth, self.write)

    @property
    def info(self) -> SequenceInfo:
        """What a recording of the scene states."""
        pipeline = self.pipeline
        distance_m = float(np.linalg.norm(pipeline.orbit.r_hill_m))
        scans = pipeline.scan.is_used
        return SequenceInfo(
            self.name,
            pipeline.orbit.mean_motion_rad_s,
            stated_range_sigma(pipeline.noise, distance_m),
            target_mesh=self.mesh_path,
            mesh_unit=pipeline.mesh_unit,
            first_pose=stated_first_pose(pipeline, self.truth.poses[0]),
            camera_position_sd_m=pipeline.camera.position_sd_m,
            camera_attitude_sd_rad=float(np.deg2rad(pipeline.camera.attitude_sd_deg)),
            row_readout_s=0.0 if scans else pipeline.camera.row_readout_s,
            scan_s=pipeline.scan.duration_s if scans and pipeline.scan.states_times else 0.0,
            calibration=stated_calibration(pipeline),
        )

    def __len__(self) -> int:
        return len(self.truth)

    def __iter__(self) -> Iterator[Frame]:
        """The frames as they come back from a recording on disk, to the bit.

        Raises `InputError` for a depth that does not fit the file.
        """
        if self.pipeline.scan.is_used:
            return self.frames()
        return (as_recorded(frame, self.pipeline.noise) for frame in self.frames())

    def frames(self, blind: range = range(0)) -> Iterator[Frame]:
        """The depth frames one by one; those in ``blind`` have no returns."""
        if self.pipeline.scan.is_used:
            yield from self._scans(blind)
            return
        pipeline, stated = self.pipeline, self.pipeline.camera.pinhole
        camera = Miscalibration.of(pipeline).true_camera(stated)
        poses, noise = self.truth.poses, pipeline.noise
        readout_s, row_times = pipeline.camera.row_readout_s, None
        if readout_s > 0.0:
            row_times = RowTimes(frame_times(pipeline), readout_s)
        renderer = SceneRenderer(self.mesh, poses, self.parts, camera, row_times)
        footprint = FootprintSampler(renderer, noise)
        errors = SystematicErrors.of(pipeline, self.mesh, poses, self.parts)
        recorded = recorded_poses(self.motion.T_cam_world, pipeline.camera, pipeline.seed)
        for k, time_s in enumerate(self.truth.time_s.tolist()):
            if k in blind:
                depth_m = np.zeros((camera.height, camera.width), dtype=np.float32)
            else:
                view = footprint.sampled(renderer.render(k), renderer.poses(k))
                systematic = errors.of_frame(view, k, time_s)
                depth_m = add_sensor_faults(view, noise, pipeline.seed, k, systematic)
            yield Frame(k, time_s, depth_m, stated, recorded[k], pixels_without_ray(stated))

    def _scans(self, blind: range) -> Iterator[Frame]:
        """The scans one by one."""
        pipeline, stated = self.pipeline, self.stated_pattern
        true_camera = Miscalibration.of(pipeline).true_camera(pipeline.camera.pinhole)
        scanner = Scanner.of(pipeline, true_camera, frame_times(pipeline))
        poses, noise, grid = self.truth.poses, pipeline.noise, grid_of(stated.rays)
        renderer = SceneRenderer(self.mesh, poses, self.parts, scanner.camera, scanner.times)
        errors = SystematicErrors.of(pipeline, self.mesh, poses, self.parts)
        recorded = recorded_poses(self.motion.T_cam_world, pipeline.camera, pipeline.seed)
        for k, time_s in enumerate(self.truth.time_s.tolist()):
            range_m = np.zeros(stated.time_s.shape, dtype=np.float32)
            if k not in blind:
                view = scanner.spread(renderer.render(k), renderer, k)
                systematic = errors.of_frame(view, k, time_s)
                depth_m = add_sensor_faults(view, noise, pipeline.seed, k, systematic)
                # As floats of 32 bits, which are what is stored.
                range_m = (depth_m * view.seen.range_per_depth).astype(np.float32)
            ranges = range_m.ravel().astype(np.float64)
            scan = Scan(stated.rays.reshape(-1, 3), ranges, stated.time_s.ravel())
            yield Frame.of_scan(k, time_s, scan, grid, recorded[k])

    @property
    def stated_pattern(self) -> Pattern:
        """What a recording says of the beams of a scenario that scans."""
        table = self.pipeline.scan
        pattern = pattern_of(table, self.pipeline.camera.pinhole)
        time_s = pattern.time_s if table.states_times else np.zeros_like(pattern.time_s)
        return Pattern(pattern.rays, time_s)

    def write(self, out: Path, overwrite: bool = False, on_frame: OnFrame | None = None) -> str:
        """See `Simulation.write`; the same pipeline writes the same images, bit for bit."""
        returns: list[int] = []

        def frames() -> Iterator[Frame]:
            for frame in counted(self.frames(), len(self), on_frame):
                returns.append(int(np.count_nonzero(frame.depth_m)))
                yield frame

        info = replace(self.info, name=out.absolute().name)
        step_m = self.pipeline.noise.quantisation_m
        write_sequence(out, info, step_m, frames(), self.truth, overwrite)
        empty, total = returns.count(0), len(returns)
        if empty:
            warning = "%s: the target is outside the image in %d of %d frames"
            _LOG.warning(warning, out, empty, total)
        return f"sequence: {out} ({total} frames, {int(np.median(returns))} returns each)"


def simulate_depth(
    pipeline: Pipeline, source: Path | str, target_mesh: Path | None
) -> Simulation[Scene]:
    """The scene of a pipeline's target. Raises `InputError`, which names the source."""
    if target_mesh is None:
        raise InputError(source, "target_mesh", "expected the mesh of the satellite to simulate")
    target = load_target(target_mesh, pipeline.mesh_unit)
    if target.mesh_origin.unit_doubt is not None:
        _LOG.warning("%s: the mesh is %s", target_mesh, target.mesh_origin.unit_doubt)
    return Scene.showing(target, pipeline, source).simulation


def stated_range_sigma(noise: NoiseTable, distance_m: float) -> float | None:
    """Noise along the ray that a simulated sequence of a target at a distance states, m.

    A sensor without Gaussian noise still rounds: a step q has the standard deviation q / sqrt(12).
    """
    if not noise.states_range_sigma:
        return None
    true_m = float(noise.sigma_at(distance_m))
    return noise.stated_range_sigma_m or true_m or float(noise.quantisation_m / np.sqrt(12.0))


def stated_first_pose(pipeline: Pipeline, T_cam_model: FloatArray) -> FirstPosePrior | None:
    """The true first pose (4, 4), off by a draw of the seed; None where none is stated."""
    table = pipeline.scenario
    if not table.states_first_pose:
        return None
    rng = np.random.default_rng([pipeline.seed, _FIRST_POSE_STREAM])
    share = POSITION_SD_SHARE * float(np.linalg.norm(T_cam_model[:3, 3]))
    position_sd_m = table.first_pose_position_sd_m or share
    attitude_sd_rad = float(np.deg2rad(table.first_pose_attitude_sd_deg))
    p_cam = T_cam_model[:3, 3] + position_sd_m * rng.standard_normal(3)
    turn = exp_rotation(attitude_sd_rad * rng.standard_normal(3))
    stated = make_transform(T_cam_model[:3, :3] @ turn, p_cam)
    return FirstPosePrior(stated, position_sd_m, attitude_sd_rad)


def as_recorded(frame: Frame, noise: NoiseTable) -> Frame:
    """A frame as it comes back from a sequence on disk, to the bit.

    Raises `InputError` for a depth that does not fit 16 bits of the stored step.
    """
    units = np.rint(frame.depth_m.astype(np.float64) / noise.quantisation_m)
    if units.max() > MAXIMUM_UNITS:
        reach = MAXIMUM_UNITS * noise.quantisation_m
        expected = f"expected depths up to {reach:g} m (16 bits of the step)"
        got = f"got {float(frame.depth_m.max()):g} m in frame {frame.index}"
        raise InputError("pipeline", "noise.quantisation_m", f"{expected}, {got}")
    # A scene states its step in mm, and the reader makes its rotations orthonormal.
    step_m = np.float32((noise.quantisation_m * 1000.0) / 1000.0)
    depth_m = np.asarray(units.astype(np.uint16) * step_m, dtype=np.float32)
    T_cam_world = frame.T_cam_world.copy()
    T_cam_world[:3, :3] = nearest_orthogonal(T_cam_world[:3, :3])
    return replace(frame, depth_m=depth_m, T_cam_world=T_cam_world)
