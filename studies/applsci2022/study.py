"""The study of Appl. Sci. 2022, 12, 12625 as a list of verbs: track, chain, compare."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pcnav.batch.monte_carlo import runs_of
from pcnav.core.arrays import FloatArray
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.estimators.image_motion.rates import continuous_xyzw, rotation_history
from pcnav.simulation.images import TrackFaults

from ..folder import Study, StudyFigure
from ..panels import component_panels, panels_figure
from ..tables import cell
from ..text import study_text
from ..work import Work
from . import joined, paper
from .figures import feature_figure, path_figure, track_figure
from .limits import accuracy_table, degenerate_table, translation_table
from .runs import (
    KEY_FRAMES,
    PRINTED,
    STUDY,
    CaseErrors,
    errors_table,
    fault_cases,
    growth_figure,
    interval_cases,
    noise_cases,
    outcomes_table,
    run_case,
)
from .scene import nutation, tracks_of

RUNS = 6
"""Draws of points and noise per case unless told otherwise."""
_QUICK_RUNS = 4
_QUICK_S, _QUICK_JOINED_S = 12.0, 0.1 * joined.DURATION_S
"""With fewer runs than `_QUICK_RUNS` the arcs are so long: a look at the machinery."""
_SEED = 1


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 5-9 and measure what the paper leaves open.

    Raises `InputError` without the extra `images`, `RunError` when a run fails.
    """
    quick = runs < _QUICK_RUNS
    duration_s = _QUICK_S if quick else paper.DURATION_S
    joined_s = _QUICK_JOINED_S if quick else joined.DURATION_S
    noises, faults = noise_cases(duration_s), fault_cases(duration_s)
    intervals = interval_cases(duration_s)
    cases = [*noises, *faults, *intervals]
    # Every case meets the same points and noise.
    results = work.plan(run_case, runs_of(STUDY, cases, runs))
    inertia = work.plan(joined.run_joined, joined.joined_runs(runs, joined_s))
    work.run()
    by_case = results.by_case
    found = {case.name: CaseErrors.of(case, by_case[case.name]) for case in cases}
    by_noise, by_fault = ([found[case.name] for case in some] for some in (noises, faults))
    at_one = [each for each in by_noise if each.case.settings.faults.pixel_sigma_px == 0.1]
    by_interval = sorted(
        [*at_one, *(found[case.name] for case in intervals)],
        key=lambda each: each.case.settings.interval_s,
    )
    text = study_text(Path(__file__).parent)
    half_sides_m, _ = paper.hull_half_sides_m()
    rms = "RMS attitude error over the runs"
    return Study(
        title=text.title,
        lead=text.lead,
        headline=_headline([*by_noise, *by_fault]),
        chapters=(
            text.chapter(
                "Figures 5 to 9",
                figures=_paper_figures(duration_s),
                sides=" x ".join(cell(2.0 * side) for side in half_sides_m),
            ),
            text.chapter(
                "Noise and drift",
                [
                    errors_table("noise", "Attitude and rate by noise", by_noise),
                    outcomes_table("noise", by_noise),
                ],
                [growth_figure("growth", f"{rms}.", by_noise, ("0.1 px", "0.5 px"))],
            ),
            text.chapter(
                "Tracks that end, wrong matches",
                [
                    errors_table("faults", "Tracks that end and wrong matches, 0.1 px", by_fault),
                    outcomes_table("faults", by_fault),
                ],
                [
                    growth_figure(
                        "growth_faults",
                        f"{rms}, 0.1 px.",
                        by_fault,
                        ("tracks of 15 s", "20 % wrong"),
                    )
                ],
            ),
            text.chapter(
                "The frame interval",
                [
                    errors_table(
                        "intervals", "Attitude and rate by frame interval, 0.1 px", by_interval
                    ),
                    outcomes_table("intervals", by_interval),
                ],
            ),
            text.chapter(
                "Inertia ratios from images alone",
                [joined.joined_table(inertia.by_case, joined_s)],
            ),
            text.chapter(
                "What two views can tell",
                [accuracy_table(), degenerate_table(), translation_table()],
            ),
        ),
        summary_keys=("noise", "faults", "intervals", "inertia_from_images"),
        pipelines={},
        runs=runs,
    )


def _paper_figures(duration_s: float) -> list[StudyFigure]:
    truth = nutation(duration_s, paper.INTERVAL_S, _SEED)
    exact = tracks_of(truth, TrackFaults(), _SEED)
    figures = [feature_figure(exact), path_figure(truth), track_figure(exact)]
    for suffix, name, sigma, settings in (
        ("", "as printed, exact matches", 0.0, PRINTED),
        ("_noisy", "as printed, 0.1 px", 0.1, PRINTED),
        ("_robust", "robust, key frames, 0.1 px", 0.1, KEY_FRAMES),
    ):
        tracks = tracks_of(truth, TrackFaults(sigma), _SEED)
        history = rotation_history(run_chain(tracks, settings), settings)
        # (17) takes the quaternion of R_i = R_cam_body; the camera is at rest here.
        for key, title, caption, labels, true, estimated in (
            (
                f"fig_8{suffix}",
                f"Fig. 8: quaternion, {name}",
                "Of R_i, scalar last.",
                ("q1", "q2", "q3", "q4"),
                continuous_xyzw(truth.R_world_body),
                _same_signs(history.R_cam_body),
            ),
            (
                f"fig_9{suffix}",
                f"Fig. 9: rate, {name}",
                "Inertial, body axes.",
                ("x, deg/s", "y, deg/s", "z, deg/s"),
                np.rad2deg(truth.omega_body),
                np.rad2deg(history.omega_body),
            ),
        ):
            panels = component_panels(labels, true, {"images": estimated}, history.time_s, ".--")
            figures.append(panels_figure(key, title, caption, truth.times_s, panels))
    return figures


def _same_signs(R: FloatArray) -> FloatArray:
    quaternions = continuous_xyzw(R)
    return quaternions if quaternions[0, 3] > 0.0 else -quaternions


def _headline(found: Sequence[CaseErrors]) -> tuple[tuple[str, str], ...]:
    shown = (
        "as printed, 0 px",
        "as printed, 0.1 px",
        "robust, key frames, 0.1 px",
        "as printed, 20 % wrong",
        "robust, key frames, 20 % wrong",
    )
    named = {each.case.name: each for each in found}
    return tuple(
        (f"attitude error at the end, {name}", f"{cell(named[name].error_at_end)} deg")
        for name in shown
    )
