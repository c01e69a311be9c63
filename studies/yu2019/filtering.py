"""Figs. 11-16: the 20-state filter on idealised clouds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import Case, Run
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.statistics import mean, mean_squared
from pcnav.dynamics.blocks import RATIOS
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Panel, panels_figure
from pcnav.simulation.motion import true_motion

from ..blocks import BLOCKS, JUDGED, WHOLE, ShownBlock
from ..folder import StudyFigure
from ..panels import error_panel, mean_squared_panel
from ..pipelines import shortened, with_scenario
from ..tables import Claim, as_printed, table
from . import paper
from .filter_run import FilterRun, disturbed_motion, model_of, run_filter

_DISTURBED_FRAMES = 1600
_DISTURBANCE_STREAM = 100
"""How far the seed of the disturbance is from that of the noise."""
_FRAMES_PER_UNIT = 400
"""Of the progress: about as long as a unit of the other chapters."""
_CONVERGED = 0.1
"""A ratio whose stated deviation fell below this share of its prior has converged."""
_RATIOS = BLOCKS["inertia ratios"]


@dataclass(frozen=True)
class Printed:
    """A printed figure of the filter and the block that it speaks of."""

    figure: str
    block: ShownBlock
    values: tuple[float, float, float]
    """Largest error printed by axis, in the block's unit."""

    @property
    def quantities(self) -> list[str]:
        """By axis."""
        return [f"{self.block.name} {axis}, {self.block.unit}" for axis in "xyz"]


PRINTED = (
    Printed("Fig. 11", BLOCKS["position"], paper.FIG_11_POSITION_MM),
    Printed("Fig. 12", BLOCKS["velocity"], paper.FIG_12_VELOCITY_MM_S),
    Printed("Fig. 13", BLOCKS["mass centre"], paper.FIG_13_MASS_CENTRE_MM),
    Printed("Fig. 14", BLOCKS["attitude"], paper.FIG_14_ATTITUDE_DEG),
    Printed("Fig. 15", BLOCKS["rate"], paper.FIG_15_RATE_DEG_S),
)


@dataclass(frozen=True)
class Filtered:
    """What a run of the filter is given."""

    pipeline: Pipeline
    is_disturbed: bool = False
    """Whether the truth is disturbed as the filter supposes; else it moves freely."""
    outliers: int | None = None
    """Through RANSAC and recognition beside another face; None for the rectangle alone."""


@dataclass(frozen=True)
class FilterRuns:
    """All runs of the chapter."""

    spin: FilterRun
    """The printed motion."""
    slow: FilterRun
    """The same at 1 Hz."""
    extracted: FilterRun
    """The printed motion through RANSAC and recognition."""
    tumble: FilterRun
    disturbed: Sequence[FilterRun]
    """Tumbles."""


def filter_runs(pipeline: Pipeline, tumble: Pipeline, disturbed: int) -> list[Run[Filtered]]:
    """The printed motion, the same at 1 Hz and through RANSAC, a tumble, and so many disturbed
    tumbles."""
    short = shortened(tumble, _DISTURBED_FRAMES)
    first = tumble.seed + 2 * _DISTURBANCE_STREAM
    return [
        _run("printed motion", Filtered(pipeline), pipeline.seed),
        _run("printed motion at 1 Hz", Filtered(_at_1_hz(pipeline)), pipeline.seed),
        _run("printed motion, RANSAC", Filtered(pipeline, outliers=0), pipeline.seed),
        _run("tumble", Filtered(tumble), tumble.seed + 1),
        *(_run("disturbed tumble", Filtered(short, True), first + k, k) for k in range(disturbed)),
    ]


def _run(name: str, filtered: Filtered, seed: int, index: int = 0) -> Run[Filtered]:
    work = filtered.pipeline.scenario.frames / _FRAMES_PER_UNIT
    return Run(Case(name, filtered, work), index, seed)


def filter_motion(run: Run[Filtered]) -> FilterRun:
    """One run: all noise is the seed's."""
    pipeline = run.case.settings.pipeline
    model = model_of(pipeline)
    if run.case.settings.is_disturbed:
        motion = disturbed_motion(pipeline, model, run.seed - _DISTURBANCE_STREAM)
    else:
        motion = true_motion(pipeline)
    return run_filter(motion, pipeline, model, run.seed, run.case.settings.outliers)


def _at_1_hz(pipeline: Pipeline) -> Pipeline:
    """The same time at one frame a second.

    There a variance held over a frame interval and a spectral density are the same number.
    """
    frames = max(2, round(pipeline.scenario.frames / pipeline.scenario.frame_rate_hz))
    psd = paper.DISTURBANCE_VARIANCE
    filtering = pipeline.filter.model_copy(
        update={"acceleration_psd_m2_s3": psd, "angular_acceleration_psd_rad2_s3": psd}
    )
    slow = with_scenario(pipeline, frames=frames, frame_rate_hz=1.0)
    return slow.model_copy(update={"filter": filtering})


def tables(runs: FilterRuns) -> list[TextTable]:
    """Errors, inertia ratios and NEES."""
    return [_error_table(runs), _ratio_table(runs), _nees_table(runs)]


