"""The main job as a list of verbs: open, estimate, write, evaluate, report. One for all kinds."""

import filecmp
import logging
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from pcnav.config.first_pose import FirstPoseTable
from pcnav.config.length_unit import LengthUnit
from pcnav.config.pipeline_file import EstimatorTable, Pipeline
from pcnav.config.scenario import OrbitTable
from pcnav.core.errors import InputError
from pcnav.estimators.choice import chosen
from pcnav.estimators.image_motion.source import TrackedImages
from pcnav.evaluation.answer.model import RunState
from pcnav.files.new_folder import refuse_unless_replaceable
from pcnav.navigation import Inputs, Navigation, RunSummary, Truth
from pcnav.recordings.given_frames import DepthRecording, GivenFrames
from pcnav.recordings.images import ImageSequence
from pcnav.recordings.intake import Intake, skipped_frames_csv
from pcnav.recordings.opening import open_recording
from pcnav.recordings.recording import Recording
from pcnav.recordings.region_files import resolved
from pcnav.recordings.sequence import Sequence
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.result_files import (
    SKIPPED_FRAMES_FILE,
    STATES_FILE,
)
from pcnav.runs.writer import RunWriter
from pcnav.target.satellite import load_target

_LOG = logging.getLogger("pcnav")

OnStart = Callable[[Pipeline, Output], None]
"""Told, before the first frame, of the pipeline as run and of what the estimates will hold."""
OnEstimate = Callable[[Estimate, int, int], None]
"""Told of every estimate, how many frames are done, and of how many."""


def run(
    path: Path | str,
    out: Path | str,
    pipeline: Pipeline | None = None,
    *,
    estimator: str | None = None,
    target_mesh: Path | None = None,
    mesh_unit: LengthUnit | None = None,
    initial_pose: FirstPoseTable | None = None,
    overwrite: bool = False,
    report: bool = True,
    source: Path | str = "pipeline",
    on_start: OnStart | None = None,
    on_estimate: OnEstimate | None = None,
) -> RunSummary:
    """Estimate a target's motion from a recording of any kind and write the result folder.

    Args:
        path: of the recording: a folder, a table or a video.
        out: the result folder.
        pipeline: settings and estimator; without one, those that the kind of recording has.
        estimator: key in the registry; replaces the pipeline's.
        target_mesh: of depth frames; else the one the sequence names, else the pipeline's
            ``target_mesh`` taken as a path.
        mesh_unit: of its coordinates; replaces what pipeline, sequence and files say.
        initial_pose: of the target in the first depth frame; replaces the pipeline's and the
            sequence's.
        overwrite: whether an earlier result may be replaced.
        report: whether to draw the report page, too.
        source: the pipeline's file, which an `InputError` names.
        on_start: see `OnStart`.
        on_estimate: see `OnEstimate`.

    Raises `InputError` for a bad recording, mesh, truth or existing result folder, and for an
    estimator that does not fit; nothing is then left, and an earlier result stays as it was.
    """
    path, out = Path(path), Path(out)
    if not overwrite:
        # At once; what overwriting would cost is looked at when it is known what is read.
        refuse_unless_replaceable(out.resolve(), overwrite, STATES_FILE)
    inputs = _open(path, out, pipeline, estimator, target_mesh, mesh_unit, source)
    if initial_pose is not None:
        inputs = inputs.beginning_at(initial_pose)
    # Read now, so that a fault in it costs no run.
    truth = Truth.of(inputs.recording)
    navigation = Navigation(inputs)
    output = navigation.estimator.output
    with RunWriter(out, output, overwrite) as writer:
        navigation.begin(writer)
        if on_start is not None:
            on_start(inputs.as_run, output)
        frames = inputs.frames()
        # An earlier result is worth more than the beginning of a new one.
        state, done = _take_in(navigation, frames, writer, on_estimate, keep=not out.exists())
        revised = navigation.estimator.finish() if state is RunState.FINISHED else None
        if revised is not None:
            writer.revise(revised)
        if isinstance(frames, Intake) and frames.skipped:
            writer.write_text(SKIPPED_FRAMES_FILE, skipped_frames_csv(frames.skipped))
        summary = navigation.complete(
            writer,
            truth,
            frames.remarks if isinstance(frames, Intake) else (),
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            report=report and state is RunState.FINISHED,
            state=state,
        )
    if state is RunState.INTERRUPTED:
        _LOG.warning("interrupted: %s holds the %d frames that were done", out, done)
        raise KeyboardInterrupt
    return summary


