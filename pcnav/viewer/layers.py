"""One frame of a run drawn into a scene: of one browser, or of a file that is exported.

The scene is the camera frame of the chaser: x right, y down, z forward, metres. Nodes are added
once; a frame then changes only what differs from the one before.
"""

from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt
import viser

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.estimators.depth.motion_within import motion_about
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.target.row_motion import Readout
from pcnav.viewer.frames import MAX_POINTS, Shot
from pcnav.viewer.glyphs import closed
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import ACCEPTED_COLOUR, REJECTED_COLOUR, SENSOR, Rgb
from pcnav.viewer.render_options import Layer, RenderOptions, line_colour, place, vector
from pcnav.viewer.target_layer import TargetLayer

_MAX_NAMES = 16
_LETTER_PX = 6.5, 17.0
"""Width and height of a letter of a name on the page, and a little between names."""
PixelsOf = Callable[[FloatArray], FloatArray]
"""Where points (n, 3) are seen on the page, (n, 2)."""
_INSET, _IN_FRONT = 0.95, 0.998
_PIXELS_ACROSS = 1.4
_HALF_PRECISION = 2.0**-11
"""Of a number of 16 bits: its rounding over its value."""


def vertical_fov(camera: PinholeCamera) -> float:
    """Field of view, rad."""
    return float(2.0 * np.arctan(0.5 * camera.height / camera.fy))


def _add_sensor(
    scene: viser.SceneApi, camera: PinholeCamera, size_m: float
) -> viser.CameraFrustumHandle:
    return scene.add_camera_frustum(
        "/sensor",
        fov=vertical_fov(camera),
        aspect=camera.width / camera.height,
        scale=0.15 * size_m,
        thickness=1.5,
        thickness_units="screen",
        color=SENSOR,
        cast_shadow=False,
        receive_shadow=False,
    )


class CloudLayer:
    """The returns of a frame.

    They are told in the estimated model frame and move with it. A browser moves nodes at once but
    may take longer to exchange points: what it draws in between then still fits together.
    """

    def __init__(self, scene: viser.SceneApi, root: str, point_size_m: float) -> None:
        self._point_size_m, self._pixel_m = point_size_m, point_size_m / _PIXELS_ACROSS
        self._points = scene.add_point_cloud(
            f"{root}/points",
            np.zeros((1, 3), dtype=np.float32),
            np.zeros((1, 3), dtype=np.uint8),
            point_size=point_size_m,
            point_shape="square",
            point_shading="flat",
            precision="float32",
            visible=False,
        )
        # New colours make the browser throw its shader away and compile it anew, half a second in
        # software, unless another cloud holds on to it. Its points are too small to be seen; a
        # single one would have its colour, and shader, of another kind.
        scene.add_point_cloud(
            f"{root}/held",
            np.zeros((2, 3), dtype=np.float32),
            np.zeros((2, 3), dtype=np.uint8),
            point_size=1e-6,
            point_shape="square",
            point_shading="flat",
            precision="float32",
        )

    def show(
        self, shot: Shot | None, T_model_cam: FloatArray, options: RenderOptions, scale_m: float
    ) -> None:
        """Draw a frame, or nothing where there is none."""
        visible = shot is not None and Layer.POINTS in options.layers and len(shot.points) > 0
        if shot is not None and visible:
            colours = shot.colours(options.colour_by, options.residual_scale_m or scale_m)
            points = _moved(T_model_cam, shot.points)
            self._points.precision = _precision(points, self._pixel_m * shot.stride)
            self._points.points = points
            self._points.point_size = self._point_size_m * shot.stride * options.point_size
            self._points.colors = np.broadcast_to(colours, shot.points.shape)
        self._points.visible = visible


