"""Figs. 11-16: the 20-state filter on idealised clouds."""

from dataclasses import dataclass

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.config.pipeline_file import Pipeline
from pcnav.core import chi_square
from pcnav.core.statistics import mean_squared
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
)
from pcnav.files.text_table import TextTable, number
from pcnav.simulation.scenario import true_motion

from ..folder import Chapter, StudyFigure
from ..panels import Panel, error_panel, mean_squared_panel, panels_figure
from ..progress import Progress
from . import paper
from .filter_run import BLOCKS, FilterRun, disturbed_motion, model_of, run_filter, shortened

_AXES = ("x", "y", "z")
_RATIOS = ("Iyy", "Izz", "Ixy", "Ixz", "Iyz")
_DISTURBED_FRAMES = 1600
_FRAMES_PER_UNIT = 400
"""Of the progress: about as long as a unit of the other chapters."""
_CONVERGED = 0.1
"""A ratio whose stated deviation fell below this share of its prior has converged."""


@dataclass(frozen=True)
class Printed:
    """A printed figure of the filter and the part of the error state it speaks of."""

    figure: str
    name: str
    unit: str
    block: slice
    scale: float
    """From SI to the unit."""
    values: tuple[float, float, float]
    """Largest error printed by axis, in the unit."""


_DEGREES = float(np.rad2deg(1.0))
PRINTED = (
    Printed("Fig. 11", "position", "mm", R_HILL, 1e3, paper.FIG_11_POSITION_MM),
    Printed("Fig. 12", "velocity", "mm/s", V_HILL, 1e3, paper.FIG_12_VELOCITY_MM_S),
    Printed("Fig. 13", "mass centre", "mm", COM_MODEL, 1e3, paper.FIG_13_MASS_CENTRE_MM),
    Printed("Fig. 14", "attitude", "deg", THETA_BODY, _DEGREES, paper.FIG_14_ATTITUDE_DEG),
    Printed("Fig. 15", "rate", "deg/s", OMEGA_BODY, _DEGREES, paper.FIG_15_RATE_DEG_S),
)


@dataclass(frozen=True)
class _FilterTask:
    """One run of the filter."""

    name: str
    pipeline: Pipeline
    seed: int
    disturbance_seed: int | None = None
    """None keeps to the calm motion."""

    def __str__(self) -> str:
        return f"{self.name} (seed {self.seed})"


@dataclass(frozen=True)
class FilterResult:
    """Figs. 11-16 and what they come to."""

    chapter: Chapter
    printed_motion: FilterRun
    tumble: FilterRun


def filter_chapter(
    runs: int,
    pipeline: Pipeline,
    tumble: Pipeline,
    frames: int | None,
    workers: Workers,
    progress: Progress,
) -> FilterResult:
    """Filter the printed motion, the tumble and disturbed tumbles.

    ``frames`` cuts every motion to at most so many, for a quick look.
    """
    cut = pipeline.scenario.frames if frames is None else frames
    pipeline, tumble = shortened(pipeline, cut), shortened(tumble, cut)
    calm = [
        _FilterTask("printed motion", pipeline, pipeline.seed),
        _FilterTask("printed motion at 1 Hz", _at_1_hz(pipeline), pipeline.seed),
        _FilterTask("tumble", tumble, tumble.seed + 1),
    ]
    disturbed_tumble = shortened(tumble, _DISTURBED_FRAMES)
    tasks = [
        *calm,
        *(
            _FilterTask("disturbed tumble", disturbed_tumble, first + 200, first + 100)
            for first in range(tumble.seed, tumble.seed + runs)
        ),
    ]
    share = sum(task.pipeline.scenario.frames for task in tasks) / (_FRAMES_PER_UNIT * len(tasks))
    found = run_all(_filter, tasks, workers, lambda: progress.add(share))
    (printed_motion, slow, tumbling), disturbed = found[: len(calm)], found[len(calm) :]
    tables = (
        _error_table(printed_motion, slow, tumbling),
        _ratio_table(printed_motion, tumbling),
        _nees_table(printed_motion, tumbling, disturbed),
    )
    figures = (*_figures(printed_motion), _ratio_figure(tumbling), _nees_figure(disturbed))
    chapter = Chapter(
        "Figs. 11-16: the filter on idealised clouds", _text(pipeline), tables, figures
    )
    return FilterResult(chapter, printed_motion, tumbling)


def _filter(task: _FilterTask) -> FilterRun:
    model = model_of(task.pipeline)
    if task.disturbance_seed is None:
        motion = true_motion(task.pipeline)
    else:
        motion = disturbed_motion(task.pipeline, model, task.disturbance_seed)
    return run_filter(motion, task.pipeline, model, task.seed)


