"""What a run says of itself in words: why nothing was found, where it was lost, what was learnt.

Every sentence follows from facts: the statuses and notes of the run, what its frames hold, and
where its estimator looked. Nothing here knows a truth.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.evaluation.doubted import doubted
from pcnav.evaluation.size_check import size_doubt
from pcnav.files.text_table import number
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.view_hypotheses import SearchReport
from pcnav.recordings.frame_survey import FrameSurvey
from pcnav.runs.run import Run

_MIN_RETURNS = 40
"""Fewer returns than this are specks."""
_MAX_PARTIAL_VIEW = 5.0
"""A target so many times larger than all that is seen is not merely cut by the image."""
_SURROUNDED = 3.0
"""Returns that span so many times the target show other things, too."""
_MIN_TARGET_PX = 12.0
"""A target that spans less has no shape to be told by."""
_UNITS = {"feet": 0.3048, "inches": 0.0254, "centimetres": 0.01, "millimetres": 0.001}
"""In metres: those that meshes come in."""
_ROOM = 1.5
"""A target seen in part may be larger than all that is seen by so much."""
_MIN_LOST_FRAMES = 3
_MIN_LOST_SHARE = 0.02
"""A track that ends at least so many frames, and such a share, before the run does was lost."""
_MISSTATED = 2.0
"""Noise so many times larger or smaller than stated is told."""
_COMPARED = 10
"""Frames before and after a loss whose evidence is compared."""


@dataclass(frozen=True)
class Diagnosis:
    """What a run says of itself."""

    found: bool
    """Whether a pose, or whatever the estimator estimates, was claimed in any frame."""
    warnings: tuple[str, ...] = ()
    """Sentences on what went wrong."""
    said: tuple[str, ...] = ()
    """Those that the estimator already said while it ran."""


@dataclass(frozen=True)
class Facts:
    """What is known beside the run's own tables."""

    survey: FrameSurvey | None = None
    """Of depth frames."""
    diameter_m: float = float("nan")
    """Of the target with a model."""
    view_spans: Callable[[], FloatArray] | None = None
    """What it spans when it is seen from many sides, m; see `size_check`."""
    metres_per_unit: float = 1.0
    """The scale by which its mesh was read."""
    min_frames: int = 1
    """Frames that the estimator takes until there can be an estimate."""
    search: SearchReport | None = None
    """Where the target was looked for."""
    noise: SensorNoise | None = None
    """Of the sensor, as it was learnt."""
    stated_sigma_m: float | None = None
    """Its noise along the rays as it was stated; None where it was not."""
    remarks: tuple[str, ...] = ()
    """Sentences that the estimator logged while it ran."""
    mesh_scale: float = 1.0
    """By which the target was found to be larger than its mesh."""


def diagnosis(run: Run, facts: Facts) -> Diagnosis:
    """What the run has to say."""
    claimed = claimed_frames(run)
    if not claimed.any():
        return Diagnosis(False, (nothing_found(run, facts),))
    warnings = (*lost(run, claimed, facts), *of_another_size(facts), *doubted(run, claimed))
    return Diagnosis(True, warnings, (*facts.remarks, *misstated(run, claimed, facts)))


def claimed_frames(run: Run) -> BoolArray:
    """(n,) frames whose estimate the estimator stands for."""
    return run.claimed


def nothing_found(run: Run, facts: Facts) -> str:
    """Why there is no estimate that counts, in one sentence."""
    frames = _counted(len(run), "frame")
    survey = facts.survey
    if survey is None:
        return f"nothing found in {frames}: {_statuses(run)}"
    reasons = _reasons(survey, facts)
    return f"no target found in {frames}: {'; '.join(reasons) or _statuses(run)}"


def _reasons(survey: FrameSurvey, facts: Facts) -> list[str]:
    """Why no target was found in depth frames, the most telling first."""
    n = len(survey.n_returns)
    if survey.n_empty == n:
        return [
            "no frame has any return: is the depth 0 throughout, or taken away by a mask, a range "
            "gate or a region of interest?"
        ]
    reasons = []
    if survey.n_empty:
        reasons.append(f"{_counted(survey.n_empty, 'frame')} without any return")
    most = int(survey.n_returns.max())
    if most < _MIN_RETURNS:
        return [
            *reasons,
            f"at most {most} returns in a frame, fewer than {_MIN_RETURNS} are specks",
        ]
    if n - survey.n_empty < facts.min_frames:
        reasons.append(f"a motion takes {facts.min_frames}")
    reasons += _sizes(survey, facts)
    return reasons if facts.search is None else [*reasons, _searched(facts.search)]


