"""The study of Appl. Sci. 2022, 12, 12625 as a list of verbs: track, chain, compare."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pcnav.batch.monte_carlo import runs_of
from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import chi_square_bounds, mean
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.estimators.image_motion.rates import continuous_xyzw, rotation_history
from pcnav.report.panels import panels_figure
from pcnav.simulation.images import TrackFaults

from ..folder import Study, StudyFigure
from ..panels import component_panels
from ..tables import Claim, below, cell, inside, verdict
from ..text import study_of
from ..work import Work
from . import joined, limits, paper, rendered
from .runs import (
    FAULTS,
    KEY_FRAMES,
    NOISES,
    PRINTED,
    STUDY,
    ChainErrors,
    chain_cases,
    errors_table,
    growth_figure,
    interval_cases,
    outcomes_table,
    run_case,
)
from .scene import nutation, path_figure, tracks_of

RUNS = 6
"""Draws of points and noise per case unless told otherwise."""
_QUICK_RUNS = 4
_QUICK_S, _QUICK_JOINED_S = 12.0, 0.1 * joined.DURATION_S
"""With fewer runs than `_QUICK_RUNS` the arcs are so long: a look at the machinery."""
_SEED = 1
_RENDERED_WORK = 100.0
"""Of the rendered images, in frames of a chain: half a minute."""
_HEADLINE = (
    "as printed, 0 px",
    "as printed, 0.1 px",
    "robust, key frames, 0.1 px",
    "as printed, 20 % wrong",
    "robust, key frames, 20 % wrong",
)
"""Cases whose errors at the end stand at the top of the page."""


def study(runs: int, work: Work) -> Study:
    """Rebuild Figs. 5-9 and measure what the paper leaves open.

    Raises `InputError` without the extra `images`, `RunError` when a run fails.
    """
    quick = runs < _QUICK_RUNS
    duration_s = _QUICK_S if quick else paper.DURATION_S
    joined_s = _QUICK_JOINED_S if quick else joined.DURATION_S
    # Every case meets the same points and noise.
    planned = [
        work.plan(run_case, runs_of(STUDY, cases, runs))
        for cases in (
            chain_cases(NOISES, duration_s),
            chain_cases(FAULTS, duration_s),
            interval_cases(duration_s),
        )
    ]
    images = work.plan(rendered.track_images, [duration_s], _RENDERED_WORK)
    inertia = work.plan(joined.run_joined, joined.joined_runs(runs, joined_s))
    work.run()
    noises, faults, intervals = (
        [ChainErrors.of(parts) for parts in each.by_case.values()] for each in planned
    )
    intervals += [each for each in noises if each.case.name.endswith(" 0.1 px")]
    intervals.sort(key=lambda each: each.case.settings.interval_s)
    groups = {"noise": noises, "faults": faults, "intervals": intervals}
    named = {each.case.name: each for each in [*noises, *faults]}
    half_sides_m, _ = paper.hull_half_sides_m()
    low, high = chi_square_bounds(joined.SIZE * runs)
    (tracked,) = images.results
    return study_of(
        Path(__file__).parent,
        runs,
        [
            verdict(
                [
                    *rendered.rendered_claims(tracked),
                    *_claims(named, inertia.by_case, joined_s),
                ],
                *("figure", "expected"),
            ),
            rendered.rendered_table(tracked),
            *(errors_table(key, found) for key, found in groups.items()),
            *(outcomes_table(key, found) for key, found in groups.items()),
            joined.joined_table(inertia.by_case, joined_s),
            limits.accuracy_table(),
            limits.degenerate_table(),
            limits.translation_table(),
        ],
        [
            *rendered.rendered_figures(tracked),
            *_paper_figures(duration_s),
            growth_figure("growth", noises, ("0.1 px", "0.5 px")),
            growth_figure("growth_faults", faults, tuple(FAULTS)),
        ],
        shown=("verdict", "noise", "faults", "intervals", "inertia_from_images"),
        pipelines={},
        ends="\n".join(
            f"- attitude error at the end, {name}: {cell(named[name].error_at_end)} deg"
            for name in _HEADLINE
        ),
        sides=" x ".join(cell(2.0 * side) for side in half_sides_m),
        joined=joined,
        joined_bounds=f"{low / joined.SIZE / runs:.2f} to {high / joined.SIZE / runs:.2f}",
        limits=limits,
        displacement=cell(np.linalg.norm(limits.DISPLACEMENT_M)),
    )


def _claims(
    named: Mapping[str, ChainErrors],
    inertia: Mapping[str, Sequence[joined.JoinedErrors]],
    joined_s: float,
) -> list[Claim]:
    """What the paper shows, of exact matches, and what is asked of the robust chain beyond."""
    printed, robust = named["as printed, 0 px"], named["robust, key frames, 0.1 px"]
    wrong = named["robust, key frames, 20 % wrong"]
    nees = "NEES of the attitude, robust, key frames"
    found = [
        below(*("Fig. 8", "attitude as printed, exact matches, deg"), [printed.error_at_end], 0.01),
        below(*("Fig. 9", "rate as printed, exact matches, deg/s"), [printed.rate_rms], 0.01),
        below(
            "-", "attitude at the end, robust, key frames, 0.1 px, deg", [robust.error_at_end], 1.0
        ),
        below("-", "the same with 20 % wrong matches, deg", [wrong.error_at_end], 1.0),
        below("-", f"{nees}, 0.1 px, over dof", [mean(robust.nees)], 1.5),
        below("-", f"{nees}, 20 % wrong matches, over dof", [mean(wrong.nees)], 1.5),
    ]
    for name, runs in inertia.items():
        judged = joined.nees_at(runs, joined_s)
        found.append(inside("-", f"NEES of the inertia ratios from images, {name}", judged))
    return found


def _paper_figures(duration_s: float) -> list[StudyFigure]:
    truth = nutation(duration_s, paper.INTERVAL_S, _SEED)
    figures = [path_figure(truth)]
    for suffix, sigma, settings in (
        ("", 0.0, PRINTED),
        ("_noisy", 0.1, PRINTED),
        ("_robust", 0.1, KEY_FRAMES),
    ):
        tracks = tracks_of(truth, TrackFaults(sigma), _SEED)
        history = rotation_history(run_chain(tracks, settings), settings)
        # (17) takes the quaternion of R_i = R_cam_body; the camera is at rest here.
        for key, labels, true, estimated in (
            (
                "fig_8",
                ("q1", "q2", "q3", "q4"),
                continuous_xyzw(truth.R_world_body),
                _same_signs(history.R_cam_body),
            ),
            (
                "fig_9",
                ("x, deg/s", "y, deg/s", "z, deg/s"),
                np.rad2deg(truth.omega_body),
                np.rad2deg(history.omega_body),
            ),
        ):
            panels = component_panels(labels, true, {"images": estimated}, history.time_s, ".--")
            figures.append(StudyFigure(f"{key}{suffix}", panels_figure(truth.times_s, panels)))
    return figures


def _same_signs(R: FloatArray) -> FloatArray:
    quaternions = continuous_xyzw(R)
    return quaternions if quaternions[0, 3] > 0.0 else -quaternions
