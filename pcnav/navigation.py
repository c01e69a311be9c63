"""An estimator at work, wherever its frames come from, and the result folder that it leaves."""

import gc
import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from pcnav.config.first_pose import FirstPoseTable
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.image_motion.source import TrackedImages
from pcnav.estimators.interface import Estimator, Given
from pcnav.estimators.registry import make_estimator
from pcnav.evaluation.answer.model import Answer, RunState
from pcnav.evaluation.answer.telling import About, answer_of
from pcnav.evaluation.diagnosis import Diagnosis, Facts, diagnosis
from pcnav.evaluation.information_gain import InformationGain, gain_csv, gain_of_run
from pcnav.evaluation.mesh_fit import mesh_fit_csv, sentences
from pcnav.evaluation.metrics import Metrics, evaluate
from pcnav.evaluation.observability.sources import tables_of_run
from pcnav.evaluation.size_check import view_spans
from pcnav.perception.part_fit import MeshFit
from pcnav.recordings.first_pose import prior_of
from pcnav.recordings.frame_survey import FrameSurveyor
from pcnav.recordings.given_frames import DepthRecording
from pcnav.recordings.intake import Intake
from pcnav.recordings.recording import Recording, truth_folder
from pcnav.recordings.sequence import Frame, Sequence
from pcnav.recordings.stereo_tracks import read_truth_features
from pcnav.recordings.tracks import StereoTracks
from pcnav.recordings.truth import truth_of
from pcnav.runs.estimate import Estimate
from pcnav.runs.places import relocatable
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import (
    KNOWLEDGE_FILE,
    MESH_FIT_FILE,
    METRICS_FILE,
    PIPELINE_FILE,
    REPORT_FILE,
    SUMMARY_FILE,
)
from pcnav.runs.run import Run
from pcnav.runs.writer import RunWriter
from pcnav.target.mesh import wireframe_edges
from pcnav.target.satellite import Target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True, repr=False)
class RunSummary:
    """What a run leaves behind."""

    folder: Path
    answer: Answer
    """What was found, and the warnings about it."""
    metrics: Metrics
    """Errors in it only where the recording carries a truth."""
    gain: InformationGain | None
    """What the data told of every state; None without a prior or an estimate."""
    diagnosis: Diagnosis
    """Whether anything was found, and in words what went wrong."""
    has_report: bool = True
    """Whether the report page was written."""

    def __repr__(self) -> str:
        return f"<RunSummary of {self.folder}: {len(self.warnings)} warnings>"

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is to be doubted, in sentences; empty where nothing is."""
        return self.answer.warnings

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


@dataclass(frozen=True)
class Inputs:
    """What a run is made from."""

    recording: Recording
    as_run: Pipeline
    """Names the estimator, and recording and mesh as absolute paths."""
    target: Target | None
    """Of depth frames."""

    @property
    def path(self) -> Path:
        """Of the recording."""
        assert self.recording.path is not None, "it was read from a file"
        return self.recording.path

    def beginning_at(self, initial_pose: FirstPoseTable) -> Self:
        """The same with another first pose. Raises `InputError` where there is no model."""
        if self.target is None:
            expected = "expected none: only depth frames show a target with a model"
            raise InputError(self.path, "--initial-pose", expected)
        as_run = self.as_run.model_copy(update={"initial_pose": initial_pose})
        return replace(self, as_run=as_run)

    def frames(self) -> Recording | Intake:
        """What the estimator is given; of depth frames what the settings leave of them."""
        if not isinstance(self.recording, Sequence):
            return self.recording
        return Intake(self.recording, self.as_run.region, self.as_run.skip_bad_frames)

    def make_estimator(self) -> Estimator:
        """The one that is run."""
        about: Any = self.recording
        if isinstance(about, DepthRecording):
            first_pose = prior_of(self.as_run.initial_pose) or about.info.first_pose
            about = replace(about.info, first_pose=first_pose)
        given = Given(self.as_run, about, self.target)
        return make_estimator(str(self.as_run.estimator.kind), given)


@dataclass(frozen=True)
class Truth:
    """What nothing but the evaluation is given."""

    motion: Trajectory | None = None
    points: Mapping[int, FloatArray] | None = None

    @staticmethod
    def of(recording: Recording) -> "Truth":
        """As far as a recording has one. Raises `InputError` for a fault in it."""
        if recording.path is None:
            return Truth()
        points = read_truth_features(truth_folder(recording.path))
        return Truth(truth_of(recording), points)


class Navigation:
    """An estimator at work: it takes in frames, from wherever they come, and makes a result."""

    def __init__(self, inputs: Inputs) -> None:
        """Raises `InputError` for an estimator that cannot be."""
        self.inputs, self.estimator = inputs, inputs.make_estimator()
        self._surveyor, self._has_claimed = FrameSurveyor(), False
        self._fit = None if inputs.target is None else MeshFit(inputs.target)

    def step(self, frame: Any) -> Estimate:
        """The estimate of a frame. Raises `InputError` for one that cannot be."""
        estimate = self.estimator.step(frame)
        if estimate.is_claimed and not self._has_claimed:
            # The libraries that a start has loaded stay for good: looked through again for what is
            # unused, they would hold up some later frame by 80 ms.
            self._has_claimed = True
            gc.freeze()
        _LOG.debug("%r", estimate)
        if isinstance(frame, Frame):
            self._surveyor.add(frame)
        noise = self.estimator.sensor_noise
        if self._fit is not None and noise is not None and estimate.is_claimed:
            pose = estimate.T_cam_target
            assert isinstance(frame, Frame) and pose is not None, "a claim is of a pose"
            exposure = self.estimator.exposure(frame, pose)
            self._fit.add(frame, pose, noise, self.estimator.mesh_scale, exposure)
        return estimate

    def begin(self, writer: RunWriter) -> None:
        """Write what is run: a run that is killed, or still goes on, can then be looked at."""
        as_run = relocatable(self.inputs.as_run, writer.folder)
        text = pipeline_toml(as_run, library_versions(), of_a_run=True)
        writer.write_text(PIPELINE_FILE, text)

    def complete(
        self,
        writer: RunWriter,
        truth: Truth | None = None,
        remarks: tuple[str, ...] = (),
        *,
        command: str,
        report: bool = True,
        state: RunState = RunState.FINISHED,
    ) -> RunSummary:
        """Add to the estimates that were written all that is told of them.

        ``remarks`` are sentences on the frames, and ``command`` repeats the run.
        """
        inputs, target, truth = self.inputs, self.inputs.target, truth or Truth()
        staging = writer.finish_tables()
        if isinstance(inputs.recording, TrackedImages):
            inputs.recording.write(staging)
        found = read_run(staging, with_covariance=True)
        metrics = evaluate(
            found,
            truth.motion,
            symmetry_transforms=None if target is None else target.symmetry_transforms,
            roundness=None if target is None else target.roundness,
            true_points=truth.points,
        )
        if metrics.errors is not None:
            writer.write_json(METRICS_FILE, metrics.to_json())
        gain = self._gain(found)
        if gain is not None:
            writer.write_text(KNOWLEDGE_FILE, gain_csv(gain))
        parts = () if self._fit is None else self._fit.parts()
        if parts:
            writer.write_text(MESH_FIT_FILE, mesh_fit_csv(parts))
        says = diagnosis(found, self._facts())
        warnings = (*remarks, *says.warnings, *sentences(parts))
        answer = answer_of(found, metrics, self._about((*warnings, *says.said), state))
        writer.write_json(SUMMARY_FILE, answer.model_dump(mode="json"))
        if report:
            # Only a report needs matplotlib, whose import takes as long as many a run.
            from pcnav.report.content import ReportContent
            from pcnav.report.run_report import write_report

            picture, caption = _picture(target, self.estimator)
            content = ReportContent(
                title=inputs.recording.name,
                command=command,
                answer=answer,
                run=found,
                metrics=metrics,
                gain=gain,
                parts=parts,
                observability=tables_of_run(found, inputs.recording, target),
                configuration=inputs.as_run.stated(of_a_run=True),
                versions=library_versions(),
                picture=picture,
                picture_caption=caption,
            )
            write_report(staging / REPORT_FILE, content)
        for sentence in warnings:
            _LOG.warning("%s", sentence)
        return RunSummary(writer.folder, answer, metrics, gain, says, has_report=report)

    def _about(self, warnings: tuple[str, ...], state: RunState) -> About:
        recording, target = self.inputs.recording, self.inputs.target
        orbit = recording.orbit if isinstance(recording, StereoTracks) else None
        if isinstance(recording, DepthRecording):
            orbit = KeplerOrbit(recording.info.mean_motion_rad_s)
        return About(
            recording=recording.name,
            target=None if target is None else target.name,
            symmetry="C1" if target is None else target.symmetry_name,
            mesh_scale=self.estimator.mesh_scale,
            orbit=orbit,
            prior=self.estimator.prior,
            budget=self.estimator.budget,
            warnings=warnings,
            state=state,
        )

    def _gain(self, found: Run) -> InformationGain | None:
        if self.estimator.prior is None:
            return None
        recording = self.inputs.recording
        assert isinstance(recording, DepthRecording), "only runs on depth frames have a prior"
        return gain_of_run(found, self.estimator.prior, recording.info.mean_motion_rad_s)

    def _facts(self) -> Facts:
        """What is known of a run beside its tables."""
        target, estimator, about = self.inputs.target, self.estimator, self.inputs.recording
        diameter_m = float("nan") if target is None else target.diameter_m
        stated_m, of_depth = self.inputs.as_run.perception.range_sigma_m, None
        if isinstance(about, DepthRecording):
            stated_m = about.info.range_sigma_m if stated_m is None else stated_m
            of_depth = self._surveyor.survey()
        return Facts(
            *(of_depth, diameter_m),
            view_spans=None if target is None else partial(view_spans, target),
            metres_per_unit=1.0 if target is None else target.mesh_origin.metres_per_unit,
            min_frames=estimator.min_frames,
            search=estimator.search_report,
            noise=estimator.sensor_noise,
            stated_sigma_m=stated_m,
            remarks=estimator.remarks,
            mesh_scale=estimator.mesh_scale,
        )


def _picture(target: Target | None, estimator: Estimator) -> "tuple[Figure | None, str]":
    if target is None or estimator.best_view is None:
        return None, ""
    estimate, view = estimator.best_view
    frame = view.frame
    from pcnav.report.overlay import frame_picture

    picture = frame_picture(
        frame.depth_m,
        frame.camera,
        view.image_labels,
        estimate.records,
        wireframe_edges(target.mesh),
        estimate.T_cam_target,
    )
    return picture, f"Frame {frame.index} at {frame.time_s:g} s, status {estimate.status}."
