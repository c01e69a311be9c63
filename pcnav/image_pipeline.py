"""A run on images of one camera as a list of verbs: open, follow, chain, write, evaluate."""

import json
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from pcnav.camera import PinholeCamera
from pcnav.config import Pipeline
from pcnav.config_features import EstimatorKind, EstimatorTable
from pcnav.errors import InputError
from pcnav.estimation.image_motion.chain import ChainFrame, ImageMotionChain
from pcnav.evaluation.image_metrics import evaluate_images
from pcnav.evaluation.image_report import ImageReport, write_image_report
from pcnav.evaluation.metrics import Metrics
from pcnav.evaluation.truth import read_truth
from pcnav.image_results import image_track, write_states
from pcnav.new_folder import new_folder
from pcnav.perception.feature_tracking import track_features
from pcnav.provenance import library_versions, pipeline_toml
from pcnav.results import METRICS_FILE, PIPELINE_FILE, REPORT_FILE, STATES_FILE
from pcnav.sequences.images import is_image_sequence, open_images
from pcnav.sequences.monocular import (
    CAMERA_FILE,
    MONOCULAR_TRACKS_FILE,
    MonocularFrame,
    MonocularTracks,
    is_monocular_recording,
    read_monocular,
    write_monocular_files,
)

OnFrame = Callable[[ChainFrame, int, int], None]
"""Told what became of every frame, how many frames are done, and of how many."""


@dataclass(frozen=True)
class ImageRunSummary:
    """What a run leaves behind."""

    folder: Path
    metrics: Metrics
    """Errors in it only where the recording carries a truth."""

    @property
    def report(self) -> Path:
        """The report page."""
        return self.folder / REPORT_FILE


@dataclass(frozen=True)
class _Source:
    """Frames of a recording, whichever kind it is."""

    name: str
    place: Path
    """What the run was made from: a folder or a video."""
    folder: Path
    """Where its truth would be."""
    camera: PinholeCamera
    pixel_sigma_px: float
    frames: Iterator[MonocularFrame]
    count: int
    is_images: bool


def is_seen_by_one_camera(path: Path) -> bool:
    """Whether a path is a recording that `run_images` takes."""
    return is_monocular_recording(path) or is_image_sequence(path)


def run_images(
    recording: Path,
    out: Path,
    pipeline: Pipeline,
    *,
    overwrite: bool = False,
    on_frame: OnFrame | None = None,
) -> ImageRunSummary:
    """Estimate a target's attitude and rate from images or tracks and write the result folder.

    A recording of images leaves the tracks of its features in the result, which is then a
    recording itself. Raises `InputError` for a bad recording, truth or existing result folder and
    without the extra `images` where it is needed; nothing is then left, and an earlier result
    stays as it was.
    """
    source = _open(recording, pipeline)
    if source.place.resolve().is_relative_to(out.resolve()):
        raise InputError(out, "folder", f"expected a result folder that does not hold {recording}")
    # Read now, so that a fault in it costs no run; nothing but the evaluation is given it.
    truth = read_truth(source.folder)
    as_run = _as_run(pipeline, source)
    with new_folder(out, overwrite, STATES_FILE) as staging:
        tracks, chained = _chain(source, pipeline, on_frame)
        seen = [len(frame.features) for frame in tracks.frames]
        track = image_track(chained, seen, pipeline.image_motion)
        write_states(staging, track)
        if source.is_images:
            write_monocular_files(staging, tracks)
        metrics, errors = evaluate_images(track, truth)
        if errors is not None:
            text = json.dumps(metrics.to_json(), indent=2, allow_nan=False) + "\n"
            (staging / METRICS_FILE).write_text(text, encoding="utf-8")
        versions = library_versions()
        (staging / PIPELINE_FILE).write_text(pipeline_toml(as_run, versions), encoding="utf-8")
        report = ImageReport(
            title=source.name,
            command=shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
            track=track,
            metrics=metrics,
            errors=errors,
            configuration=as_run.model_dump(mode="json", include=_used_tables(source)),
            versions=versions,
        )
        write_image_report(staging / REPORT_FILE, report)
    return ImageRunSummary(out, metrics)


def _open(recording: Path, pipeline: Pipeline) -> _Source:
    if is_image_sequence(recording):
        images = open_images(recording)
        table = pipeline.feature_tracker
        return _Source(
            name=images.name,
            place=recording,
            folder=recording.parent if recording.is_file() else recording,
            camera=images.camera,
            pixel_sigma_px=table.pixel_sigma_px,
            frames=track_features(images.read(), images.camera, table),
            count=len(images.times_s),
            is_images=True,
        )
    if recording.is_dir() and not (recording / CAMERA_FILE).is_file():
        raise InputError(recording / CAMERA_FILE, "file", "expected the camera of the recording")
    if not is_monocular_recording(recording) and recording.name != MONOCULAR_TRACKS_FILE:
        expected = f"expected {MONOCULAR_TRACKS_FILE}, images or a video, with {CAMERA_FILE}"
        raise InputError(recording, "recording", expected)
    tracks = read_monocular(recording)
    folder = recording.parent if recording.is_file() else recording
    frames, count = iter(tracks.frames), len(tracks.frames)
    sigma_px = tracks.pixel_sigma_px
    return _Source(tracks.name, folder, folder, tracks.camera, sigma_px, frames, count, False)


def _chain(
    source: _Source, pipeline: Pipeline, on_frame: OnFrame | None
) -> tuple[MonocularTracks, list[ChainFrame]]:
    """All frames, and what became of each."""
    chain = ImageMotionChain(source.camera, source.pixel_sigma_px, pipeline.image_motion)
    frames: list[MonocularFrame] = []
    chained: list[ChainFrame] = []
    for frame in source.frames:
        frames.append(frame)
        chained.append(chain.step(frame))
        if on_frame is not None:
            # A damaged video may end before, or after, what its header says.
            on_frame(chained[-1], len(frames), max(source.count, len(frames)))
    if not frames:
        raise InputError(source.place, "file", "expected at least one frame that can be read")
    tracks = MonocularTracks(source.name, source.camera, source.pixel_sigma_px, tuple(frames))
    return tracks, chained


def _as_run(pipeline: Pipeline, source: _Source) -> Pipeline:
    estimator = EstimatorTable(kind=EstimatorKind.IMAGE_MOTION)
    place = str(source.place.resolve())
    return pipeline.model_copy(update={"sequence": place, "estimator": estimator})


def _used_tables(source: _Source) -> set[str]:
    """What of a pipeline a run reads or adds; the rest of the file describes a simulation."""
    tables = {"sequence", "estimator", "image_motion"}
    return tables | {"feature_tracker"} if source.is_images else tables
