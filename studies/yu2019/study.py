"""The study of Yu 2019 as a list of verbs: extract, measure, filter, ray-cast, compare."""

from pathlib import Path

from pcnav.core.statistics import root_mean_square

from ..folder import Study
from ..pipelines import shipped, shortened
from ..tables import cell, verdict
from ..text import study_text
from ..work import Work
from . import extraction, filtering, ray_cast, single_frame
from .clouds import Spread

RUNS = 40
"""Monte Carlo repetitions unless told otherwise."""
_RUNS_PER_DISTURBED = 5
_QUICK_RUNS = 5
_QUICK_FRAMES, _QUICK_BOXSAT_FRAMES = 100, 2
"""With fewer runs than `_QUICK_RUNS` motions are cut to so many frames: a look at the machinery."""
_PIPELINES = ("yu2019", "yu2019_tumble", "yu2019_boxsat")


def study(runs: int, work: Work) -> Study:
    """Rebuild Tables 1-4 and Figs. 8-16, and run the same method on ray-cast frames.

    Raises `InputError` when a pipeline is missing or bad, `RunError` when a run fails.
    """
    quick = runs < _QUICK_RUNS
    cuts = (_QUICK_FRAMES, _QUICK_FRAMES, _QUICK_BOXSAT_FRAMES) if quick else (None,) * 3
    shown = [shipped(name) for name in _PIPELINES]
    spin, tumble, boxsat = (shortened(each, cut) for each, cut in zip(shown, cuts, strict=True))
    moments = work.plan(
        extraction.compare_moments, extraction.planned_moments(runs, spin.seed), 2.25
    )
    turns = work.plan(single_frame.run_turn, single_frame.turns(spin, runs))
    disturbed = max(2, runs // _RUNS_PER_DISTURBED)
    filtered = work.plan(filtering.filter_motion, filtering.filter_runs(spin, tumble, disturbed))
    panel = work.plan(ray_cast.panel_errors, ray_cast.panel_runs(spin, runs))
    frames = work.plan(ray_cast.satellite_errors, ray_cast.satellite_runs(boxsat, runs))
    sequence_runs = ray_cast.sequence_runs(boxsat)
    sequences = work.plan(ray_cast.follow_sequence, sequence_runs)
    extracted = extraction.extractions(runs, spin.seed)
    work.run()
    even = turns.by_case[Spread.EVEN]
    calm, slow, tumbling, *disturbed_runs = filtered.results
    filters = filtering.FilterRuns(calm, slow, tumbling, disturbed_runs)
    settings = [run.case.settings for run in sequence_runs]
    rays = ray_cast.RayCast(
        panel.results, frames.results, list(zip(settings, sequences.results, strict=True))
    )
    claims = [
        *extraction.claims(extracted, moments.results),
        *single_frame.claims(even),
        *filtering.claims(filters),
        *ray_cast.claims(rays),
    ]
    text = study_text(Path(__file__).parent)
    cut = f"Motions were cut to {_QUICK_FRAMES} frames because of the few runs asked for."
    note = "A quick look with cut motions: the filter has not converged." if quick else ""
    best = rays.best_panel
    centre = filtering.PRINTED[2].block.shown(filters.spin.last_third).max()
    flips = sum(int(errors.flipped.sum()) for errors in even)
    return Study(
        title=text.title,
        lead=text.lead,
        headline=(
            ("figures met", f"{sum(claim.met for claim in claims)} of {len(claims)}"),
            (
                "frames flipped after the ambiguity is solved",
                f"{flips} of {single_frame.FRAMES * runs}",
            ),
            ("largest mass-centre error, last third", f"{cell(centre)} mm"),
            ("ray-cast panel, position RMS", f"{cell(root_mean_square(best.position_mm))} mm"),
            ("ray-cast panel, attitude RMS", f"{cell(root_mean_square(best.angle_deg))} deg"),
        ),
        chapters=(
            text.chapter(
                "Printed against ours",
                [verdict("Every printed figure and ours", claims, "figure", "printed", note)],
                cut=cut if quick else "",
            ),
            extraction.chapter(text, extracted, moments.results),
            single_frame.chapter(text, spin, turns.by_case),
            filtering.chapter(text, spin, filters),
            ray_cast.chapter(text, rays),
        ),
        summary_keys=("verdict",),
        pipelines=dict(zip(_PIPELINES, (*shown[:2], boxsat), strict=True)),
        runs=runs,
    )