def _at_1_hz(pipeline: Pipeline) -> Pipeline:
    """The same time at one frame a second.

    There a variance held over a frame interval and a spectral density are the same number.
    """
    rate = pipeline.scenario.frame_rate_hz
    frames = max(2, round(pipeline.scenario.frames / rate))
    scenario = pipeline.scenario.model_copy(update={"frames": frames, "frame_rate_hz": 1.0})
    psd = paper.DISTURBANCE_VARIANCE
    filtering = pipeline.filter.model_copy(
        update={"acceleration_psd_m2_s3": psd, "angular_acceleration_psd_rad2_s3": psd}
    )
    return pipeline.model_copy(update={"scenario": scenario, "filter": filtering})


def _error_table(printed: FilterRun, slow: FilterRun, tumble: FilterRun) -> TextTable:
    rows = []
    for each in PRINTED:
        columns = [each.scale * run.last_third[each.block] for run in (printed, slow, tumble)]
        sd = each.scale * printed.sd[-1][each.block]
        for k, axis in enumerate(_AXES):
            ours = float(columns[0][k])
            rows.append(
                (
                    each.figure,
                    f"{each.name} {axis}, {each.unit}",
                    number(each.values[k]),
                    number(ours),
                    "yes" if ours <= each.values[k] else "no",
                    number(float(sd[k])),
                    number(float(columns[1][k])),
                    number(float(columns[2][k])),
                )
            )
    flips = [run.flips for run in (printed, slow, tumble)]
    rejected = [run.rejected for run in (printed, slow, tumble)]
    frames = [len(run.time_s) for run in (printed, slow, tumble)]
    note = (
        "Largest error over the last third of the run. Position and velocity in Hill axes, the "
        f"rest in body axes. Frames: {frames[0]} at 4 Hz, {frames[1]} at 1 Hz, {frames[2]} at 4 "
        f"Hz in the tumble; measurements in a wrong case: {flips[0]}, {flips[1]}, {flips[2]}; "
        f"outside the 99.99 % gate: {rejected[0]}, {rejected[1]}, {rejected[2]}."
    )
    header = (
        "figure",
        "quantity",
        "printed",
        "ours, 4 Hz",
        "at most printed",
        "stated sd at the end",
        "ours, 1 Hz",
        "ours, tumble",
    )
    title = "Figs. 11-15: largest errors after convergence"
    return TextTable("figs_11_15", title, header, tuple(rows), note, text_columns=2)


def _ratio_table(printed: FilterRun, tumble: FilterRun) -> TextTable:
    rows = []
    for k, name in enumerate(_RATIOS):
        index = INERTIA_RATIOS.start + k
        row = [name]
        for run in (printed, tumble):
            share = float(run.sd[-1, index] / run.prior_sd[index])
            row += [
                number(float(abs(run.errors[0, index]))),
                number(float(abs(run.errors[-1, index]))),
                f"{share:.2%}",
                "yes" if share < _CONVERGED else "no",
            ]
        rows.append(tuple(row))
    columns = ("first error", "last error", "stated sd over prior", "converged")
    header = ("ratio", *(f"spin: {c}" for c in columns), *(f"tumble: {c}" for c in columns))
    return TextTable(
        "fig_16",
        "Fig. 16: what becomes of the inertia ratios",
        header,
        tuple(rows),
        "Converged: the filter claims less than a tenth of the prior's deviation. The paper says "
        "that the ratios converge to their true values.",
    )


def _nees_table(printed: FilterRun, tumble: FilterRun, disturbed: list[FilterRun]) -> TextTable:
    rows = []
    for name, block in BLOCKS.items():
        size = block.stop - block.start
        runs = len(disturbed)
        at_end = [float(run.nees[name][-1]) for run in disturbed]
        low, high = np.asarray(chi_square.quantile([0.025, 0.975], runs * size)) / (runs * size)
        rows.append(
            (
                name,
                number(_settled_mean(printed, name)),
                number(_settled_mean(tumble, name)),
                number(float(np.mean(at_end))),
                f"{low:.2f} to {high:.2f}",
            )
        )
    return TextTable(
        "nees",
        "NEES per degree of freedom: 1 where the stated covariance is right",
        ("block", "printed spin", "tumble", f"disturbed tumble, {len(disturbed)} runs", "95 %"),
        tuple(rows),
        "Spin and tumble: mean over the last third of one run, whose true motion has no "
        "disturbance, so less than 1 is expected. Disturbed: mean over runs at their end, the "
        "true motion disturbed as the filter's process noise says; the bounds are of that mean.",
    )