class RectangleLayer:
    """Outlines of the rectangles seen, and their names; in the model frame, as the cloud."""

    def __init__(self, scene: viser.SceneApi, root: str) -> None:
        self._lines = {
            layer: scene.add_line_segments(
                f"{root}/{name}",
                np.zeros((1, 2, 3), dtype=np.float32),
                # A colour per vertex from the start: lines that were made with one colour are
                # drawn white once they are given several.
                _per_vertex(colour, 1),
                thickness=3.0,
                thickness_units="screen",
                visible=False,
            )
            for layer, name, colour in (
                (Layer.ACCEPTED, "accepted", ACCEPTED_COLOUR),
                (Layer.REJECTED, "rejected", REJECTED_COLOUR),
            )
        }
        self._names = [
            scene.add_label(
                f"{root}/names/{k}",
                "",
                font_screen_scale=0.75,
                anchor="center-center",
                visible=False,
            )
            for k in range(_MAX_NAMES)
        ]
        self._named: list[tuple[str, FloatArray]] = []
        """Names of the frame, and where they stand in the model frame."""

    def show(
        self, records: tuple[RectangleRecord, ...], T_model_cam: FloatArray, options: RenderOptions
    ) -> None:
        """Draw those that have a pose."""
        placed = [record for record in records if np.isfinite(record.T_cam_rect).all()]
        named: list[tuple[str, FloatArray]] = []
        for layer, lines in self._lines.items():
            of_layer = [r for r in placed if (r.outcome == ACCEPTED) is (layer is Layer.ACCEPTED)]
            lines.visible = layer in options.layers and bool(of_layer)
            if not lines.visible:
                continue
            outlines = np.concatenate([_outline(r) for r in of_layer])
            lines.points = _moved(T_model_cam, outlines)
            colour = ACCEPTED_COLOUR if layer is Layer.ACCEPTED else REJECTED_COLOUR
            lines.colors = _per_vertex(colour, len(outlines))
            named += [(_told(r), (T_model_cam @ r.T_cam_rect)[:3, 3]) for r in of_layer]
        self._named = (named if Layer.NAMES in options.layers else [])[:_MAX_NAMES]
        for label, (text, place_model) in zip(self._names, self._named, strict=False):
            label.text, label.position = text, vector(place_model)
        self.keep_apart(None)

    def keep_apart(self, pixels_of: PixelsOf | None) -> None:
        """Show the names that lie apart where they are seen; all where that is not known."""
        shown = np.ones(len(self._named), dtype=np.bool_)
        if pixels_of is not None and self._named:
            places = np.array([place_model for _, place_model in self._named])
            shown = lie_apart(pixels_of(places), [len(text) for text, _ in self._named])
        for k, label in enumerate(self._names):
            label.visible = k < len(shown) and bool(shown[k])


def lie_apart(pixels: FloatArray, letters: Sequence[int]) -> BoolArray:
    """(n,) which of some texts, each about its pixel (n, 2), do not lie over one before them."""
    half = np.column_stack([_LETTER_PX[0] * np.array(letters), np.full(len(letters), 1.0)])
    half[:, 1] *= _LETTER_PX[1]
    shown = np.zeros(len(pixels), dtype=np.bool_)
    for k, pixel in enumerate(pixels):
        over = np.abs(pixels[shown] - pixel) < 0.5 * (half[shown] + half[k])
        shown[k] = not over.all(axis=1).any()
    return shown


def _precision(points: npt.NDArray[np.float32], pixel_m: float) -> Literal["float16", "float32"]:
    """Half the bytes where rounding moves no point by more than is seen: a tenth of its pixel."""
    if not len(points):
        return "float16"
    rounded_m = float(np.abs(points).max()) * _HALF_PRECISION
    return "float16" if rounded_m < 0.1 * pixel_m else "float32"


def _per_vertex(colour: Rgb, n: int) -> npt.NDArray[np.uint8]:
    """(n, 2, 3) a colour for both ends of so many lines."""
    return np.tile(np.array(line_colour(colour), np.uint8), (n, 2, 1))


