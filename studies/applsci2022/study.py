"""The study of Appl. Sci. 2022, 12, 12625 as a list of verbs: track, chain, compare."""

import numpy as np

from pcnav.config.image_motion import ImageMotionTable
from pcnav.core.arrays import FloatArray
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.estimators.image_motion.rates import continuous_xyzw, rotation_history
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.files.text_table import TextTable, number
from pcnav.simulation.images import TrackFaults

from ..folder import Chapter, Study, StudyFigure
from ..progress import Progress
from ..work import Work
from . import campaign, joined, paper
from .campaign import CaseErrors, run_cases, work_of
from .figures import comparison_figure, curves_figure, feature_figure, path_figure, track_figure
from .limits import limits_chapter
from .scene import nutation, tracks_of

RUNS = 6
"""Draws of points and noise per case unless told otherwise."""
_QUICK_RUNS = 4
_QUICK_S = 12.0
"""With fewer runs than `_QUICK_RUNS` the arc is so long: a look at the machinery."""
_SEED = 1


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 5-9 and measure what the paper leaves open.

    Raises `InputError` without the extra `images`, `RunError` when a run fails.
    """
    duration_s = _QUICK_S if runs < _QUICK_RUNS else paper.DURATION_S
    noise = campaign.noise_cases(duration_s)
    faults = campaign.fault_cases(duration_s)
    intervals = campaign.interval_cases(duration_s)
    cases = [*noise, *faults, *intervals]
    arc_s = joined.DURATION_S if runs >= _QUICK_RUNS else 0.1 * joined.DURATION_S
    tasks = joined.joined_tasks(runs, arc_s)
    units = work_of(cases, runs) + joined.joined_frames(tasks)
    progress = Progress(units, work.on_progress)
    found = run_cases(cases, runs, work.workers, progress)
    by_noise = found[: len(noise)]
    by_fault = found[len(noise) : len(noise) + len(faults)]
    at_one = [each for each in by_noise if each.case.faults.pixel_sigma_px == 0.1]
    by_interval = [*at_one, *found[len(noise) + len(faults) :]]
    return Study(
        title="Appl. Sci. 2022, 12, 12625, rebuilt",
        lead="Motion Estimation of Non-Cooperative Space Objects Based on Monocular Sequence "
        "Images: every figure, and what noise, drift and wrong matches do to it.",
        headline=_headline(by_noise, by_fault),
        chapters=(
            Chapter("Figures 5 to 9", _figures_text(), (), _paper_figures(duration_s)),
            _noise_chapter(by_noise),
            _fault_chapter(by_fault),
            _interval_chapter(by_interval),
            joined.joined_chapter(tasks, work.workers, progress),
            limits_chapter(),
        ),
        summary_keys=("noise", "faults", "intervals", "inertia_from_images"),
        pipelines={},
        runs=runs,
    )


def _figures_text() -> tuple[str, ...]:
    half, _ = paper.hull_half_sides_m()
    sides = " x ".join(number(float(2.0 * side)) for side in half)
    return (
        "The paper prints mass, inertia, rate, range and camera. It does not print the frame "
        "interval (1 s here), the duration (60 s), the points or the size of the satellite: the "
        f"points lie on the uniform box that has the printed mass and inertia, {sides} m. Rates "
        "are read as degrees per second. Figs. 8 and 9 are drawn for the chain as printed with "
        "exact matches, as the paper has it, and for the robust chain at 0.1 px.",
    )


def _paper_figures(duration_s: float) -> tuple[StudyFigure, ...]:
    truth = nutation(duration_s, paper.INTERVAL_S, _SEED)
    exact = tracks_of(truth, TrackFaults(), _SEED)
    figures = [feature_figure(exact), path_figure(truth), track_figure(exact)]
    cases: tuple[tuple[str, str, float, ImageMotionTable], ...] = (
        ("", "as printed, exact matches", 0.0, campaign.PRINTED),
        ("_noisy", "as printed, 0.1 px", 0.1, campaign.PRINTED),
        ("_robust", "robust, key frames, 0.1 px", 0.1, campaign.KEY_FRAMES),
    )
    for suffix, name, sigma, settings in cases:
        tracks = tracks_of(truth, TrackFaults(sigma), _SEED)
        history = rotation_history(run_chain(tracks, settings), settings)
        # (17) takes the quaternion of R_i = R_cam_body; the camera is at rest here.
        figures.append(
            comparison_figure(
                f"fig_8{suffix}",
                f"Fig. 8: quaternion, {name}",
                "Of R_i, scalar last.",
                (truth.times_s, continuous_xyzw(truth.R_world_body)),
                (history.time_s, _same_signs(history.R_cam_body)),
                ("q1", "q2", "q3", "q4"),
            )
        )
        figures.append(
            comparison_figure(
                f"fig_9{suffix}",
                f"Fig. 9: rate, {name}",
                "Inertial, body axes.",
                (truth.times_s, np.rad2deg(truth.omega_body)),
                (history.time_s, np.rad2deg(history.omega_body)),
                ("x, deg/s", "y, deg/s", "z, deg/s"),
            )
        )
    return tuple(figures)


def _same_signs(R: FloatArray) -> FloatArray:
    quaternions = continuous_xyzw(R)
    return quaternions if quaternions[0, 3] > 0.0 else -quaternions


def _noise_chapter(found: list[CaseErrors]) -> Chapter:
    text = (
        "The chain as printed takes every match as right, does not refine and always answers. The "
        "robust chains refine by least squares. The one called every frame compares each frame "
        "with the one before, however uncertain the turn: of a turn that is as large as its own "
        "error the sign can be wrong, and the first-order covariance with it. Those called last "
        "certain and key frames leave such frames out: the first waits until the turn since the "
        "last attitude is certain, the second keeps a key frame while its features stay in view.",
        "While the same features are in view, the errors of successive pairs nearly cancel: they "
        "share the noise of the frame between them. The stated deviation takes that into account, "
        "and key frames then bring attitudes at more frames rather than better ones.",
    )
    table = _errors_table("noise", "Attitude and rate by noise", found)
    panels = {
        f"{noise:g} px": {
            each.case.name.rsplit(",", 1)[0]: (each.times_s[1:], each.curve()[1:])
            for each in found
            if each.case.faults.pixel_sigma_px == noise
        }
        for noise in (0.1, 0.5)
    }
    caption = "RMS attitude error over the runs."
    figure = curves_figure("growth", "Growth of the error", caption, panels, "deg")
    return Chapter("Noise and drift", text, (table, _outcomes_table("noise", found)), (figure,))


def _fault_chapter(found: list[CaseErrors]) -> Chapter:
    text = (
        "Tracks of 15 s: each track ends after that time on average, and its point is found again "
        "under a new number. The errors of pairs no longer cancel, and the chain drifts. Wrong "
        "matches: a fifth of the features of every frame are seen at another place of the target.",
    )
    panels = {
        what: {
            each.case.name.rsplit(",", 1)[0]: (each.times_s[1:], each.curve()[1:])
            for each in found
            if each.case.name.endswith(what)
        }
        for what in ("tracks of 15 s", "20 % wrong")
    }
    caption = "RMS attitude error over the runs, 0.1 px."
    figure = curves_figure("growth_faults", "Growth of the error", caption, panels, "deg")
    table = _errors_table("faults", "Tracks that end and wrong matches, 0.1 px", found)
    tables = (table, _outcomes_table("faults", found))
    return Chapter("Tracks that end, wrong matches", text, tables, (figure,))


def _interval_chapter(found: list[CaseErrors]) -> Chapter:
    ordered = sorted(found, key=lambda each: each.case.interval_s)
    table = _errors_table("intervals", "Attitude and rate by frame interval, 0.1 px", ordered)
    text = (
        "The paper does not print the interval. A short one leaves too little turn between "
        "adjacent frames for the essential matrix; a long one costs rate.",
    )
    return Chapter("The frame interval", text, (table, _outcomes_table("intervals", ordered)))


def _errors_table(key: str, title: str, found: list[CaseErrors]) -> TextTable:
    rows = []
    for each in found:
        end = float(each.times_s[-1])
        rows.append(
            (
                each.case.name,
                f"{each.case.interval_s:g}",
                f"{each.share:.0%}",
                *(
                    number(each.rms_near(at, window))
                    for at, window in ((end / 6, 5.0), (end / 2, 5.0))
                ),
                number(each.rms_near(end, 10.0)),
                number(each.sd_near(end, 10.0)),
                number(each.mean_nees),
                number(each.rate_rms),
            )
        )
    end = found[0].times_s[-1]
    header = (
        "chain",
        "interval, s",
        "frames with an attitude",
        f"error to {end / 6:g} s, deg",
        f"to {end / 2:g} s, deg",
        f"to {end:g} s, deg",
        "stated, deg",
        "NEES per dof",
        "rate, deg/s",
    )
    note = (
        "RMS over the runs of the 5 s (last column of errors: 10 s) up to the time. NEES over all "
        "frames; 1 is a true covariance."
    )
    return TextTable(key, title, header, tuple(rows), note)


def _outcomes_table(key: str, found: list[CaseErrors]) -> TextTable:
    """Frames by what became of them, all runs together; only outcomes that occur have a column."""
    names = [what for what in Outcome if any(each.outcomes.get(what.value) for each in found)]
    rows = [
        (each.case.name, *(str(each.outcomes.get(name.value, 0)) for name in names))
        for each in found
    ]
    header = ("chain", *(name.value.replace("_", " ") for name in names))
    return TextTable(f"{key}_outcomes", "Frames by outcome, all runs", header, tuple(rows))


def _headline(
    by_noise: list[CaseErrors], by_fault: list[CaseErrors]
) -> tuple[tuple[str, str], ...]:
    named = {each.case.name: each for each in [*by_noise, *by_fault]}
    return tuple(
        (f"attitude error at the end, {name}", f"{number(_end(named[name]))} deg")
        for name in (
            "as printed, 0 px",
            "as printed, 0.1 px",
            "robust, key frames, 0.1 px",
            "as printed, 20 % wrong",
            "robust, key frames, 20 % wrong",
        )
    )


def _end(errors: CaseErrors) -> float:
    return errors.rms_near(float(errors.times_s[-1]), 10.0)