def _settled_mean(run: FilterRun, name: str) -> float:
    values = run.nees[name]
    return float(np.nanmean(values[2 * len(values) // 3 :]))


def _figures(run: FilterRun) -> tuple[StudyFigure, ...]:
    figures = []
    settled = len(run.time_s) // 3
    for each in PRINTED:
        panels = [
            error_panel(
                f"{axis}, {each.unit}",
                each.scale * run.errors[:, each.block][:, k],
                each.scale * run.sd[:, each.block][:, k],
                each.values[k],
                settled,
            )
            for k, axis in enumerate(_AXES)
        ]
        key = each.figure.lower().replace(". ", "_")
        title = f"{each.figure}: {each.name} errors, printed spin"
        caption = "The axes span the last two thirds of the run; dashed: printed maxima."
        figures.append(panels_figure(key, title, caption, run.time_s, panels))
    ratios = "Fig. 16: inertia ratio errors, printed spin"
    caption = "Iyy, Izz and Ixy cannot be observed in this spin; what moves them is noise."
    figures.append(
        panels_figure("fig_16_spin", ratios, caption, run.time_s, _ratio_panels(run, settled // 5))
    )
    return tuple(figures)


def _ratio_figure(run: FilterRun) -> StudyFigure:
    title = "Fig. 16 in a tumble: inertia ratio errors"
    caption = "The same satellite at (0.5, -0.8, 1) deg/s; the axes span the time after 100 s."
    settled = int(np.searchsorted(run.time_s, min(100.0, 0.3 * float(run.time_s[-1]))))
    panels = _ratio_panels(run, settled)
    return panels_figure("fig_16_tumble", title, caption, run.time_s, panels)


def _ratio_panels(run: FilterRun, settled_from: int) -> list[Panel]:
    start = INERTIA_RATIOS.start
    return [
        error_panel(name, run.errors[:, start + k], run.sd[:, start + k], None, settled_from)
        for k, name in enumerate(_RATIOS)
    ]


def _nees_figure(runs: list[FilterRun]) -> StudyFigure:
    nees = np.stack([run.nees["all"][1:] for run in runs])
    judged = mean_squared(STATE_SIZE * nees, STATE_SIZE)
    return panels_figure(
        "nees",
        "Consistency of the filter, disturbed tumble",
        f"Mean over {len(runs)} runs of the whole state's NEES per degree of freedom. It starts "
        "too high: the first seconds are linearised at rates and ratios far from the truth, and "
        "what they seemed to say of the ratios stays in the covariance.",
        runs[0].nees_time_s[1:],
        [mean_squared_panel("NEES per degree of freedom", judged)],
        row_in=2.3,
    )


def _text(pipeline: Pipeline) -> tuple[str, ...]:
    rate = pipeline.scenario.frame_rate_hz
    minutes = pipeline.scenario.frames / rate / 60.0
    return (
        "Printed: the prior (1 m, 0.1 m/s, 0.1 m, 0.1 rad, 0.01 rad/s, 0.1), the disturbance "
        "variance 1e-12, the starting values and the motion. Not printed: orbit, frame rate, "
        f"duration, initial attitude, where the rectangle sits. Taken here: 400 km, {rate:g} Hz, "
        f"{minutes:.0f} minutes, the spin axis along the line of sight at first, the rectangle "
        "across the spin axis through the nominal origin.",
        "The printed disturbance is a variance, so it is held over a frame interval: at 4 Hz a "
        "spectral density of 2.5e-13. At one frame a second the two readings of the 1e-12 are "
        "the same and the filter's bandwidth is wide: its velocity then errs by more than "
        "printed (column 1 Hz). That is the printed noise at that rate, not something to be "
        "tuned.",
        "Along the spin axis the mass centre is hard to tell from the position: the measured "
        "centroid shows their sum, and turning does not move that part. Only the orbit separates "
        "them. An offset fixed in inertial axes does not obey Hill's equations; a wrong split of "
        "c asks for a tidal acceleration of the order n2 c, 1 nanometre per second squared for a "
        "millimetre, which takes thousands of seconds to rise above the noise. Across the spin "
        "axis the mass centre is found within minutes, and in a tumble on all axes.",
        "In the printed spin about z the transverse acceleration depends on Ixz and Iyz only: "
        "these two converge. Iyy, Izz and Ixy act only through transverse rates that are not "
        "there, which is the rank 8 of 11 of a pure spin. The filter's small claims about them "
        "come from linearising at rates that are noise. The spin is also about the axis of the "
        "middle moment (30, 15, 20): a disturbance grows with an e-folding time of 172 s, so a "
        "simulation with any disturbance at all leaves the printed motion and then does show the "
        "ratios. The tumble shows what happens when they can be observed.",
    )
