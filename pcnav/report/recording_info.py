"""What is in a recording, in words: for whoever wants to know before it is run."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_angle
from pcnav.evaluation.size_check import size_doubt, view_spans
from pcnav.files.text_table import TextTable, number
from pcnav.recordings.bop_models import stated_symmetries
from pcnav.recordings.frame_checks import units_doubt
from pcnav.recordings.frame_survey import FrameSurvey, FrameSurveyor
from pcnav.recordings.recording import Recording
from pcnav.recordings.sequence import Frame, Sequence
from pcnav.recordings.time_doubts import time_doubts
from pcnav.target.satellite import Target

_BINS, _BAR = 12, 30
_PER_FRAME = 2_000
"""Returns of a frame that the histogram counts."""
_FAR_M, _NEAR_M = 500.0, 0.02
"""Returns farther than the one and nearer than the other are hardly metres."""
_OFF_CENTRE = 0.1
"""Share of the image's size that a principal point may be off the middle."""
_FEW_SHARE = 0.002
_STILL_M, _STILL_RAD = 1e-9, 1e-9


@dataclass(frozen=True)
class RecordingInfo:
    """What `pcnav info` says."""

    rows: tuple[tuple[str, str], ...]
    """What, and what of it."""
    ranges: TextTable | None
    """Histogram of the depths; None without a return."""
    doubts: tuple[str, ...]
    """What looks wrong, a sentence each."""


