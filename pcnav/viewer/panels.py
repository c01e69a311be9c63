"""What is said of one frame: facts, measurements with their outcome, and its depth image."""

from html import escape

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import project_outline
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION, RATE, RATIOS
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.viewer.colouring import range_shades
from pcnav.viewer.frames import ColourBy, Shot
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import (
    ACCEPTED_COLOUR,
    BESIDE,
    PLAIN,
    REJECTED_COLOUR,
    RESIDUAL_STOPS,
    STATUS,
    UNEXPLAINED,
    Rgb,
    coloured,
    hex_of,
)
from pcnav.viewer.render_options import RenderOptions

_PICTURE_PX = 800
_ASPECT = 1.75
"""Width over height: image and plots have to fit a panel together."""
_EMPTY: Rgb = (14, 16, 24)
_AXIS_SHORT = {
    **{"x": "x", "y": "y", "z": "z"},
    **{"theta_x": "turn x", "theta_y": "turn y", "theta_z": "turn z"},
}
_STYLE = "font-size:12px;line-height:1.45;padding:2px 10px"


def facts_html(loaded: LoadedRun, frame: int, magnified: float | None) -> str:
    """Time, status and estimate of a frame; each ± is one standard deviation."""
    run, status = loaded.run, loaded.run.status[frame]
    colour = hex_of(STATUS.get(status, PLAIN))
    head = (
        f"<b>{escape(loaded.name)}</b> · frame {frame} of {len(run) - 1} · "
        f"{run.time_s[frame]:.2f} s · "
        f"<b style='color:{colour}'>{escape(status)}</b>"
    )
    rows = [("estimate", "none")]
    if run.has_estimate[frame]:
        rows = _estimate_rows(loaded, frame)
        drawn = magnified or loaded.magnification(frame)
        if any("±" in told for _, told in rows):
            rows.append(("each ±", "1σ, as stated"))
        if loaded.has(ATTITUDE):
            rows.append(("3σ drawn", "true size" if drawn == 1.0 else f"{drawn:g} × larger"))
    cells = "".join(
        f"<tr><td style='opacity:.75;padding-right:10px;white-space:nowrap'>{name}</td>"
        f"<td>{value}</td></tr>"
        for name, value in rows
    )
    return f"<div style='{_STYLE}'>{head}<table style='border-spacing:0'>{cells}</table></div>"


def _estimate_rows(loaded: LoadedRun, frame: int) -> list[tuple[str, str]]:
    def norm(values: FloatArray) -> float:
        return float(np.linalg.norm(values))

    def list_of(values: FloatArray) -> str:
        return ", ".join(f"{value:.3f}" for value in values)

    values = {
        block: loaded.trajectory[block][frame]
        for block in (POSITION, RATE, CENTRE, RATIOS)
        if loaded.has(block)
    }
    rows = []
    if POSITION in values:
        doubt = f"{1e3 * norm(loaded.sd(POSITION, frame)):.2f} mm"
        rows.append(("range", f"{norm(values[POSITION]):.3f} m ± {doubt}"))
    elif loaded.trajectory.T_cam_target is not None:
        rows.append(("range of the model's origin", f"{norm(loaded.centre(frame)):.3f} m"))
    if loaded.has(ATTITUDE):
        doubt = f"{np.rad2deg(norm(loaded.sd(ATTITUDE, frame))):.4f}"
        rows.append(("attitude", f"± {doubt} deg"))
    if RATE in values:
        rate_sd = np.rad2deg(norm(loaded.sd(RATE, frame)))
        doubt = f" ± {rate_sd:.4f}" if np.isfinite(rate_sd) else ""
        rows.append(("rate", f"{np.rad2deg(norm(values[RATE])):.4f}{doubt} deg/s"))
    if CENTRE in values:
        doubt = f"{1e3 * norm(loaded.sd(CENTRE, frame)):.2f} mm"
        rows.append(("mass centre", f"({list_of(values[CENTRE])}) m ± {doubt}"))
    if RATIOS in values:
        doubt = f"{np.max(loaded.sd(RATIOS, frame)):.2g}"
        rows.append(("Iyy, Izz, Ixy, Ixz, Iyz over Ixx", f"{list_of(values[RATIOS])} ± {doubt}"))
    if loaded.errors is not None and loaded.errors.has_pose[frame]:
        position = norm(loaded.errors.p_cam_m[frame])
        angle = np.rad2deg(norm(loaded.errors.theta_model_rad[frame]))
        rows.append(("true pose error", f"{1e3 * position:.2f} mm, {angle:.4f} deg"))
    return rows


