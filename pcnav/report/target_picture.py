"""A picture of a target: how it looks, its rectangles and symmetry, what a start relies on."""

import io
import itertools
import textwrap
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation, transform_points
from pcnav.files.text_table import number
from pcnav.report.figures import ALERT, INK, MUTED, shortened
from pcnav.report.target_view import TargetView, colour_of, view_from
from pcnav.target.satellite import Rectangle, Target

_SIZE_IN, _DPI = (13.0, 8.6), 110
_AXIS_COLOURS = ("#dc2626", "#16a34a", "#2563eb")
_SYMMETRY = "#7c3aed"
_PIECES = 60
_REACH = 0.62
"""A symmetry axis reaches this share of the diameter to either side of the middle."""
_MAX_AXES = 5
_LABEL_ROOM = 0.08
_BORDER = 0.1
"""Of a view, in which its corner signs stand."""
_MAX_ROWS = 14
_MAX_NAMED = 10
_SAME_AXIS = 0.999
_WRAP = 46
_VIEWS = (
    ("from above", (1.0, 0.75, 0.7), (0.0, 0.0, 1.0)),
    ("from below, the other side", (-1.0, -0.75, -0.7), (0.0, 0.0, 1.0)),
    ("along -x", (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ("along -z", (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)),
)
"""Title, direction to the eye and the direction that is up, model frame."""


@dataclass(frozen=True)
class SymmetryAxis:
    """An axis about which a target can be turned and look as before."""

    direction_model: FloatArray
    """(3,) unit vector."""
    point_model: FloatArray
    """(3,) on it, nearest to the middle of the target, m."""
    fold: int | None
    """Turns that make a full one; None for any turn."""

    @property
    def label(self) -> str:
        """As the picture writes it."""
        return "any turn" if self.fold is None else f"{self.fold}-fold"


def target_picture(target: Target) -> Figure:
    """Four views of a target, with rectangles, symmetry axes and model axes, beside facts."""
    figure = Figure(figsize=_SIZE_IN, facecolor="white")
    FigureCanvasAgg(figure)
    axes = symmetry_axes(target)
    for k, (title, direction, up) in enumerate(_VIEWS):
        view = view_from(target, np.array(direction), np.array(up))
        row, column = divmod(k, 2)
        place = (0.01 + 0.335 * column, 0.505 - 0.495 * row, 0.33, 0.455)
        _draw_view(figure.add_axes(place), view, target, axes, title)
    _write_facts(figure.add_axes((0.69, 0.02, 0.3, 0.94)), target)
    return figure


def png_of(figure: Figure) -> bytes:
    """The figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
    return stream.getvalue()


def symmetry_axes(target: Target) -> tuple[SymmetryAxis, ...]:
    """The axes of a target's symmetry, those of most turns first."""
    middle = np.asarray(target.mesh.bounds).mean(axis=0)
    if target.roundness is not None and not target.roundness.is_ball:
        (direction,), point = target.roundness.axes_model, target.roundness.point_model
        return (SymmetryAxis(direction, _nearest(point, direction, middle), None),)
    if target.roundness is not None:
        return ()
    found: list[tuple[FloatArray, FloatArray, float]] = []
    for T in target.symmetry_transforms[1:]:
        vector = log_rotation(T[:3, :3])
        angle = float(np.linalg.norm(vector))
        direction = vector / angle
        # Points of the axis stay where they are, and it leads past the middle somewhere.
        point = np.linalg.lstsq(np.eye(3) - T[:3, :3], T[:3, 3], rcond=1e-6)[0]
        found.append((direction, _nearest(point, direction, middle), angle))
    axes: list[SymmetryAxis] = []
    for direction, point, _ in found:
        if any(abs(float(axis.direction_model @ direction)) > _SAME_AXIS for axis in axes):
            continue
        angles = [a for other, _, a in found if abs(float(other @ direction)) > _SAME_AXIS]
        axes.append(SymmetryAxis(direction, point, round(2.0 * np.pi / min(angles))))
    return tuple(sorted(axes, key=lambda axis: -(axis.fold or 0)))


def _nearest(point: FloatArray, direction: FloatArray, middle: FloatArray) -> FloatArray:
    """(3,) the point of a line nearest to another."""
    return np.asarray(point + direction * float((middle - point) @ direction))


def _draw_view(
    axes: Axes, view: TargetView, target: Target, symmetry: tuple[SymmetryAxis, ...], title: str
) -> None:
    size = view.camera.width
    axes.imshow(view.image, interpolation="antialiased", zorder=1)
    for each in symmetry[:_MAX_AXES]:
        _draw_symmetry(axes, view, each)
    for index, rectangle in enumerate(target.rectangles):
        _draw_rectangle(axes, view, rectangle, index, index < _MAX_NAMED)
    _draw_frame(axes, view)
    _draw_scale(axes, view)
    # The axes of symmetry stand out of the target.
    axes.set_xlim(-_BORDER * size, (1.0 + _BORDER) * size)
    axes.set_ylim((1.0 + _BORDER) * size, -_BORDER * size)
    axes.set_title(title, fontsize=9, color=MUTED, loc="left", pad=2)
    axes.set_axis_off()


def _draw_symmetry(axes: Axes, view: TargetView, axis: SymmetryAxis) -> None:
    """Solid where it is seen, dashed inside and behind the target."""
    reach = _REACH * view.diameter_m * np.linspace(-1.0, 1.0, _PIECES + 1)
    points = axis.point_model + reach[:, None] * axis.direction_model
    pixels, shown = view.pixels(points), view.shown(points)
    pieces = np.stack([pixels[:-1], pixels[1:]], axis=1)
    solid = shown[:-1] & shown[1:]
    dashed = ~solid & (np.arange(_PIECES) % 2 == 0)
    for which, width, level in ((solid, 1.5, 4), (dashed, 0.9, 3)):
        lines = LineCollection(list(pieces[which]), colors=_SYMMETRY, linewidths=width)
        lines.set_zorder(level)
        axes.add_collection(lines)
    if float(np.linalg.norm(pixels[-1] - pixels[0])) < 0.1 * view.camera.width:
        axes.plot(*pixels[-1], "o", color=_SYMMETRY, markersize=5, zorder=4)
        return
    end = pixels[-1] if pixels[-1, 1] < pixels[0, 1] else pixels[0]
    u, v = np.clip(end, -_BORDER * view.camera.width, view.camera.width).tolist()
    taken = np.array([text.get_position() for text in axes.texts]).reshape(-1, 2) - [u, v]
    if not np.any(np.linalg.norm(taken, axis=1) < _LABEL_ROOM * view.camera.width):
        axes.text(u + 5.0, v, axis.label, color=_SYMMETRY, fontsize=8, va="top", zorder=6)


def _draw_rectangle(
    axes: Axes, view: TargetView, rectangle: Rectangle, index: int, named: bool
) -> None:
    half = 0.5 * np.array([rectangle.width_m, rectangle.length_m])
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0], [-1, -1, 0]], float)
    corners[:, :2] *= half
    outline = transform_points(rectangle.T_model_rect, corners)
    share = np.linspace(0.0, 1.0, 21)[:, None]
    colour = np.array(colour_of(index)) * 0.75
    for a, b in itertools.pairwise(outline):
        side = a + share * (b - a)
        # A little inside, where nothing but what stands before it hides it.
        inner = side + 0.02 * (rectangle.T_model_rect[:3, 3] - side)
        pixels, shown = view.pixels(side), view.shown(inner)
        pixels[~shown] = np.nan
        axes.plot(*pixels.T, color=colour, linewidth=1.3, zorder=5)
    centre = rectangle.T_model_rect[:3, 3]
    towards = view.T_cam_model[:3, :3] @ rectangle.T_model_rect[:3, 2]
    faces_us = towards[2] < -0.25 or (rectangle.two_sided and abs(towards[2]) > 0.25)
    if named and faces_us and bool(view.shown(centre[None])[0]):
        u, v = view.pixels(centre).tolist()
        axes.text(
            *(u, v, str(index + 1)),
            color="white",
            fontsize=8,
            ha="center",
            va="center",
            zorder=7,
            bbox={"boxstyle": "circle,pad=0.25", "facecolor": colour, "edgecolor": "white"},
        )


