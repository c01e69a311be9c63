"""Simulating a whole pipeline file into a sequence folder."""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import NoiseTable
from pcnav.core.errors import InputError
from pcnav.recordings.depth_png import MAXIMUM_UNITS
from pcnav.recordings.poses import nearest_rotation
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.recordings.writer import SequenceWriter
from pcnav.simulation.noise import add_sensor_faults
from pcnav.simulation.scenario import pinhole_camera, true_motion
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

OnFrame = Callable[[int, int], None]
"""Told after every frame how many are done, and of how many."""

_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class SimulationSummary:
    """What `simulate` wrote."""

    path: Path
    frames: int
    empty_frames: int
    """Frames without a single return: the target was outside the image."""
    median_returns: int
    """Median number of pixels with a return."""


def simulate(
    pipeline: Pipeline,
    target: Target,
    out: Path,
    overwrite: bool = False,
    on_frame: OnFrame | None = None,
    source: Path | str = "pipeline",
) -> SimulationSummary:
    """Write the depth sequence and truth of a scenario.

    ``source`` is the pipeline's file, which an `InputError` names. The same pipeline writes the
    same images, bit for bit. Raises `InputError` for a scenario that cannot be simulated and for
    a folder that must not be replaced (see `SequenceWriter`); nothing is then left behind.
    """
    motion = true_motion(pipeline, source)
    camera = pinhole_camera(pipeline.camera)
    renderer = DepthRenderer(target.mesh, camera)
    info = SequenceInfo(
        name=out.absolute().name,
        mean_motion_rad_s=pipeline.orbit.mean_motion_rad_s,
        range_sigma_m=stated_range_sigma(pipeline.noise),
        target_mesh=target.mesh_path,
    )
    total = len(motion.times_s)
    returns = np.zeros(total, dtype=np.intp)
    with SequenceWriter(out, info, pipeline.noise.quantisation_m, overwrite) as writer:
        for k in range(total):
            T_cam_model = motion.T_cam_model(k)
            clean = renderer.render(T_cam_model)
            depth_m = add_sensor_faults(clean, pipeline.noise, pipeline.seed, k)
            frame = Frame(k, float(motion.times_s[k]), depth_m, camera, motion.T_cam_world[k])
            writer.write(frame, motion.states[k], T_cam_model)
            returns[k] = np.count_nonzero(depth_m)
            if on_frame is not None:
                on_frame(k + 1, total)
    empty = int(np.count_nonzero(returns == 0))
    if empty > 0:
        _LOG.warning("%s: the target is outside the image in %d of %d frames", out, empty, total)
    return SimulationSummary(out, total, empty, int(np.median(returns)))


def stated_range_sigma(noise: NoiseTable) -> float:
    """Noise along the ray that a simulated sequence states, m.

    A sensor without Gaussian noise still rounds: a step q has the standard deviation q / sqrt(12).
    """
    if noise.range_sigma_m > 0.0:
        return noise.range_sigma_m
    return float(noise.quantisation_m / np.sqrt(12.0))


def as_recorded(frame: Frame, noise: NoiseTable) -> Frame:
    """A frame as it comes back from a sequence that `simulate` wrote, to the bit.

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
    T_cam_world[:3, :3] = nearest_rotation(T_cam_world[:3, :3])
    return replace(frame, depth_m=depth_m, T_cam_world=T_cam_world)
