"""From what a format holds to a sequence of depth frames: times in order, what was assumed said."""

import logging
from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcnav.config.recording import RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.recordings.depth_camera import DepthCamera
from pcnav.recordings.depth_form import DepthForm
from pcnav.recordings.depth_image import ImageSize, StoredDepth, read_depth_image, size_of
from pcnav.recordings.sequence import Sequence, SequenceInfo
from pcnav.recordings.sequence_file import SEQUENCE_FILE, read_sequence_file, stated_time_zero
from pcnav.recordings.time_line import MAX_STAMP_S, begins_anew, time_line, zero_of

_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class Parts:
    """What a reader found."""

    path: Path
    """The recording."""
    images: Path
    """Folder or file that the images are in."""
    files: tuple[str, ...]
    """n names in it."""
    camera: DepthCamera
    stamp_s: FloatArray | None = None
    """(n,) as stored, from ``origin_s`` on; None without."""
    T_cam_world: FloatArray | None = None
    """(n, 4, 4); None where the camera's pose is not recorded."""
    read_image: Callable[[Path], StoredDepth] = read_depth_image
    integer_unit_m: float | None = None
    """Metres of a stored integer, as the format has it where nothing is stated."""
    assumed: tuple[str, ...] = ()
    """What the reader assumed, in words."""
    origin_s: int = 0
    """Whole second that stamps count from: those of an epoch leave floats too few digits."""


def assembled(
    parts: Parts, target_mesh: Path | None, table: RecordingTable, skip_bad_frames: bool
) -> Sequence:
    """The sequence, in order of time; what nothing says is assumed and said in one warning.

    Raises `InputError` for times that cannot be put in order, images of another size than the
    camera's, and a first image that cannot be read.
    """
    assumed, n = list(parts.assumed), len(parts.files)
    info, form, stated_zero_s = _info(parts, target_mesh)
    stamp_s = _stamps(parts, table, assumed)
    line = time_line(stamp_s, np.arange(n))
    assumed += line.remarks
    first_s = float(stamp_s[line.kept[0]])
    zero_s = zero_of(parts.origin_s + first_s, stated_zero_s)
    # Summed once more, the first stamp of an epoch would not be exactly time 0.
    passed_s = first_s if zero_s == parts.origin_s + first_s else zero_s - parts.origin_s
    if parts.T_cam_world is None:
        assumed.append("no poses of the camera: a camera at rest assumed")
    if info.range_sigma_m is None:
        assumed.append("the range noise is unknown")
    files = tuple(parts.files[k] for k in line.kept)
    first = _first_image(parts, files, skip_bad_frames)
    step_m = _step_m(parts, first, table, assumed)
    if assumed:
        _LOG.warning("%s: %s", parts.path, "; ".join(assumed))
    poses = np.tile(np.eye(4), (n, 1, 1)) if parts.T_cam_world is None else parts.T_cam_world
    return Sequence(
        path=parts.path,
        info=replace(info, time_zero_s=zero_s),
        images=parts.images,
        files=files,
        size=_size(parts, first),
        times_s=stamp_s[line.kept] - passed_s,
        intrinsics=np.tile(np.array(parts.camera.intrinsics), (len(files), 1)),
        depth_step_m=np.full(len(files), step_m),
        T_cam_world=poses[line.kept],
        form=form,
        read_image=parts.read_image,
    )


def settings_file(path: Path) -> Path:
    """Where what holds for a whole recording may be stated: in its folder, or beside its file."""
    return path / SEQUENCE_FILE if path.is_dir() else path.with_suffix(".toml")


def _info(parts: Parts, target_mesh: Path | None) -> tuple[SequenceInfo, DepthForm, float | None]:
    path, form = settings_file(parts.path), parts.camera.form
    if not path.is_file():
        name = parts.path.absolute().name
        return SequenceInfo(name, 0.0, None, target_mesh), form, None
    info, stated = read_sequence_file(path, target_mesh)
    if not stated.distortion:
        stated = replace(stated, distortion=form.distortion, distortion_model=form.distortion_model)
    return info, stated, stated_time_zero(path)


def _stamps(parts: Parts, table: RecordingTable, assumed: list[str]) -> FloatArray:
    """(n,) seconds, stored or counted."""
    n = len(parts.files)
    if parts.stamp_s is None:
        if table.frame_rate_hz is None:
            assumed.append("no time stamps: 0, 1, 2, ... s assumed (--rate says how many a second)")
        return np.arange(n) / (table.frame_rate_hz or 1.0)
    if table.frame_rate_hz is not None:
        expected = "expected none: the frames have time stamps"
        raise InputError(parts.path, "--rate", expected)
    finite = np.isfinite(parts.stamp_s) & (np.abs(parts.origin_s + parts.stamp_s) < MAX_STAMP_S)
    if not finite.all():
        k = int(np.argmin(finite))
        expected = f"expected seconds, got {parts.stamp_s[k]:g}"
        raise InputError(parts.path, f"time stamp of {parts.files[k]}", expected)
    anew = begins_anew(parts.stamp_s)
    if anew is not None:
        expected = "expected the stamps of one clock, but they begin anew here"
        raise InputError(parts.path, f"time stamp of {parts.files[anew]}", expected)
    return parts.stamp_s


def _first_image(parts: Parts, files: Many[str], skip_bad: bool) -> StoredDepth:
    """The first image, or the first good one. Raises `InputError` as its reader does."""
    failure: InputError | None = None
    for file in files:
        try:
            return parts.read_image(parts.images / file)
        except InputError as error:
            failure = failure or error
            if not skip_bad:
                break
    assert failure is not None, "there is a file"
    raise failure


def _size(parts: Parts, first: StoredDepth) -> ImageSize:
    size, stated = size_of(first), parts.camera.size
    if stated is not None and stated != size:
        expected = f"expected {stated.width} x {stated.height} px as its camera has"
        got = f"got {size.width} x {size.height}"
        raise InputError(parts.path, "image size", f"{expected}, {got}")
    return size


def _step_m(parts: Parts, first: StoredDepth, table: RecordingTable, assumed: list[str]) -> float:
    """Metres of a stored unit: as stated, else as the format has it; floats are metres."""
    stated = table.unit_m or parts.camera.unit_m
    if stated is not None:
        return stated
    if first.dtype.kind == "f":
        return 1.0
    if parts.integer_unit_m is None:
        assumed.append("no unit of depth: integers are taken as millimetres (--unit says another)")
    return parts.integer_unit_m or 0.001