def _draw_frame(axes: Axes, view: TargetView) -> None:
    """The directions of the model axes, in the lower left corner."""
    size = view.camera.width
    start = np.array([0.02, 1.0]) * size
    for k, colour in enumerate(_AXIS_COLOURS):
        tip = 0.075 * size * view.T_cam_model[:2, k]
        if np.linalg.norm(tip) < 0.01 * size:
            axes.plot(*start, "o", color=colour, markersize=4, zorder=6)
            continue
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.4}
        (u, v), (tip_u, tip_v) = start.tolist(), (start + tip).tolist()
        axes.annotate("", (tip_u, tip_v), (u, v), arrowprops=arrow, zorder=6)
        u, v = (start + 1.35 * tip).tolist()
        axes.text(u, v, "xyz"[k], color=colour, fontsize=8, ha="center", va="center", zorder=6)


def _draw_scale(axes: Axes, view: TargetView) -> None:
    """A bar of a round length, in the lower right corner."""
    size = view.camera.width
    middle_m = float(view.T_cam_model[2, 3])
    distance_m = middle_m if middle_m > 0.0 else view.diameter_m
    pixels_per_m = view.camera.fx / distance_m
    wished = 0.22 * size / pixels_per_m
    power = 10.0 ** np.floor(np.log10(wished))
    length_m = float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wished))
    right, level = 1.04 * size, 1.04 * size
    left = right - length_m * pixels_per_m
    axes.plot([left, right], [level, level], color=INK, linewidth=2.0, zorder=6)
    text = f"{length_m:g} m" if length_m >= 0.1 else f"{1e3 * length_m:g} mm"
    axes.text(0.5 * (left + right), level - 6, text, color=INK, fontsize=8, ha="center", zorder=6)