def _sizes(survey: FrameSurvey, facts: Facts) -> list[str]:
    """What the sizes of the target and of what is seen have to do with each other."""
    if facts.view_spans is not None:
        doubt = size_doubt(survey, facts.view_spans(), facts.metres_per_unit)
        if doubt is not None:
            return [doubt]
    diameter_m = facts.diameter_m
    across = f"the target is {_length(diameter_m)} across"
    between = f"the returns lie between {_length(survey.near_m)} and {_length(survey.far_m)}"
    if diameter_m > _MAX_PARTIAL_VIEW * survey.span_m:
        return [f"{between}, {across}: {_unit_question(diameter_m / survey.span_m)}"]
    target_px = survey.pixels_per_radian * diameter_m / survey.near_m
    if target_px < _MIN_TARGET_PX:
        spanned = f"it would span {number(target_px)} px at the nearest of them"
        return [f"{between}, {across}, and {spanned}: is the depth in another unit than metres?"]
    if survey.span_m > _SURROUNDED * diameter_m:
        return [f"the returns span {_length(survey.span_m)}, the target {_length(diameter_m)}"]
    return []


def _searched(search: SearchReport) -> str:
    """Where the target was looked for, and how much of the frame it explained there."""
    planes = f"{_counted(search.n_planes, 'larger plane')} taken out, " if search.n_planes else ""
    if not search.tried:
        return f"{planes}no part of a frame is of its size"
    tried = f"{planes}{_counted(len(search.tried), 'part')} of its size tried"
    best = search.best_inlier_ratio
    if not np.isfinite(best):
        return f"{tried}, none looks like it"
    return f"{tried}, the best place found for it explains {best:.0%} of what is seen there"


def _unit_question(ratio: float) -> str:
    """Which unit the mesh may be in if it is so many times larger than all that is seen."""
    fitting = [name for name, unit in _UNITS.items() if ratio * unit < _ROOM]
    return f"is the mesh in {' or '.join(fitting or ['millimetres'])}?"


def lost(run: Run, claimed: BoolArray, facts: Facts) -> list[str]:
    """That a track ended long before the run did, and on what evidence."""
    last, n = int(np.flatnonzero(claimed)[-1]), len(run)
    missing = n - 1 - last
    if missing < max(_MIN_LOST_FRAMES, _MIN_LOST_SHARE * n):
        return []
    since = slice(last + 1, None)
    sentence = f"followed until frame {last} of {n}, not found since"
    survey = facts.survey
    if survey is not None and not survey.n_returns[since].any():
        return [f"{sentence}: no frame since has any return"]
    ratio = run.notes.get("inlier_ratio")
    if ratio is None:
        return [sentence]
    before = _median(ratio[claimed][-_COMPARED:])
    after = _median(ratio[since][:_COMPARED])
    if not np.isfinite(before + after):
        return [sentence]
    change = f"from {before:.0%} to {after:.0%}"
    return [f"{sentence}: the share of the returns explained went {change}"]


def of_another_size(facts: Facts) -> list[str]:
    """That the target is larger or smaller than its mesh."""
    off = facts.mesh_scale - 1.0
    if off == 0.0:
        return []
    size = f"{100.0 * abs(off):.2g} % {'larger' if off > 0.0 else 'smaller'}"
    return [f"the target is {size} than its mesh, as ranges and outline show it: followed so"]


def misstated(run: Run, claimed: BoolArray, facts: Facts) -> list[str]:
    """That the noise of the frames is not what was stated of it."""
    poses = run.trajectory.T_cam_target
    if facts.noise is None or facts.stated_sigma_m is None or poses is None:
        return []
    range_m = float(np.median(np.linalg.norm(poses[claimed][:, :3, 3], axis=1)))
    learnt_m = facts.noise.sigma_at(range_m)
    ratio = learnt_m / facts.stated_sigma_m
    if 1.0 / _MISSTATED < ratio < _MISSTATED:
        return []
    of = f"{number(1e3 * learnt_m)} mm at {_length(range_m)}"
    stated = f"{number(1e3 * facts.stated_sigma_m)} mm was stated"
    return [f"the range noise of the frames is {of}, where {stated}: the learnt value was used"]


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _statuses(run: Run) -> str:
    counts = Counter(run.status).most_common()
    return ", ".join(f"{name} in {count}" for name, count in counts)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _length(metres: float) -> str:
    """As people say it: 0.15 m, 25 m, 17 km."""
    return f"{number(metres / 1e3)} km" if metres >= 2e3 else f"{number(metres)} m"
