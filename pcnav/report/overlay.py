"""A picture of one frame: the depth image, what was recognised in it, and the estimated pose."""

import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from scipy.ndimage import maximum_filter

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, project, project_outline
from pcnav.core.spatial import transform_points
from pcnav.report.figures import CATEGORIES, INK
from pcnav.runs.records import ACCEPTED, RectangleRecord

_WIDTH_IN = 5.8
_SPACE = (0.06, 0.09, 0.16)
_WIREFRAME, _REFUSED = "#facc15", "#f87171"
_PIECES = 24
"""Each edge is judged visible or hidden in this many pieces."""
_HIDING_MARGIN = 0.01
"""A piece is hidden when it lies behind the image by this share of its range."""
_BORDER_PX = 6
_ABOUT_SHARE = 0.3
"""Returns so far beside the target, over its size in the image, are shown with it."""
_MIN_ASPECT = 1.5
"""Width over height of the picture at least."""


def frame_picture(
    depth_m: DepthImage,
    camera: PinholeCamera,
    labels: IntArray | None,
    records: tuple[RectangleRecord, ...],
    wireframe_p_model: FloatArray,
    T_cam_model: FloatArray | None,
) -> Figure:
    """Depth image cropped to the target, with planes, rectangles and the estimated wireframe.

    ``labels`` (height, width) number the planes from 0, negative where there is none. The
    wireframe (n, 2, 3) holds the end points of the mesh's edges, model frame, m; the parts that
    the seen surface hides are drawn thin. Without a pose it is left out.
    """
    edges_cam = np.zeros((0, 2, 3))
    if T_cam_model is not None and len(wireframe_p_model):
        edges_cam = transform_points(T_cam_model, wireframe_p_model.reshape(-1, 3))
        edges_cam = edges_cam.reshape(-1, 2, 3)
        # An edge that reaches behind the camera has no image.
        edges_cam = edges_cam[(edges_cam[:, :, 2] > 0.0).all(axis=1)]
    left, right, top, bottom = _window(depth_m, project(camera, edges_cam).reshape(-1, 2))
    size = (_WIDTH_IN, _WIDTH_IN * (bottom - top) / (right - left))
    figure = Figure(figsize=size, facecolor=_SPACE)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(_shaded(depth_m, labels), interpolation="nearest")
    _draw_wireframe(axes, camera, depth_m, edges_cam)
    for record in records:
        _draw_rectangle(axes, camera, record)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_axis_off()
    return figure


def visible_pieces(
    camera: PinholeCamera, depth_m: DepthImage, edges_cam: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Edges (n, 2, 3) cut into pieces (n * 24, 2, 3), and which of them no surface hides.

    The neighbour of the pixel that is farthest away decides, and a pixel without a return hides
    nothing: edges lie where the depth jumps.
    """
    fractions = np.linspace(0.0, 1.0, _PIECES + 1)[None, :, None]
    points = edges_cam[:, :1] + fractions * (edges_cam[:, 1:] - edges_cam[:, :1])
    pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
    middle = pieces.mean(axis=1)
    farthest = maximum_filter(np.where(depth_m > 0.0, depth_m, np.inf), size=3, mode="nearest")
    u, v = np.rint(project(camera, middle)).astype(np.intp).T
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    surface = np.full(len(pieces), np.inf)
    surface[inside] = farthest[v[inside], u[inside]]
    return pieces, middle[:, 2] <= surface * (1.0 + _HIDING_MARGIN)


def _window(depth_m: DepthImage, p_image: FloatArray) -> tuple[float, float, float, float]:
    """Left, right, top and bottom pixel edges of what is worth showing."""
    height, width = depth_m.shape
    v, u = np.nonzero(depth_m > 0.0)
    if len(p_image):
        # Among other things returns may fill the image.
        low, high = p_image.min(axis=0), p_image.max(axis=0)
        reach = _ABOUT_SHARE * float((high - low).max())
        pixels = np.column_stack([u, v])
        near = ((pixels > low - reach) & (pixels < high + reach)).all(axis=1)
        u, v = u[near], v[near]
    u, v = np.append(u, p_image[:, 0]), np.append(v, p_image[:, 1])
    if not u.size:
        return -0.5, width - 0.5, -0.5, height - 0.5
    left, right = max(u.min() - _BORDER_PX, -0.5), min(u.max() + _BORDER_PX, width - 0.5)
    top, bottom = max(v.min() - _BORDER_PX, -0.5), min(v.max() + _BORDER_PX, height - 0.5)
    # A tall crop would fill the page; space on both sides costs nothing.
    missing = max(_MIN_ASPECT * (bottom - top) - (right - left), 0.0)
    return float(left - 0.5 * missing), float(right + 0.5 * missing), float(top), float(bottom)


def _shaded(depth_m: DepthImage, labels: IntArray | None) -> FloatArray:
    """(height, width, 3) colours: near is light, planes are tinted, space is dark."""
    seen = depth_m > 0.0
    image = np.empty((*depth_m.shape, 3))
    image[:] = _SPACE
    if not seen.any():
        return image
    near, far = np.percentile(depth_m[seen], (1.0, 99.0))
    closeness = np.clip((far - depth_m) / max(far - near, 1e-6), 0.0, 1.0)
    grey = (0.45 + 0.45 * closeness)[..., None]
    image[seen] = np.broadcast_to(grey, image.shape)[seen]
    if labels is not None:
        palette = np.array([to_rgb(colour) for colour in CATEGORIES])
        tinted = seen & (labels >= 0)
        tint = palette[labels[tinted] % len(palette)]
        image[tinted] = 0.5 * image[tinted] + 0.5 * tint
    return image


def _draw_wireframe(
    axes: Axes, camera: PinholeCamera, depth_m: DepthImage, edges_cam: FloatArray
) -> None:
    pieces, visible = visible_pieces(camera, depth_m, edges_cam)
    image = project(camera, pieces)
    for shown, width, opacity in ((~visible, 0.5, 0.35), (visible, 1.4, 1.0)):
        lines = LineCollection(list(image[shown]), colors=_WIREFRAME, linewidths=width)
        # As pixels, the edges of a fine mesh cost no more than a few.
        lines.set(alpha=opacity, rasterized=True)
        axes.add_collection(lines)


def _draw_rectangle(axes: Axes, camera: PinholeCamera, record: RectangleRecord) -> None:
    """The outline and the name, dashed and red when it was not used."""
    corners = record.corners_cam
    if not (np.isfinite(corners).all() and (corners[:, 2] > 0.0).all()):
        return
    used = record.outcome == ACCEPTED
    outline = project_outline(camera, corners)
    colour = "white" if used else _REFUSED
    style = "solid" if used else "dashed"
    axes.plot(outline[:, 0], outline[:, 1], color=colour, linewidth=1.2, linestyle=style)
    u, v = project(camera, corners.mean(axis=0))
    text = axes.text(
        u,
        v,
        record.rectangle,
        color=INK if used else _REFUSED,
        fontsize=9,
        ha="center",
        va="center",
    )
    text.set_path_effects([effects.withStroke(linewidth=2.5, foreground="white")])
