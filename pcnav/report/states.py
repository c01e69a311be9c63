"""The states of a run over time: their errors where the truth is known, else the estimates."""

import numpy as np
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import finite
from pcnav.dynamics.blocks import ATTITUDE, FILE_ORDER, POSITION, RATE, RATIOS, Block
from pcnav.estimators.image_motion.rates import continuous_xyzw
from pcnav.evaluation.errors import Errors
from pcnav.evaluation.pose_deviations import pose_deviations
from pcnav.files.text_table import display_unit
from pcnav.report.content import ReportContent
from pcnav.report.figures import BOUND, LINE, drawing
from pcnav.report.page import Drawing, Piece
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.runs.run import Run

_AXES = {ATTITUDE: ", body axes", RATE: ", body axes", RATIOS: " over Ixx"}
_FIXED = 1e-12
"""A component is held fixed when it has no deviation and no value above this."""


def block_title(block: Block) -> str:
    """What a block is, and of which axes, as a heading."""
    title = block.title[0].upper() + block.title[1:]
    return title + _AXES.get(block, "")


def states_over_time(content: ReportContent) -> list[Piece]:
    """A figure for the pose and for every block that the run has values of."""
    run, errors = content.run, content.metrics.errors
    if not run.has_estimate.any():
        return []
    figures: list[Piece] = []
    if errors is not None and errors.has_pose.any():
        caption = (
            "Norms of the error of the model origin and of the attitude in the camera, and what "
            "is stated of the direction known least."
        )
        figure = pose_error_figure(run, errors, content.answer.mean_motion_rad_s)
        figures.append(drawing("Pose error", caption, figure))
    elif run.trajectory.T_cam_target is not None and not run.trajectory.layout.blocks:
        p_cam = run.trajectory.T_cam_target[:, :3, 3]
        figure = component_figure(run, p_cam, POSITION.components, "m")
        figures.append(drawing("Model origin in cam", "Estimate.", figure))
    if run.segments:
        figures += _motion(run)
    for block in FILE_ORDER:
        if block in run.trajectory:
            figures += _block_figures(run, errors, block)
    return [tuple(figures)]


def component_figure(
    run: Run,
    values: FloatArray,
    names: tuple[str, ...],
    unit: str,
    sd: FloatArray | None = None,
    *,
    is_error: bool = False,
) -> Figure:
    """Components (n, k) over time, one row each, with their 3 sigma bounds where these are known.

    Magnitudes of errors are drawn beside their bounds on a logarithmic axis, estimates inside
    bounds about themselves, where a start-up transient may leave the axes. No line joins two
    segments.
    """
    starts = np.searchsorted(run.time_s, [segment.time_s for segment in run.segments[1:]])
    time_s = np.insert(run.time_s, starts, run.time_s[starts])
    settled = np.abs(values[run.time_s >= run.time_s[0] + 0.1 * np.ptp(run.time_s)])
    typical = [np.median(column) for column in map(finite, settled.T) if column.size]
    scale, unit = display_unit(unit, float(max(typical, default=1.0)))
    columns = scale * np.insert(values, starts, np.nan, axis=0).T
    bounds = np.full_like(columns, np.nan)
    if sd is not None:
        bounds = 3.0 * scale * np.insert(sd, starts, np.nan, axis=0).T
    panels = []
    for name, value, bound in zip(names, columns, bounds, strict=True):
        label = name if unit == "1" else f"{name}, {unit}"
        if is_error:
            panels.append(error_panel(label, value, bound))
            continue
        known = bool(np.isfinite(bound).any())
        bands = {"3 sigma as stated": (value - bound, value + bound)} if known else {}
        curves = [Curve("estimate", value, colour=LINE)]
        panels.append(Panel(label, curves, Scale.SETTLED, bands=bands, edges=True))
    return panels_figure(time_s, panels)


def error_panel(label: str, error: FloatArray, bound: FloatArray) -> Panel:
    """The magnitude of an error (n,) beside its stated bound (n,), nan without one."""
    curves = [Curve("|error|", np.abs(error), colour=LINE)]
    if np.isfinite(bound).any():
        curves.append(Curve("3 sigma as stated", bound, colour=BOUND, width=1.2))
    return Panel(label, curves, Scale.MAGNITUDE)


def pose_error_figure(run: Run, errors: Errors, mean_motion_rad_s: float | None) -> Figure:
    """Error norms of the pose in the camera over time, beside 3 sigma along the direction that is
    known least."""
    distance = np.linalg.norm(errors.p_cam_m, axis=1)
    scale, unit = display_unit("m", float(np.median(distance[errors.has_pose])))
    angle = np.linalg.norm(errors.theta_model_rad, axis=1)
    shift_sd, turn_sd = pose_deviations(run.trajectory, mean_motion_rad_s)
    panels = [
        error_panel(f"position, {unit}", scale * distance, 3.0 * scale * shift_sd),
        error_panel("attitude, deg", np.rad2deg(angle), 3.0 * np.rad2deg(turn_sd)),
    ]
    return panels_figure(run.time_s, panels, row_in=1.6)


def _block_figures(run: Run, errors: Errors | None, block: Block) -> list[Drawing]:
    """The error of a block against its bounds; without a truth the estimate with them."""
    sd, title, error = run.trajectory.sd_of(block), block_title(block), None
    stated = bool(np.isfinite(sd).any())
    if errors is not None and np.isfinite(errors[block]).any():
        values = error = errors[block]
        caption = "True minus estimated"
        if stated:
            caption += ", its magnitude, and stated 3 sigma"
        if run.segments:
            # The estimate has a figure, too.
            title = f"{block_title(block).split(',')[0]} error"
    elif block is ATTITUDE:
        # It has no zero: its deviations alone are drawn.
        values = np.where(np.isfinite(sd), 0.0, np.nan)
        caption = "Stated 3 sigma of a turn about each axis, about the estimate"
    elif run.segments and not stated:
        return []
    else:
        values = run.trajectory[block]
        caption = "Estimate and stated 3 sigma; the axes fit the run after its first tenth"
    # What the estimator holds fixed, at the truth, has nothing to show.
    size = np.fmax(np.abs(np.nan_to_num(values)), np.nan_to_num(sd)).max(axis=0)
    shown = np.flatnonzero(size > _FIXED)
    if not shown.size:
        return []
    figure = component_figure(
        run,
        block.to_shown * values[:, shown],
        tuple(block.components[k] for k in shown),
        block.shown_unit,
        block.to_shown * sd[:, shown],
        is_error=error is not None,
    )
    return [drawing(title, f"{caption}.", figure)]


def _motion(run: Run) -> list[Drawing]:
    """Attitude and rate of a run in axes of its own, which its errors do not tell."""
    segment = np.searchsorted([each.time_s for each in run.segments], run.time_s, side="right")
    known = np.flatnonzero(run.has_estimate)
    xyzw = np.full((len(run), 4), np.nan)
    xyzw[known] = continuous_xyzw(run.trajectory[ATTITUDE][known], segment[known])
    figure = component_figure(run, xyzw, ATTITUDE.columns, "1")
    figures = [drawing("Attitude", "Quaternion of R_world_body, scalar last.", figure)]
    if RATE in run.trajectory:
        rate = RATE.to_shown * run.trajectory[RATE]
        figure = component_figure(run, rate, RATE.components, RATE.shown_unit)
        figures.append(drawing(block_title(RATE), "Inertial.", figure))
    return figures