def _take_in(
    navigation: Navigation,
    frames: Recording | Intake,
    writer: RunWriter,
    on_estimate: OnEstimate | None,
    keep: bool,
) -> tuple[RunState, int]:
    """Give the estimator every frame; the estimates go to the writer as they come.

    What is returned is how it ended, and after how many frames.
    Where what was done is to be kept (``keep``) when the run is interrupted, the frames end there.
    """
    done, coming = 0, iter(frames)
    while True:
        try:
            frame = next(coming, None)
            if frame is None:
                break
            estimate = navigation.step(frame)
        except KeyboardInterrupt:
            if not keep or not done:
                raise
            return RunState.INTERRUPTED, done
        done += 1
        estimate = writer.add(estimate)
        if on_estimate is not None:
            # A damaged video may end before, or after, what its header says.
            on_estimate(estimate, done, max(len(frames), done))
    if not done:
        expected = "expected at least one frame that can be read"
        raise InputError(navigation.inputs.path, "file", expected)
    return RunState.FINISHED, done


def _open(
    path: Path,
    out: Path,
    pipeline: Pipeline | None,
    estimator: str | None,
    target_mesh: Path | None,
    mesh_unit: LengthUnit | None,
    source: Path | str,
) -> Inputs:
    choice = chosen(path, pipeline, estimator, source)
    skip_bad_frames = pipeline is not None and pipeline.skip_bad_frames
    pipeline = pipeline or Pipeline()
    table = pipeline.recording
    recording = open_recording(path, target_mesh, (choice.kind,), skip_bad_frames, table)
    return inputs_of(recording, out, pipeline, choice.estimator, target_mesh, mesh_unit)


def inputs_of(
    recording: Recording,
    out: Path | None,
    pipeline: Pipeline,
    estimator: str,
    target_mesh: Path | None = None,
    mesh_unit: LengthUnit | None = None,
) -> Inputs:
    """What a run of an estimator is made from; of depth frames the target is loaded.

    Raises `InputError` for a target or a region that cannot be, and for a result folder ``out``,
    where there is one, whose replacing would remove what is read.
    """
    inputs, target = [] if recording.path is None else [recording.path], None
    as_run: dict[str, object] = {}
    if recording.path is not None:
        as_run["sequence"] = str(recording.path.resolve())
    if str(pipeline.estimator.kind) != estimator:
        as_run["estimator"] = EstimatorTable(kind=estimator)
    if isinstance(recording, DepthRecording):
        mesh, unit = _mesh_of(recording, pipeline, target_mesh)
        mesh_unit = mesh_unit or unit
        inputs.append(mesh)
        as_run["target_mesh"] = str(mesh.resolve())
        as_run["mesh_unit"] = mesh_unit
        as_run["time_zero_s"] = recording.info.time_zero_s
    if isinstance(recording, GivenFrames):
        # There is no recording that tells it.
        rate = recording.info.mean_motion_rad_s
        as_run["orbit"] = OrbitTable(mean_motion_rad_s=rate)
    if isinstance(recording, Sequence):
        as_run["region"] = resolved(pipeline.region, recording.path)
    for each in inputs:
        # Replacing a result folder must not delete what the new result is made from.
        if out is not None and each.resolve().is_relative_to(out.resolve()):
            raise InputError(out, "folder", f"expected a result folder that does not hold {each}")
    if isinstance(recording, DepthRecording):
        target = load_target(mesh, mesh_unit)
    if isinstance(recording, ImageSequence):
        recording = TrackedImages(recording, pipeline.feature_tracker)
    return Inputs(recording, pipeline.model_copy(update=as_run), target)


def _mesh_of(
    sequence: DepthRecording, pipeline: Pipeline, given: Path | None
) -> tuple[Path, LengthUnit | None]:
    """The mesh and its unit, where one is stated: the sequence knows best what it shows."""
    if given is not None:
        return given, None
    stated = sequence.info.target_mesh
    named = None if pipeline.target_mesh is None else Path(pipeline.target_mesh)
    mesh = stated or named
    if mesh is None:
        raise InputError(
            sequence.path or sequence.name,
            "target_mesh",
            "expected the target's mesh, in sequence.toml or by --target",
        )
    if named is not None and not (named.is_file() and filecmp.cmp(mesh, named, shallow=False)):
        where = sequence.path or sequence.name
        _LOG.warning("%s: its mesh %s is used, not the pipeline's %s", where, mesh, named)
        return mesh, sequence.info.mesh_unit
    return mesh, sequence.info.mesh_unit or pipeline.mesh_unit
