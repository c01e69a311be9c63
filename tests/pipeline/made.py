"""A short recording of every kind and the run made of it, for all tests of the pipeline."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import pytest

from pcnav.cli import main
from pcnav.config.image_motion import ImageMotionTable, MatchSolver, Smoothing
from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline, read_pipeline
from pcnav.config.scenario import BodyTable, OrbitTable, ScenarioTable
from pcnav.config.sensors import CameraTable, FeaturesTable, ImageCameraTable, StereoTable
from pcnav.config.shipped import shipped_mesh, shipped_pipeline
from pcnav.estimators.interface import Estimator, Given
from pcnav.estimators.registry import ESTIMATORS
from pcnav.navigation import RunSummary
from pcnav.pipeline import run
from pcnav.runs.estimate import Estimate
from pcnav.simulation.simulate import simulate

RATIOS = (0.7, 0.5, 0.05, -0.02, 0.03)
# The solver as printed needs no library; of exact tracks it is as good as any.
EXACT = ImageMotionTable(
    solver=MatchSolver.EIGHT_POINT,
    ambiguous_chi_square=0.0,
    smoothing=Smoothing.POLYNOMIAL,
    min_significance=0.0,
)


@dataclass(frozen=True)
class Made:
    """A simulated recording, the run made of it, and what was reported on its way."""

    recording: Path
    mesh: Path
    """Of the satellite, where it is seen in depth frames."""
    result: Path
    simulated: Pipeline
    """What the recording was simulated by."""
    pipeline: Pipeline
    """What was run."""
    summary: RunSummary
    reported: list[tuple[Estimate, int, int]]

    def copy_without_truth(self, folder: Path) -> Path:
        """The recording, in a folder of the same name, without any file of the truth."""
        copy = folder / self.recording.name
        for path in self.recording.rglob("*"):
            if path.is_file() and not path.name.startswith(("truth", "scene_gt")):
                to = copy / path.relative_to(self.recording)
                to.parent.mkdir(parents=True, exist_ok=True)
                to.write_bytes(path.read_bytes())
        return copy


def shipped(name: str, frames: int, **update: object) -> Pipeline:
    """A shipped pipeline, shortened."""
    path = shipped_pipeline(name)
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = ScenarioTable(frames=frames, frame_rate_hz=pipeline.scenario.frame_rate_hz)
    return pipeline.model_copy(update={"scenario": scenario, **update})


def stereo(kind: EstimatorKind = EstimatorKind.INERTIA_BANK, frames: int = 60) -> Pipeline:
    """Five points of a target nearby, unseen from 10 to 15 s."""
    return Pipeline(
        seed=7,
        scenario=ScenarioTable(frames=frames, frame_rate_hz=2.0),
        orbit=OrbitTable(mean_motion_rad_s=0.001, r_hill_m=(15.0, 1.0, -2.0)),
        body=BodyTable(omega_body_deg_s=(5.0, 4.0, 6.0), inertia_ratios=RATIOS),
        estimator=EstimatorTable(kind=kind),
        features=FeaturesTable(count=5, blackouts_s=((10.0, 15.0),)),
    )


def precise_stereo(kind: EstimatorKind, frames: int) -> Pipeline:
    """Points seen so well that the estimators begin at once."""
    return stereo(kind).model_copy(
        update={
            "scenario": ScenarioTable(frames=frames, frame_rate_hz=5.0),
            "stereo": StereoTable(pixel_sigma_px=0.02),
            "features": FeaturesTable(),
        }
    )


def one_camera(frames: int = 14, sigma_px: float = 0.0, images: bool = False) -> Pipeline:
    """Many points of a box seen by one camera, exactly where nothing else is said."""
    return Pipeline(
        seed=5,
        scenario=ScenarioTable(frames=frames, frame_rate_hz=1.0),
        orbit=OrbitTable(mean_motion_rad_s=0.001, r_hill_m=(20.0, 0.5, -0.4)),
        body=BodyTable(
            # So that three faces of the box are seen: the points of one do not tell the motion.
            attitude_rotvec_deg=(25.0, 40.0, -30.0),
            omega_body_deg_s=(1.5, -1.0, 1.2),
            inertia_ratios=(0.7, 0.6, 0.05, -0.02, 0.03),
        ),
        camera=CameraTable(boresight_hill=(1.0, 0.0, 0.0)),
        estimator=EstimatorTable(kind=EstimatorKind.IMAGE_MOTION),
        image_camera=ImageCameraTable(pixel_sigma_px=sigma_px, images=images),
        image_motion=EXACT,
        features=FeaturesTable(count=80, half_extent_m=2.0, max_view_angle_deg=84.0),
    )


CASES: dict[str, Callable[[], Pipeline]] = {
    "depth": partial(shipped, "demo", 24),
    "inertia_bank": partial(precise_stereo, EstimatorKind.INERTIA_BANK, 30),
    "principal_axes": partial(precise_stereo, EstimatorKind.PRINCIPAL_AXES, 60),
    "image_motion": one_camera,
    "attitude_inertia": partial(shipped, "deng2024", 161),
}
"""What a recording is simulated by for an estimator of each of the files' formats."""


def make(name: str, folder: Path) -> Made:
    """Simulate a case and run its estimator."""
    simulated, mesh = CASES[name](), shipped_mesh("boxsat")
    assert mesh is not None
    # The depth tracker is given nothing of the scenario: the mesh is in the recording.
    pipeline = Pipeline(seed=5) if name == "depth" else simulated
    recording, result = folder / "recording", folder / "deep" / "result"
    simulate(simulated, target_mesh=mesh).write(recording)
    reported: list[tuple[Estimate, int, int]] = []
    summary = run(recording, result, pipeline, on_estimate=lambda *news: reported.append(news))
    return Made(recording, mesh, result, simulated, pipeline, summary, reported)


def put(monkeypatch: pytest.MonkeyPatch, kind: str, make: Callable[[Given], Estimator]) -> None:
    """Put an estimator in place of one of the registry."""
    monkeypatch.setitem(ESTIMATORS, kind, replace(ESTIMATORS[kind], make=make))


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    """The exit code of a command line, run in this process."""
    monkeypatch.setattr("sys.argv", ["pcnav", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)