def measurements_html(records: tuple[RectangleRecord, ...]) -> str:
    """The rectangles of a frame: size, standard deviation, what became of each and why."""
    if not records:
        return f"<div style='{_STYLE}'>no rectangle measured in this frame</div>"
    rows = []
    for record in records:
        used = record.outcome == ACCEPTED
        colour = hex_of(ACCEPTED_COLOUR if used else REJECTED_COLOUR)
        depth_sd = 1e3 * float(record.sd[2])
        doubt = f"{depth_sd:.2f}" if np.isfinite(depth_sd) else "unknown"
        distance = "-"
        if np.isfinite(record.squared_distance):
            distance = f"{record.squared_distance:.3g} / {record.gate:.3g}"
        rows.append(
            f"<tr style='vertical-align:top'><td style='color:{colour}'>{'✓' if used else '✗'}</td>"
            "<td style='overflow-wrap:anywhere'>"
            f"{escape(record.rectangle or 'unrecognised')}"
            "<div style='opacity:.75;white-space:nowrap'>"
            f"{record.length_m:.2f} × {record.width_m:.2f} m</div></td>"
            f"<td>{doubt}</td><td style='white-space:nowrap'>{distance}</td>"
            f"<td>{_AXIS_SHORT.get(record.worst_axis, '-')}</td>"
            f"<td style='color:{colour}'>{escape(record.outcome)}</td></tr>"
        )
    names = ("", "rectangle", "σ, mm", "d² / gate", "worst", "outcome")
    head = "".join(
        f"<th style='text-align:left;font-weight:400;opacity:.75'>{name}</th>" for name in names
    )
    # Reasons are broken into lines: what tells why must not lie beyond the panel's edge.
    return (
        f"<div style='{_STYLE}'><table style='border-spacing:6px 1px;margin-left:-6px'>"
        f"<tr>{head}</tr>{''.join(rows)}</table></div>"
    )


def legend_html(
    loaded: LoadedRun, options: RenderOptions, shot: Shot | None, *, has_estimate: bool
) -> str:
    """What the colours of the points mean, how many are drawn, and what lies beside the target."""
    pink, grey = coloured("■", UNEXPLAINED), coloured("■", BESIDE)
    by = options.colour_by
    if loaded.target is None:
        return ""
    if loaded.frames is None:
        return f"<div style='{_STYLE}'>no depth frames on disk</div>"
    drawn = f"<div style='{_STYLE}'>{drawn_text(shot)}</div>"
    if by is ColourBy.PLAIN:
        text = "every return in one colour"
    elif not has_estimate:
        text = f"no estimate: planes found in the frame; {pink} none"
    elif by is ColourBy.RESIDUAL:
        scale_m = options.residual_scale_m or loaded.frames.scale_m
        return _colour_bar(1e3 * scale_m, pink, grey) + drawn
    else:
        what = "face of the model" if by is ColourBy.PLANE else "rectangle of the catalogue"
        text = (
            f"a colour per {what}, the last for all small ones; {pink} not explained "
            f"(over 3σ, or none), {grey} other things"
        )
    return f"<div style='{_STYLE}'>{text}</div>{drawn}"