class _Frames:
    """Takes in the frames of a recording, and what cannot be read of it."""

    def __init__(self, sequence: Sequence, on_frame: Callable[[int, int], None] | None) -> None:
        surveyor, samples, before = FrameSurveyor(), [], None
        self.bad: list[str] = []
        self.repeated, self.differing = 0, 0
        self.first: Frame | None = None
        for index in range(len(sequence)):
            try:
                frame = sequence.frame(index)
            except InputError as error:
                self.bad.append(str(error))
                continue
            surveyor.add(frame)
            seen = frame.depth_m[frame.depth_m > 0.0]
            samples.append(seen[:: max(1, len(seen) // _PER_FRAME)])
            if len(seen) and self.first is None:
                self.first = frame
            if before is not None and len(seen):
                same = bool(np.array_equal(before, frame.depth_m))
                self.repeated, self.differing = self.repeated + same, self.differing + (not same)
            before = frame.depth_m
            if on_frame is not None:
                on_frame(index + 1, len(sequence))
        self.survey: FrameSurvey = surveyor.survey()
        self.depths: FloatArray = np.concatenate([*samples, np.zeros(0)]).astype(np.float64)


def recording_info(
    recording: Recording,
    format_name: str,
    target: Target | None = None,
    has_truth: bool | None = None,
    on_frame: Callable[[int, int], None] | None = None,
) -> RecordingInfo:
    """Of a recording that is open, and of the target where it is given."""
    rows = [
        ("recording", str(recording.path)),
        ("format", f"{format_name} ({recording.kind.value.replace('_', ' ')})"),
        ("frames", str(len(recording))),
    ]
    if has_truth is not None:
        rows.append(("truth", "yes" if has_truth else "none"))
    if not isinstance(recording, Sequence):
        return RecordingInfo(tuple(rows), None, ())
    frames = _Frames(recording, on_frame)
    rows += [*_times(recording), *_camera(recording), *_contents(recording, frames)]
    doubts = [*time_doubts(recording.times_s), *_frame_doubts(recording, frames)]
    if target is not None:
        rows += _target_rows(target)
        doubts += _target_doubts(target, frames)
    return RecordingInfo(tuple(rows), _histogram(frames.depths), tuple(doubts))


def _times(sequence: Sequence) -> list[tuple[str, str]]:
    time_s, zero_s = sequence.times_s, sequence.info.time_zero_s
    rows = [("time", f"{time_s[0]:.6g} to {time_s[-1]:.6g} s")]
    if zero_s:
        rows.append(("time 0", f"stamp {zero_s!r} s"))
    if len(time_s) > 1:
        step_s = float(np.median(np.diff(time_s)))
        rows.append(("rate", f"{number(1.0 / step_s)} frames/s (a step of {number(step_s)} s)"))
    return rows


def _camera(sequence: Sequence) -> list[tuple[str, str]]:
    camera = sequence.camera(0)
    fov = np.degrees(2.0 * np.arctan(0.5 * np.array(sequence.size) / [camera.fx, camera.fy]))
    lens = "none" if camera.distortion is None else str(camera.distortion.model)
    changes = "" if np.ptp(sequence.intrinsics, axis=0).max() == 0.0 else ", of the first frame"
    steps = sequence.depth_step_m
    scans = sequence.read_scan is not None
    unit = "floats in metres" if np.isnan(steps[0]) else f"{number(1000.0 * float(steps[0]))} mm"
    if np.ptp(steps) > 0.0:
        unit += ", of the first frame"
    return [
        (
            "pixels" if scans else "image",
            f"{camera.width} x {camera.height} px, {fov[0]:.1f} x {fov[1]:.1f} deg",
        ),
        (
            "fx, fy, cx, cy",
            f"{camera.fx:.6g}, {camera.fy:.6g}, {camera.cx:.6g}, {camera.cy:.6g} px{changes}",
        ),
        ("lens distortion", lens),
        ("stored unit", "ranges in metres" if scans else f"{unit}, {sequence.form.depth_is}"),
        ("camera's pose", _moved(sequence)),
    ]


def _moved(sequence: Sequence) -> str:
    T = sequence.T_cam_world
    turn = rotation_angle(T[:, :3, :3] @ T[0, :3, :3].T).max()
    places = -np.einsum("nji,nj->ni", T[:, :3, :3], T[:, :3, 3])
    shift_m = np.linalg.norm(places - places[0], axis=1).max()
    if turn <= _STILL_RAD and shift_m <= _STILL_M:
        return "at rest, or not recorded"
    return f"moves by up to {number(float(shift_m))} m and {number(float(np.degrees(turn)))} deg"


def _contents(sequence: Sequence, frames: _Frames) -> list[tuple[str, str]]:
    survey, info = frames.survey, sequence.info
    pixels = sequence.size.width * sequence.size.height
    counts = survey.n_returns
    share = f"{100.0 * float(np.median(counts)) / pixels:.3g}" if len(counts) else "no"
    sigma = "not stated" if info.range_sigma_m is None else f"{number(info.range_sigma_m)} m"
    mesh = "none named" if info.target_mesh is None else str(info.target_mesh)
    rate = info.mean_motion_rad_s
    rows = [
        *_scans(sequence, frames.first),
        ("returns", f"{share} % of the pixels, median over the frames"),
        ("depth", f"{number(survey.near_m)} to {number(survey.far_m)} m, median over the frames"),
        ("range noise", sigma),
        ("orbit", "a laboratory" if rate == 0.0 else f"mean motion {number(rate)} rad/s"),
        ("target", mesh),
    ]
    symmetries = None if info.target_mesh is None else stated_symmetries(Path(info.target_mesh))
    if symmetries is not None:
        motions, axes = symmetries
        said = f"{len(motions)} turns" + (f", round about {axes} axes" if axes else "")
        rows.append(("stated symmetry", f"{said} (models_info.json)"))
    return rows


def _scans(sequence: Sequence, first: Frame | None) -> list[tuple[str, str]]:
    """Of a recording of scans."""
    if first is None or first.beams is None:
        return []
    beams, lasts_s = first.beams, sequence.info.scan_s
    n, returned = len(beams.rays), int(np.count_nonzero(beams.depth_m))
    beside = ", the beams without one are known" if returned < n else ""
    times = f"one after the other in {number(lasts_s)} s" if lasts_s else "without times"
    return [("scan", f"{n:,} beams {times}; {returned:,} returned{beside}")]


def _frame_doubts(sequence: Sequence, frames: _Frames) -> list[str]:
    survey, camera, doubts = frames.survey, sequence.camera(0), []
    n = len(sequence)
    if frames.bad:
        doubts.append(f"{len(frames.bad)} of {n} frames cannot be read; the first: {frames.bad[0]}")
    if survey.n_empty:
        doubts.append(f"{survey.n_empty} of {n} frames are without any return")
    if frames.repeated and frames.differing:
        doubts.append(f"{frames.repeated} frames bring the image of the frame before once more")
    if survey.near_m > _FAR_M:
        doubts.append(f"the nearest returns are {number(survey.near_m)} m away: millimetres?")
    if survey.far_m < _NEAR_M:
        doubts.append(f"the farthest returns are {number(survey.far_m)} m away: another unit?")
    size = np.array(sequence.size)
    off = np.abs(np.array([camera.cx, camera.cy]) - 0.5 * (size - 1)) / size
    if off.max() > _OFF_CENTRE:
        doubts.append(
            f"the principal point {camera.cx:.6g}, {camera.cy:.6g} px is far off the middle of "
            f"{camera.width} x {camera.height} px: intrinsics of another image size?"
        )
    pixels = sequence.size.width * sequence.size.height
    if len(survey.n_returns) and 0 < np.median(survey.n_returns) < _FEW_SHARE * pixels:
        doubts.append("hardly any pixel has a return")
    return doubts


def _target_rows(target: Target) -> list[tuple[str, str]]:
    size = " x ".join(number(float(side)) for side in target.mesh.extents)
    return [
        ("target as read", f"{target.name}: {size} m, {number(target.diameter_m)} m across"),
        ("target's symmetry", target.symmetry_name),
    ]


def _target_doubts(target: Target, frames: _Frames) -> list[str]:
    doubts = []
    if frames.first is not None:
        units = units_doubt(frames.first.depth_m, frames.first.camera, target.diameter_m)
        size = size_doubt(frames.survey, view_spans(target), target.mesh_origin.metres_per_unit)
        doubts = [doubt for doubt in (units, size) if doubt is not None]
    if target.mesh_origin.unit_doubt is not None:
        doubts.append(f"the mesh is {target.mesh_origin.unit_doubt}")
    return doubts


def _histogram(depths: FloatArray) -> TextTable | None:
    """Of depths (n,), m, between the nearest and the farthest."""
    if not len(depths):
        return None
    low, high = float(depths.min()), float(depths.max())
    # Far walls and stray returns would leave the target in one bin.
    spaced = np.geomspace if high > 10.0 * low else np.linspace
    edges = spaced(low, max(high, low * (1.0 + 1e-6)), _BINS + 1)
    counts, _ = np.histogram(depths, edges)
    counts[-1] += len(depths) - int(counts.sum())
    most = max(int(counts.max()), 1)
    rows = tuple(
        (
            f"{edges[k]:.4g} to {edges[k + 1]:.4g}",
            "#" * round(_BAR * counts[k] / most),
            f"{100.0 * counts[k] / len(depths):.1f}",
        )
        for k in range(_BINS)
    )
    return TextTable("ranges", "Depths", ("m", "", "%"), rows, text_columns=2)
