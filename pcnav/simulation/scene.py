"""A simulated sequence in memory: the frames that a recording of it would hold, one by one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.simulation.noise import add_sensor_faults
from pcnav.simulation.recording import stated_range_sigma
from pcnav.simulation.scenario import TrueMotion, pinhole_camera, true_motion
from pcnav.target.rendering import DepthRenderer


@dataclass(frozen=True)
class Scene:
    """A motion, the sensor that sees it and the body that is there; not the target as modelled."""

    pipeline: Pipeline
    motion: TrueMotion
    mesh: trimesh.Trimesh
    """What the frames show, model frame, m."""

    @staticmethod
    def of(pipeline: Pipeline, mesh: trimesh.Trimesh) -> "Scene":
        """The scene of a pipeline."""
        return Scene(pipeline, true_motion(pipeline), mesh)

    @property
    def info(self) -> SequenceInfo:
        """What a recording of the scene would state."""
        pipeline = self.pipeline
        sigma_m = stated_range_sigma(pipeline.noise)
        return SequenceInfo("simulated", pipeline.orbit.mean_motion_rad_s, sigma_m, None)

    def frames(self, blind: range = range(0)) -> Iterator[Frame]:
        """The depth frames one by one; those in ``blind`` have no returns."""
        camera = pinhole_camera(self.pipeline.camera)
        renderer = DepthRenderer(self.mesh, camera)
        for k, time_s in enumerate(self.motion.times_s.tolist()):
            if k in blind:
                depth_m = np.zeros((camera.height, camera.width), dtype=np.float32)
            else:
                clean = renderer.render(self.motion.T_cam_model(k))
                depth_m = add_sensor_faults(clean, self.pipeline.noise, self.pipeline.seed, k)
            yield Frame(k, time_s, depth_m, camera, self.motion.T_cam_world[k])