def figures(runs: FilterRuns) -> list[StudyFigure]:
    """Figs. 11-16, the ratios in a tumble, and the NEES."""
    extracted = _spin_figures(runs.extracted, "_ransac")
    return [
        *_spin_figures(runs.spin),
        *extracted,
        _tumble_figure(runs.tumble),
        _nees_figure(runs.disturbed),
    ]


def claims(runs: FilterRuns) -> list[Claim]:
    """Largest errors as printed, and ratios that converge."""
    found = [
        as_printed(each.figure, f"{quantity}{through}", printed, ours)
        for through, run in (("", runs.spin), (", RANSAC and recognition", runs.extracted))
        for each in PRINTED
        for quantity, printed, ours in zip(
            each.quantities, each.values, each.block.shown(run.last_third), strict=True
        )
    ]
    for name, run, printed in (("printed spin", runs.spin, "5"), ("tumble", runs.tumble, None)):
        converged = sum(share < _CONVERGED for share in _prior_shares(run))
        quantity = f"inertia ratios that converge, {name}"
        found.append(Claim("Fig. 16", quantity, printed, converged, converged == _RATIOS.size))
    return found


def _prior_shares(run: FilterRun) -> list[float]:
    """What is left at the end of the prior deviation of every ratio."""
    return [float(share) for share in (run.sd[-1] / run.prior_sd)[_RATIOS.rows]]


def _error_table(runs: FilterRuns) -> TextTable:
    columns = (runs.spin, runs.slow, runs.extracted, runs.tumble)
    rows = []
    for each in PRINTED:
        ours, slow, extracted, tumble = (each.block.shown(run.last_third) for run in columns)
        sd = each.block.shown(runs.spin.sd[-1])
        for k, quantity in enumerate(each.quantities):
            met = bool(ours[k] <= each.values[k])
            rows.append(
                (
                    *(each.figure, quantity, each.values[k], ours[k], met, sd[k]),
                    *(slow[k], extracted[k], tumble[k]),
                )
            )
    return table(
        "figs_11_15",
        (
            *("figure", "quantity", "printed", "ours, 4 Hz", "at most printed"),
            *("stated sd at the end", "ours, 1 Hz", "ours, RANSAC", "ours, tumble"),
        ),
        rows,
        text_columns=2,
    )


def _ratio_table(runs: FilterRuns) -> TextTable:
    rows: list[list[object]] = [[name] for name in RATIOS.components]
    for run in (runs.spin, runs.tumble):
        first, last = (np.abs(_RATIOS.shown(run.errors[k])) for k in (0, -1))
        for k, share in enumerate(_prior_shares(run)):
            rows[k] += [first[k], last[k], f"{share:.2%}", share < _CONVERGED]
    columns = ("first error", "last error", "stated sd over prior", "converged")
    return table(
        "fig_16",
        ("ratio", *(f"{motion}: {c}" for motion in ("spin", "tumble") for c in columns)),
        rows,
    )


def _nees_table(runs: FilterRuns) -> TextTable:
    count, rows = len(runs.disturbed), []
    for name, block in JUDGED.items():
        at_end = np.array([run.nees[name][-1] for run in runs.disturbed])
        judged = mean_squared(block.size * at_end, block.size)
        calm = (run.nees[name] for run in (runs.spin, runs.tumble))
        settled = (mean(nees[2 * len(nees) // 3 :]) for nees in calm)
        rows.append((name, *settled, judged.mean, judged.bounds))
    return table(
        "nees",
        ("block", "printed spin", "tumble", f"disturbed tumble, {count} runs", "95 %"),
        rows,
    )


def _spin_figures(run: FilterRun, suffix: str = "") -> list[StudyFigure]:
    settled = len(run.time_s) // 3
    figures = []
    for each in PRINTED:
        errors, sd = each.block.shown(run.errors), each.block.shown(run.sd)
        panels = [
            error_panel(
                f"{axis}, {each.block.unit}", errors[:, k], sd[:, k], each.values[k], settled
            )
            for k, axis in enumerate("xyz")
        ]
        key = each.figure.lower().replace(". ", "_") + suffix
        figures.append(StudyFigure(key, panels_figure(run.time_s, panels)))
    panels = _ratio_panels(run, settled // 5)
    return [*figures, StudyFigure(f"fig_16_spin{suffix}", panels_figure(run.time_s, panels))]


def _tumble_figure(run: FilterRun) -> StudyFigure:
    settled = int(np.searchsorted(run.time_s, min(100.0, 0.3 * float(run.time_s[-1]))))
    return StudyFigure("fig_16_tumble", panels_figure(run.time_s, _ratio_panels(run, settled)))


def _ratio_panels(run: FilterRun, settled_from: int) -> list[Panel]:
    errors, sd = _RATIOS.shown(run.errors), _RATIOS.shown(run.sd)
    return [
        error_panel(name, errors[:, k], sd[:, k], None, settled_from)
        for k, name in enumerate(RATIOS.components)
    ]


def _nees_figure(runs: Sequence[FilterRun]) -> StudyFigure:
    nees = np.stack([run.nees[WHOLE.name][1:] for run in runs])
    judged = mean_squared(WHOLE.size * nees, WHOLE.size)
    panel = mean_squared_panel("NEES per degree of freedom", judged)
    return StudyFigure("nees", panels_figure(runs[0].nees_time_s[1:], [panel], row_in=2.3))
