"""The study of Yu 2019 as a list of verbs: extract, measure, filter, ray-cast, compare."""

from pathlib import Path

import numpy as np
from scipy.stats import binom

from pcnav.core.statistics import root_mean_square

from ..folder import Study
from ..pipelines import shipped, shortened
from ..tables import cell, verdict
from ..text import study_of
from ..work import Work
from . import extraction, filtering, ray_cast, single_frame
from .clouds import Spacing

RUNS = 40
"""Monte Carlo repetitions unless told otherwise."""
_RUNS_PER_DISTURBED = 5
_QUICK_RUNS = 5
_QUICK_FRAMES, _QUICK_BOXSAT_FRAMES = 100, 2
"""With fewer runs than `_QUICK_RUNS` motions are cut to so many frames: a look at the machinery."""
_CUT = f"Motions were cut to {_QUICK_FRAMES} frames because of the few runs asked for."
_NOT_CONVERGED = "A quick look with cut motions: the filter has not converged."
_PIPELINES = ("yu2019", "yu2019_tumble", "yu2019_boxsat")


def study(runs: int, work: Work) -> Study:
    """Rebuild Tables 1-4 and Figs. 8-16, and run the same method on ray-cast frames.

    Raises `InputError` when a pipeline is missing or bad, `RunError` when a run fails.
    """
    quick = runs < _QUICK_RUNS
    cuts = (_QUICK_FRAMES, _QUICK_FRAMES, _QUICK_BOXSAT_FRAMES) if quick else (None,) * 3
    shown = [shipped(name) for name in _PIPELINES]
    spin, tumble, boxsat = (shortened(each, cut) for each, cut in zip(shown, cuts, strict=True))
    moments = work.plan(extraction.compare_moments, extraction.moment_runs(runs, spin.seed))
    turns = work.plan(single_frame.run_turn, single_frame.turns(spin, runs))
    extracted_turns = single_frame.extracted_turns(spin, max(2, runs // _RUNS_PER_DISTURBED))
    searched = work.plan(single_frame.run_turn, extracted_turns)
    disturbed = max(2, runs // _RUNS_PER_DISTURBED)
    filtered = work.plan(filtering.filter_motion, filtering.filter_runs(spin, tumble, disturbed))
    panel = work.plan(ray_cast.panel_errors, ray_cast.panel_runs(spin, runs))
    frames = work.plan(ray_cast.satellite_errors, ray_cast.satellite_runs(boxsat, runs))
    sequences = work.plan(ray_cast.follow_sequence, ray_cast.sequence_runs(boxsat))
    extracted = extraction.extractions(runs, spin.seed)
    work.run()
    even = turns.by_case[Spacing.EVEN]
    calm, slow, through_ransac, tumbling, *disturbed_runs = filtered.results
    filters = filtering.FilterRuns(calm, slow, through_ransac, tumbling, disturbed_runs)
    all_turns = turns.by_case | searched.by_case
    rays = ray_cast.RayCast(panel.results, frames.results, sequences.results)
    claims = [
        *extraction.claims(extracted, moments.results),
        *single_frame.claims(all_turns),
        *filtering.claims(filters),
        *ray_cast.claims(rays),
    ]
    compared = extraction.random_numbers(moments.results)
    low, high = np.asarray(binom.ppf([0.025, 0.975], len(compared), 0.95))
    best = rays.best_panel
    return study_of(
        Path(__file__).parent,
        runs,
        [
            verdict(claims, "figure", "printed"),
            *extraction.tables(extracted, moments.results),
            *single_frame.tables(all_turns),
            *filtering.tables(filters),
            *ray_cast.tables(rays),
        ],
        [
            *single_frame.figures(spin, even[0]),
            *single_frame.figures(spin, all_turns[single_frame.extracted_name(0)][0], "_ransac"),
            *filtering.figures(filters),
            *ray_cast.figures(rays),
        ],
        shown=("verdict",),
        pipelines=dict(zip(_PIPELINES, (*shown[:2], boxsat), strict=True)),
        met=sum(claim.met for claim in claims),
        claims=len(claims),
        flips=sum(int(errors.flipped.sum()) for errors in even),
        turned_frames=single_frame.FRAMES * runs,
        centre_mm=cell(filtering.PRINTED[2].block.shown(filters.spin.last_third).max()),
        panel_mm=cell(root_mean_square(best.position_mm)),
        panel_deg=cell(np.rad2deg(root_mean_square(best.angle_rad))),
        cut=_CUT if quick else "",
        not_converged=_NOT_CONVERGED if quick else "",
        low=low,
        high=high,
        compared=len(compared),
        inside_ranges=sum(number.inside for number in compared),
        spin=spin.scenario,
        minutes=spin.scenario.frames / spin.scenario.frame_rate_hz / 60.0,
        filters=filters,
        disturbed=disturbed,
        searched=len(extracted_turns) // 2,
        ray_cast=ray_cast,
        boxsat=boxsat.scenario,
    )