def drawn_text(shot: Shot | None) -> str:
    """How many of a frame's returns are drawn, and how many belong to other things."""
    if shot is None:
        return "no depth frame at this time"
    text = f"all {shot.n_returns:,} returns drawn"
    if shot.stride > 1:
        text = (
            f"{len(shot.points):,} of {shot.n_returns:,} returns drawn and compared: "
            f"one in {shot.stride} rows and columns"
        )
    if shot.beside_share > 0.0:
        text += f"; {100.0 * shot.beside_share:.0f} % belong to other things"
    return text


def _colour_bar(scale_mm: float, pink: str, grey: str) -> str:
    stops = ",".join(hex_of(stop) for stop in RESIDUAL_STOPS)
    ticks = "".join(
        f"<span>{share * scale_mm:+.3g}</span>" for share in (-1.0, -0.5, 0.0, 0.5, 1.0)
    )
    return (
        f"<div style='{_STYLE}'>"
        "<div style='height:12px;border-radius:2px;"
        f"background:linear-gradient(90deg,{stops})'></div>"
        f"<div style='display:flex;justify-content:space-between'>{ticks}</div>"
        f"range measured minus model, mm: nearer | behind; {pink} off the model, "
        f"{grey} other things</div>"
    )


def frame_picture(
    shot: Shot, records: tuple[RectangleRecord, ...], by: ColourBy, scale_m: float
) -> npt.NDArray[np.uint8]:
    """(height, width, 3) the depth image about the target, segments coloured, rectangles drawn."""
    camera = shot.frame.camera
    rows, columns = (each.astype(np.intp) for each in shot.shown)
    top, left, height, width = _about_target(shot)
    colours: npt.NDArray[np.floating] = np.broadcast_to(
        shot.colours(by, scale_m), shot.points.shape
    ).astype(np.float32)
    if not shot.shows_residuals(by):
        colours = colours * range_shades(shot.points)[:, None]
    rows, columns = rows - top, columns - left
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    part = np.full((height, width, 3), _EMPTY, dtype=np.uint8)
    part[rows[inside], columns[inside]] = colours[inside]
    factor = max(1, round(_PICTURE_PX / width))
    image = Image.fromarray(part).resize(
        (width * factor, height * factor), Image.Resampling.NEAREST
    )
    pen = ImageDraw.Draw(image)
    for record in records:
        corners = record.corners_cam
        if not np.isfinite(corners).all() or corners[:, 2].min() <= 0.0:
            continue
        pixels = (project_outline(camera, corners) - [left, top] + 0.5) * factor
        colour = ACCEPTED_COLOUR if record.outcome == ACCEPTED else REJECTED_COLOUR
        pen.line([*map(tuple, pixels)], fill=colour, width=2)
    return np.asarray(image)


def ray_through(shot: Shot, place: FloatArray) -> FloatArray:
    """(3,) unit direction, camera frame, of a place (2,) in the `frame_picture`, right and down of
    its corner, its sides 1 long."""
    top, left, height, width = _about_target(shot)
    camera = shot.frame.camera
    column, row = place * [width, height] + [left - 0.5, top - 0.5]
    ray = np.array([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, 1.0])
    return np.asarray(ray / np.linalg.norm(ray))


def _about_target(shot: Shot) -> tuple[int, int, int, int]:
    """Top, left, height and width of what is drawn of a frame."""
    rows, columns = (each.astype(np.intp) for each in shot.shown)
    own = np.ones(len(rows), dtype=np.bool_) if shot.beside is None else ~shot.beside
    own = own if own.any() else ~own
    return _window(rows[own], columns[own], shot.frame.depth_m.shape)


def _window(rows: IntArray, columns: IntArray, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """Top, left, height and width about pixels, of one shape, whatever lies outside an image."""
    if not rows.size:
        rows, columns = (np.array([0, size - 1]) for size in shape)
    (up, down), (left, right) = ((int(each.min()), int(each.max())) for each in (rows, columns))
    border = max(1, (down - up) // 8)
    tall = max(down - up + 1 + 2 * border, (right - left + 3) / _ASPECT)
    height, width = int(np.ceil(tall)), int(np.ceil(np.ceil(tall) * _ASPECT))
    return (up + down - height) // 2, (left + right - width) // 2, height, width