def _write_facts(axes: Axes, target: Target) -> None:
    axes.set_axis_off()
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.0)
    level = 1.0
    for text, colour, size in _lines(target):
        for line in textwrap.wrap(text, _WRAP, subsequent_indent="   ") or [""]:
            level -= 0.0022 * size + 0.004
            axes.text(0.0, level, line, fontsize=size, color=colour, va="bottom")
            level -= 0.0035


def _lines(target: Target) -> list[tuple[str, str, float]]:
    """Text, colour and size of what stands beside the views."""
    low, high = np.asarray(target.mesh.bounds)
    sides = " × ".join(number(side) for side in high - low)
    origin = target.mesh_origin
    hidden = origin.n_faces - len(target.mesh.faces)
    inner = f", {hidden:,} more nobody sees" if hidden else ""
    lines = [
        (shortened(target.name, 30), INK, 15.0),
        (f"x y z: {sides} m, {number(target.diameter_m)} m across", INK, 9.5),
        (f"unit of the file: {origin.unit_text}", INK, 9.5),
        (f"{len(target.mesh.faces):,} faces{inner}", INK, 9.5),
    ]
    if origin.unit_doubt is not None:
        lines.append((origin.unit_doubt, ALERT, 9.5))
    lines += [("", INK, 5.0), ("Symmetry", INK, 11.5), (_symmetry_text(target), INK, 9.5)]
    lines += [("", INK, 5.0), ("What a start relies on", INK, 11.5)]
    lines += [(text, INK, 9.5) for text in start_relies_on(target)]
    if target.rectangles:
        lines += [("", INK, 5.0), ("Rectangles", INK, 11.5)]
    for index, each in enumerate(target.rectangles[:_MAX_ROWS]):
        size = f"{number(each.length_m)} × {number(each.width_m)} m"
        dark = "#{:02x}{:02x}{:02x}".format(*(int(190 * part) for part in colour_of(index)))
        lines.append((f"{index + 1}  {shortened(each.name, 24)}: {size}", dark, 9.0))
    left = len(target.rectangles) - _MAX_ROWS
    if left > 0:
        lines.append((f"and {left} more", MUTED, 9.0))
    return lines


def _symmetry_text(target: Target) -> str:
    if not target.is_symmetric:
        return "none: every attitude looks different"
    axes = symmetry_axes(target)
    shown = f" ({len(axes)} axes, {_MAX_AXES} drawn)" if len(axes) > _MAX_AXES else ""
    return f"{target.symmetry_name}{shown}: attitudes that it maps onto each other are one"


def start_relies_on(target: Target) -> tuple[str, ...]:
    """Sentences on what the target is found by, and what it may be mistaken for."""
    count = len(target.rectangles)
    if not count:
        first = "no rectangle: sampled views of the whole surface propose its poses"
    else:
        kind = "rectangle" if target.rectangles[0].name.split("_")[0] != "equivalent" else "face"
        area = sum(each.area_m2 for each in target.rectangles)
        share = min(area / float(target.mesh.area), 1.0)
        many = f"{count} {kind}{'' if count == 1 else 's'}"
        first = f"{many}, {share:.0%} of the surface, propose first; sampled views where they fail"
    sentences = [first]
    matches = target.near_symmetries
    if matches:
        match = matches[0]
        vector = log_rotation(match.T_model[:3, :3])
        angle = float(np.linalg.norm(vector))
        # About an axis or the opposite one: the way that it mostly points is called positive.
        sign = np.sign(vector[int(np.argmax(np.abs(vector)))])
        axis = " ".join(f"{part:.2f}" for part in np.round(sign * vector / angle, 2) + 0.0)
        sentences.append(
            f"may be mistaken for itself turned by {np.degrees(angle):.0f} deg about ({axis}): "
            f"{match.differing_share:.1%} of what is seen tells them apart"
        )
    return tuple(sentences)