def _moved(T: FloatArray, points: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
    """(..., 3) points at a pose: to some micrometres, twice as fast as in double precision."""
    return transform_points(T.astype(np.float32), points.astype(np.float32)).astype(np.float32)


def _outline(record: RectangleRecord) -> FloatArray:
    """(4, 2, 3) the sides, a little inside and in front: the mesh's own edges would hide them."""
    corners = record.corners_cam
    centre = corners.mean(axis=0)
    return closed((centre + _INSET * (corners - centre)) * _IN_FRONT)


def _told(record: RectangleRecord) -> str:
    return (
        record.rectangle if record.outcome == ACCEPTED else f"{record.rectangle or '?'} (rejected)"
    )


class RunLayers:
    """All layers of one or two runs in one scene. The cloud and rectangles are the first run's."""

    def __init__(
        self, scene: viser.SceneApi, runs: tuple[LoadedRun, ...], colours: tuple[Rgb, ...]
    ) -> None:
        first = runs[0]
        self._runs = runs
        self._T_cam_model = np.eye(4)
        camera = first.frames.camera() if first.frames is not None else None
        self._sensor = None if camera is None else _add_sensor(scene, camera, first.size_m)
        self._measured = scene.add_frame("/run_1/measured", show_axes=False)
        self._cloud = CloudLayer(scene, "/run_1/measured", _point_size_m(first, camera))
        self._rectangles = RectangleLayer(scene, "/run_1/measured")
        self._targets = [
            TargetLayer(scene, f"/run_{k + 1}", loaded, colour, is_first=k == 0)
            for k, (loaded, colour) in enumerate(zip(runs, colours, strict=False))
        ]

    def show(self, frame: int, shot: Shot | None, options: RenderOptions) -> None:
        """Draw a frame of the first run, and those of the others that are nearest in time."""
        first = self._runs[0]
        time_s = float(first.run.time_s[frame])
        if self._sensor is not None:
            self._sensor.visible = Layer.SENSOR in options.layers
        pose = first.pose(frame)
        T = np.eye(4) if pose is None else pose
        place(self._measured, T)
        T_model_cam = invert_transform(T)
        scale_m = 1.0 if first.frames is None else first.frames.scale_m
        self._cloud.show(shot, T_model_cam, options, scale_m)
        self._rectangles.show(first.records_at(frame), T_model_cam, options)
        self._T_cam_model = T
        for k, (target, loaded) in enumerate(zip(self._targets, self._runs, strict=True)):
            target.show(frame if k == 0 else loaded.nearest_frame(time_s), options)

    def keep_names_apart(self, pixels_of: PixelsOf) -> None:
        """Leave out names that would be drawn over others, of points (n, 3) in the camera frame
        seen at pixels (n, 2)."""
        T = self._T_cam_model
        self._rectangles.keep_apart(lambda places: pixels_of(transform_points(T, places)))

    def go_on(self, runs: tuple[LoadedRun, ...]) -> None:
        """Draw later states of the same runs from now on."""
        self._runs = runs
        for target, loaded in zip(self._targets, runs, strict=True):
            target.go_on(loaded)

    def refresh_trails(self) -> None:
        """Draw the trails as far as the runs have come."""
        for target in self._targets:
            target.refresh_trail()


def _point_size_m(loaded: LoadedRun, camera: PinholeCamera | None) -> float:
    """So large that neighbouring pixels touch; larger points would be drawn over each other."""
    if camera is None:
        return 0.006 * loaded.size_m
    return _PIXELS_ACROSS * float(np.linalg.norm(loaded.centre(0))) / camera.fx


def shot_of(loaded: LoadedRun, frame: int, max_points: int = MAX_POINTS) -> Shot | None:
    """The depth frame of a row of a run, compared with the model where there is an estimate."""
    if loaded.frames is None or not len(loaded):
        return None
    time_s, motion = float(loaded.run.time_s[frame]), _motion(loaded, frame)
    return loaded.frames.get(frame, time_s, loaded.pose(frame), max_points, motion)


def read_ahead(loaded: LoadedRun, frame: int, max_points: int) -> None:
    """Read a frame that will be shown next, meanwhile."""
    if loaded.frames is not None and 0 <= frame < len(loaded):
        time_s = float(loaded.run.time_s[frame])
        motion = _motion(loaded, frame)
        loaded.frames.read_ahead(frame, time_s, loaded.pose(frame), max_points, motion)


def _motion(loaded: LoadedRun, frame: int) -> Readout | None:
    """Of the target in the camera about a frame, by the poses beside it; None where no frame takes
    a time, or none beside it has a pose."""
    if loaded.frames is None or not loaded.frames.takes_time or loaded.pose(frame) is None:
        return None
    near = [k for k in range(frame - 1, frame + 2) if 0 <= k < len(loaded)]
    poses = [(float(loaded.run.time_s[k]), T) for k in near if (T := loaded.pose(k)) is not None]
    return motion_about(poses, [time_s for time_s, _ in poses].index(loaded.run.time_s[frame]))
