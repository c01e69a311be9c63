"""Which estimator a recording is run with, and which recording is simulated for an estimator.

Run with is the one asked for, or the one that the kind of the recording has.
"""

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.errors import InputError
from pcnav.estimators.registry import ESTIMATORS
from pcnav.recordings.attitudes import ATTITUDES_FILE
from pcnav.recordings.monocular_tracks import CAMERA_FILE
from pcnav.recordings.opening import ALL_KINDS, format_of
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.tracks import TRACKS_FILE

_BY_DEFAULT = {
    RecordingKind.DEPTH: EstimatorKind.DEPTH,
    RecordingKind.IMAGES: EstimatorKind.IMAGE_MOTION,
}
_ATTITUDES = 'expected one with the estimator "attitude_inertia" for attitudes, as deng2024'
_WITHOUT_DEFAULT = {
    RecordingKind.STEREO_TRACKS: (
        "expected one with an estimator for stereo tracks, as hu2024 or segal2011; "
        f"tracks of one camera have {CAMERA_FILE} beside them"
    ),
    RecordingKind.ATTITUDES: _ATTITUDES,
}
_FOR_KIND = {
    RecordingKind.IMAGES: "images of one camera",
    RecordingKind.STEREO_TRACKS: "feature tracks",
}
_NO_MESH = {
    RecordingKind.IMAGES: "images of one camera, a video among them, are no depth and need none",
    RecordingKind.STEREO_TRACKS: "feature tracks need no mesh",
    RecordingKind.ATTITUDES: "attitudes need no mesh",
}


class Choice(NamedTuple):
    """How a recording is run."""

    estimator: str
    """Key of the registry."""
    kind: RecordingKind
    """As what the path is opened."""


def chosen(
    path: Path, pipeline: Pipeline | None, estimator: str | None, source: Path | str
) -> Choice:
    """The estimator for a recording.

    Args:
        path: of the recording.
        pipeline: whose estimator is taken unless another is asked for; None takes the one that
            the kind of the recording has.
        estimator: asked for.
        source: the file of the pipeline, which an `InputError` names.

    Raises `InputError` for an estimator that does not exist or does not fit the recording, and for
    a recording whose kind has several estimators when none is asked for.
    """
    if estimator is not None:
        return _fitting(path, estimator, source, (path, "--estimator"))
    if pipeline is not None:
        kind = str(pipeline.estimator.kind)
        return _fitting(path, kind, source, (source, "estimator.kind"))
    found = _kind_of(path, ALL_KINDS) or RecordingKind.DEPTH
    if found in _WITHOUT_DEFAULT:
        raise InputError(path, "--pipeline", _WITHOUT_DEFAULT[found])
    return Choice(str(_BY_DEFAULT[found]), found)


def depth_estimator(estimator: str, source: Path | str) -> str:
    """The estimator for depth frames of which nothing is there yet.

    Raises `InputError`, which names the source, for one that does not live on depth frames.
    """
    _require_known(estimator, (source, "estimator.kind"))
    if RecordingKind.DEPTH not in ESTIMATORS[estimator].takes:
        known = [key for key, entry in ESTIMATORS.items() if RecordingKind.DEPTH in entry.takes]
        expected = f"expected one of {', '.join(known)}, which take depth frames, got {estimator}"
        raise InputError(source, "estimator.kind", expected)
    return estimator


def refuse_mesh(path: Path, choice: Choice) -> None:
    """A mesh was given. Raises `InputError` where it is of no use."""
    if choice.kind is not RecordingKind.DEPTH:
        of = RecordingKind.ATTITUDES if choice.estimator == "attitude_inertia" else choice.kind
        raise InputError(path, "--target", f"expected none: {_NO_MESH[of]}")


def simulated_kind(pipeline: Pipeline, source: Path | str = "pipeline") -> RecordingKind:
    """What is simulated of a pipeline: what [scenario] says, else what its estimator lives on.

    Raises `InputError`, which names the source, for an estimator that does not exist.
    """
    estimator = str(pipeline.estimator.kind)
    _require_known(estimator, (source, "estimator.kind"))
    return pipeline.scenario.recording or ESTIMATORS[estimator].takes[0]


def _require_known(estimator: str, asked: tuple[Path | str, str]) -> None:
    if estimator not in ESTIMATORS:
        raise InputError(*asked, f"expected one of {', '.join(ESTIMATORS)}, got {estimator}")


def _fitting(
    path: Path, estimator: str, source: Path | str, asked: tuple[Path | str, str]
) -> Choice:
    """The estimator that is asked for, where ``asked`` says: a file or path, and a field."""
    _require_known(estimator, asked)
    takes = ESTIMATORS[estimator].takes
    kind, found = _kind_of(path, takes), _kind_of(path, ALL_KINDS)
    if kind is not None:
        return Choice(estimator, kind)
    if estimator == EstimatorKind.ATTITUDE_INERTIA:
        expected = f"expected a table of attitudes, a folder with {ATTITUDES_FILE}, or images"
        raise InputError(path, "recording", expected)
    if estimator == EstimatorKind.IMAGE_MOTION:
        raise _no_images(path)
    if found in _FOR_KIND:
        known = [f'"{key}"' for key, entry in ESTIMATORS.items() if entry.takes[0] is found]
        expected = f"expected {' or '.join(known)} for {_FOR_KIND[found]}"
        raise InputError(*asked, f'{expected}, got "{estimator}"')
    if found is RecordingKind.ATTITUDES:
        raise InputError(path, "--pipeline", _ATTITUDES)
    if RecordingKind.STEREO_TRACKS in takes:
        expected = f"expected a folder with {TRACKS_FILE}, or that file"
        whose = f'for the estimator "{estimator}" of {source}'
        raise InputError(path, "folder", f"{expected}, {whose}")
    # The reader of depth frames says what it misses.
    return Choice(estimator, RecordingKind.DEPTH)


def _no_images(path: Path) -> InputError:
    if path.is_dir() and not (path / CAMERA_FILE).is_file():
        return InputError(path / CAMERA_FILE, "file", "expected the camera of the recording")
    expected = f"expected {TRACKS_FILE}, images or a video, with {CAMERA_FILE}"
    return InputError(path, "recording", expected)


def _kind_of(path: Path, kinds: Collection[RecordingKind]) -> RecordingKind | None:
    """What a path holds, the first of some kinds."""
    found = format_of(path, kinds)
    return None if found is None else found.kind
