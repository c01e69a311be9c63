"""Sequences to measure on: shipped scenarios, simulated afresh into a temporary folder."""

from dataclasses import dataclass
from pathlib import Path

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_mesh, shipped_pipeline
from pcnav.core.arrays import FloatArray
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Frame, SequenceInfo, stated_or_default_sigma
from pcnav.recordings.truth import read_truth
from pcnav.simulation.depth import Scene as SimulatedScene
from pcnav.target.satellite import Target, load_target


@dataclass(frozen=True)
class Scene:
    """A simulated sequence on disk and what it was made from."""

    name: str
    path: Path
    pipeline: Pipeline
    target: Target


@dataclass(frozen=True)
class Case:
    """A scene in memory, with its truth: what every method is given and compared with."""

    scene: Scene
    info: SequenceInfo
    frames: tuple[Frame, ...]
    T_cam_model: FloatArray
    """(n, 4, 4) truth."""

    @property
    def title(self) -> str:
        """Satellite, noise and number of frames."""
        sigma_m = stated_or_default_sigma(self.info)
        return f"{self.scene.name}, range noise {sigma_m:g} m, {len(self.frames)} frames"


def shortened(name: str, frames: int, range_sigma_m: float | None = None) -> Pipeline:
    """A shipped pipeline with another number of frames and, where given, another noise."""
    path = shipped_pipeline(name)
    if path is None:
        raise LookupError(f"no shipped pipeline {name}")
    pipeline = read_pipeline(path)
    mesh = shipped_mesh(pipeline.target_mesh or name)
    if mesh is None:
        raise LookupError(f"no shipped mesh {pipeline.target_mesh or name}")
    noise = pipeline.noise
    if range_sigma_m is not None:
        noise = noise.model_copy(update={"range_sigma_m": range_sigma_m})
    scenario = pipeline.scenario.model_copy(update={"frames": frames})
    changed = {"target_mesh": str(mesh), "scenario": scenario, "noise": noise}
    return pipeline.model_copy(update=changed)


def noise_levels(name: str) -> tuple[float, float]:
    """Range noise of a shipped pipeline and half of it, m."""
    shipped = shortened(name, 1).noise.range_sigma_m
    return shipped, 0.5 * shipped


def record(name: str, pipeline: Pipeline, path: Path) -> Scene:
    """Simulate a pipeline that names its mesh by path into a folder."""
    target = load_target(Path(pipeline.target_mesh or name))
    SimulatedScene.showing(target, pipeline).write(path)
    return Scene(name, path, pipeline, target)


def load(scene: Scene) -> Case:
    """Read a scene into memory, so that reading does not count towards any method."""
    sequence = open_sequence(scene.path)
    truth = read_truth(scene.path)
    if truth is None or truth.T_cam_target is None:
        raise LookupError(f"{scene.path} has no true poses")
    return Case(scene, sequence.info, tuple(sequence), truth.T_cam_target)
