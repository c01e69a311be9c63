"""Simulated scans: clean returns along beams, each at the time it is seen."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import Footprint
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.simulation.footprint import with_samples
from pcnav.simulation.motion import TrueMotion, true_motion
from pcnav.simulation.readout import RowTimes
from pcnav.simulation.scan_patterns import Pattern, cone_about, pattern_of
from pcnav.simulation.surroundings.view import SceneRenderer, SceneView
from pcnav.target.row_motion import Exposure

_STEPS = 8
"""Of the true motion, from frame to frame: a tenth of a turn is followed to 1e-8 of it."""
_POWERS = 6
_MIN_DIVERGENCE_MRAD = 1e-6


@dataclass(frozen=True)
class FineMotion:
    """The true poses of the target between the frames as well."""

    poses: FloatArray
    """(_STEPS (n + 1), 4, 4) of n frames, `_STEPS` times as many and a frame longer."""
    step_s: float

    @staticmethod
    def of(pipeline: Pipeline, source: object = "pipeline") -> tuple["FineMotion", TrueMotion]:
        """Of a scenario, and its motion in the frames alone."""
        scenario, frames = pipeline.scenario, pipeline.scenario.frames
        rate_hz = _STEPS * scenario.frame_rate_hz
        finer = scenario.model_copy(
            update={"frames": _STEPS * (frames + 1), "frame_rate_hz": rate_hz}
        )
        motion = true_motion(pipeline.model_copy(update={"scenario": finer}), str(source))
        at = slice(0, _STEPS * frames, _STEPS)
        truth = motion.truth
        values = {name: value[at] for name, value in truth.values.items()}
        assert truth.T_cam_target is not None
        coarse = replace(
            truth, time_s=truth.time_s[at], values=values, T_cam_target=truth.T_cam_target[at]
        )
        in_frames = TrueMotion(coarse, motion.T_cam_world[at], motion.R_hill_world[at])
        return FineMotion(truth.T_cam_target, 1.0 / rate_hz), in_frames

    def about(self, k: int, times_s: FloatArray) -> FloatArray:
        """(m, 4, 4) at times (m,) from that of frame k on."""
        centre = k * _STEPS
        first = max(centre - _STEPS // 2, 0)
        nodes = np.arange(first, first + _STEPS + 1)
        R, p = self.poses[centre, :3, :3], self.poses[centre, :3, 3]
        turned = log_rotation(R.T @ self.poses[nodes, :3, :3])
        moved = np.hstack([self.poses[nodes, :3, 3] - p, turned])
        # In units of half the span, for the sake of its powers.
        unit = 0.5 * _STEPS
        powers = np.arange(_POWERS + 1)
        at_nodes = ((nodes - centre) / unit)[:, None] ** powers
        found, *_ = np.linalg.lstsq(at_nodes, moved, rcond=None)
        at = (times_s / (unit * self.step_s))[:, None] ** powers @ found
        return make_transform(R @ exp_rotation(at[:, 3:]), p + at[:, :3])


@dataclass(frozen=True)
class ScanTimes:
    """When the beams of the scans of a sensor are seen."""

    pattern: Pattern
    target: FineMotion
    others: RowTimes
    """Of what moves beside it."""

    def of_frame(
        self, number: int, T_cam_body: FloatArray, k: int, camera: PinholeCamera
    ) -> Exposure | None:
        """See `Exposures.of_frame`."""
        times_s, index = np.unique(self.pattern.time_s, return_inverse=True)
        if number == 0:
            poses = self.target.about(k, times_s)
        else:
            found = self.others.at_times(T_cam_body, k, times_s)
            poses = np.broadcast_to(T_cam_body[k], (len(times_s), 4, 4)) if found is None else found
        index = index.reshape(self.pattern.time_s.shape)
        return Exposure(poses, index, self.pattern.rays, is_scattered=True)


@dataclass(frozen=True)
class Scanner:
    """The sensor of a scenario that scans."""

    pipeline: Pipeline
    true_pattern: Pattern
    """Where the beams look."""
    camera: PinholeCamera
    """Of as many rows and columns as the pattern; it stands for nothing else."""
    times: ScanTimes

    @staticmethod
    def of(pipeline: Pipeline, true_camera: PinholeCamera, times_s: FloatArray) -> "Scanner":
        """Of a pipeline whose frames are taken at true times (n,).

        Raises `InputError` for a scan that lasts longer than a frame.
        """
        table = pipeline.scan
        if table.duration_s * pipeline.scenario.frame_rate_hz > 1.0 + 1e-9:
            expected = "expected a scan no longer than the time between frames"
            raise InputError("pipeline", "scan.duration_s", expected)
        pattern = pattern_of(table, true_camera)
        height, width = pattern.time_s.shape
        camera = PinholeCamera(width, height, true_camera.fx, true_camera.fy, 0.0, 0.0)
        fine, _ = FineMotion.of(pipeline)
        times = ScanTimes(pattern, fine, RowTimes(times_s, table.duration_s))
        return Scanner(pipeline, pattern, camera, times)

    def spread(self, view: SceneView, renderer: SceneRenderer, k: int) -> SceneView:
        """A clean view with the width of the beams."""
        divergence = self.pipeline.scan.divergence_mrad
        noise = self.pipeline.noise
        if divergence <= _MIN_DIVERGENCE_MRAD or noise.footprint is Footprint.CENTRE_RAY:
            return view
        views = [
            renderer.render(k, rays=rays)
            for rays in cone_about(self.true_pattern.rays, 1e-3 * divergence)
        ]
        return with_samples(view, views, noise, 1e-3 * divergence)
