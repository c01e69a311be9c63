"""The estimated target in a scene: mesh, axes, doubts and arrows; and the true one as a ghost."""

import numpy as np
import viser

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, RATE, RATIOS
from pcnav.target.mesh import wireframe_edges
from pcnav.viewer import palette
from pcnav.viewer.glyphs import (
    SIGMAS,
    attitude_cone_scale,
    momentum_direction,
    path_segments,
    principal_axes_model,
    sigma_ellipsoid,
    unit_cone,
)
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import COASTING, MASS_CENTRE, MOMENTUM, TRUTH, Rgb
from pcnav.viewer.render_options import (
    Layer,
    RenderOptions,
    line_colour,
    place,
    vector,
    wxyz_of,
)

_GHOST_SCALE = 1.012
"""The true mesh is drawn so much larger: it would be hidden by an estimate that is right."""
_MAX_RADIUS = 1.5
"""Of an ellipsoid, over the target's size."""
_OF_FIRST = frozenset({Layer.BODY, Layer.PRINCIPAL, Layer.TRUTH})
"""Axes have their usual colours whatever the run: two sets would be confused."""


class TargetLayer:
    """The estimated target: mesh, axes, doubts and arrows; and the true one as a ghost."""

    def __init__(
        self, scene: viser.SceneApi, root: str, loaded: LoadedRun, colour: Rgb, *, is_first: bool
    ) -> None:
        self._scene, self._root, self._colour = scene, root, colour
        self._run, self._is_first = loaded, is_first
        size, com = loaded.size_m, f"{root}/model/com"
        self._model = scene.add_frame(f"{root}/model", show_axes=False)
        self._com = scene.add_frame(com, show_axes=False)
        mesh = self._add_edges(f"{root}/model", colour, 1.0)
        self._ghost = scene.add_frame(f"{root}/truth", show_axes=False, visible=False)
        if is_first:
            self._add_edges(f"{root}/truth", TRUTH, _GHOST_SCALE)
        self._future = scene.add_frame(f"{root}/future", show_axes=False, visible=False)
        if is_first:
            self._add_edges(f"{root}/future", COASTING, 1.0)
        self._future_spread = self._add_ellipsoid(f"{root}/future_spread", COASTING, True)
        self._add_points()
        self._body = scene.add_frame(
            f"{com}/body", axes_length=0.3 * size, axes_radius=0.004 * size
        )
        self._principal = scene.add_frame(
            f"{com}/principal",
            axes_length=0.375 * size,
            axes_radius=0.002 * size,
            origin_color=MASS_CENTRE,
        )
        self._com_spread = self._add_ellipsoid(f"{com}/spread", MASS_CENTRE, False)
        self._position_spread = self._add_ellipsoid(f"{root}/position", palette.POSITION, True)
        self._cone = self._add_cone(f"{com}/attitude")
        self._arrows = {
            Layer.RATE: self._add_arrow(f"{com}/rate", palette.RATE),
            Layer.MOMENTUM: self._add_arrow(f"{com}/momentum", MOMENTUM),
        }
        self._trail = self._add_trail()
        self._switched: dict[Layer, viser.SceneNodeHandle] = {
            Layer.BODY: self._body,
            Layer.PRINCIPAL: self._principal,
            Layer.COM: self._com_spread,
            Layer.POSITION: self._position_spread,
            Layer.ATTITUDE: self._cone,
        }
        if mesh is not None:
            self._switched[Layer.MESH] = mesh

    def show(self, frame: int | None, options: RenderOptions) -> None:
        """Draw a frame of the run; nothing of it where it has no estimate."""
        loaded = self._run
        shown = options.layers & loaded.layers
        if not self._is_first:
            shown -= _OF_FIRST
        self._trail.visible = Layer.TRAIL in shown
        true = loaded.true_pose(frame) if Layer.TRUTH in shown else None
        self._ghost.visible = true is not None
        if true is not None:
            place(self._ghost, true)
        self._show_future(options.forecast_s)
        pose = None if frame is None else loaded.pose(frame)
        self._model.visible = pose is not None
        for layer, handle in self._switched.items():
            handle.visible = pose is not None and layer in shown
        if frame is not None and pose is not None:
            place(self._model, pose)
            self._show_estimate(frame, shown, options.magnified or loaded.magnification(frame))

    def _show_estimate(self, frame: int, shown: frozenset[Layer], magnified: float) -> None:
        loaded, trajectory = self._run, self._run.trajectory
        self._com.position = vector(loaded.com_model[frame])
        if Layer.PRINCIPAL in shown:
            self._principal.wxyz = wxyz_of(principal_axes_model(trajectory[RATIOS][frame]))
        if Layer.COM in shown:
            self._stretch(self._com_spread, loaded.covariance(CENTRE, frame), magnified)
        if Layer.POSITION in shown:
            self._stretch(self._position_spread, loaded.position_spread_cam(frame), magnified)
            self._position_spread.position = vector(loaded.centre(frame))
        if Layer.ATTITUDE in shown:
            sd, length = loaded.sd(ATTITUDE, frame), 0.5 * loaded.size_m
            self._cone.scale = vector(attitude_cone_scale(sd, length, magnified))
        self._show_arrows(frame, shown)

    def _show_future(self, ahead_s: float | None) -> None:
        """The ghost of the forecast, and where its origin is in 95 % of the motions drawn."""
        future = None
        if self._is_first and ahead_s is not None and self._run.future is not None:
            future = self._run.future.get(ahead_s)
        self._future.visible = self._future_spread.visible = future is not None
        if future is not None:
            place(self._future, future.T_cam_model)
            self._stretch(self._future_spread, future.covariance_cam, future.reach / SIGMAS)
            self._future_spread.position = vector(future.T_cam_model[:3, 3])

    def _show_arrows(self, frame: int, shown: frozenset[Layer]) -> None:
        loaded, trajectory = self._run, self._run.trajectory
        omega = trajectory[RATE][frame] if loaded.has(RATE) else np.zeros(3)
        rate, length = float(np.linalg.norm(omega)), 0.5 * self._run.size_m
        moves = rate > 0.0 and bool(np.isfinite(omega).all())
        for layer, (arrow, text) in self._arrows.items():
            arrow.visible = moves and layer in shown
            text.visible = arrow.visible and self._is_first
            if not arrow.visible:
                continue
            if layer is Layer.RATE:
                tip, text.text = omega / loaded.max_rate, f"ω {np.rad2deg(rate):.3f} deg/s"
            else:
                tip = momentum_direction(trajectory[RATIOS][frame], omega)
                text.text = "angular momentum"
            arrow.points = np.stack([np.zeros(3), length * tip])[None]
            text.position = vector(1.08 * length * tip)

    def _stretch(
        self, handle: viser.IcosphereHandle, covariance: FloatArray, magnified: float
    ) -> None:
        """Draw the standard deviations of a (3, 3) covariance so many times larger.

        One that would swallow the picture is left out; its numbers are beside it.
        """
        spread = sigma_ellipsoid(covariance)
        radii = magnified * spread.radii
        handle.visible = bool(radii.max() <= _MAX_RADIUS * self._run.size_m)
        handle.scale = vector(np.maximum(radii, 1e-6))
        handle.wxyz = wxyz_of(spread.R)

    def go_on(self, loaded: LoadedRun) -> None:
        """Draw a later state of the same run, which has more frames, from now on."""
        found = self._run.points_body is None and loaded.points_body is not None
        self._run = loaded
        if found:
            self._add_points()

    def refresh_trail(self) -> None:
        """Draw the trail as far as the run has come."""
        was_visible = self._trail.visible
        self._trail.remove()
        self._trail = self._add_trail()
        self._trail.visible = was_visible

    def _add_edges(self, root: str, colour: Rgb, scale: float) -> viser.LineSegmentsHandle | None:
        """A line drawing: surfaces one can see through cost a browser more than all the rest."""
        if self._run.target is None:
            return None
        return self._scene.add_line_segments(
            f"{root}/edges",
            wireframe_edges(self._run.target.mesh).astype(np.float32),
            line_colour(colour),
            thickness=2.0,
            thickness_units="screen",
            scale=scale,
        )

    def _add_points(self) -> None:
        """Points that were estimated of a target without a model."""
        points = self._run.points_body
        if points is None or not len(points):
            return
        self._scene.add_point_cloud(
            f"{self._root}/model/features",
            points.astype(np.float32),
            self._colour,
            point_size=0.012 * self._run.size_m,
            point_shape="circle",
            precision="float32",
        )

    def _add_ellipsoid(self, name: str, colour: Rgb, wireframe: bool) -> viser.IcosphereHandle:
        return self._scene.add_icosphere(
            name,
            radius=1.0,
            color=colour,
            # Two faint surfaces of the same centre would flicker through each other.
            wireframe=wireframe,
            opacity=0.45,
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )

    def _add_cone(self, name: str) -> viser.MeshHandle:
        vertices, faces = unit_cone()
        return self._scene.add_mesh_simple(
            name,
            vertices.astype(np.float32),
            faces.astype(np.uint32),
            color=palette.ATTITUDE,
            opacity=0.45,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )

    def _add_arrow(self, name: str, colour: Rgb) -> tuple[viser.ArrowsHandle, viser.LabelHandle]:
        size = self._run.size_m
        arrow = self._scene.add_arrows(
            name,
            np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, size]]], dtype=np.float32),
            line_colour(colour),
            shaft_radius=0.008 * size,
            head_radius=0.022 * size,
            head_length=0.06 * size,
            visible=False,
        )
        text = self._scene.add_label(
            f"{name}_text", "", font_screen_scale=0.8, anchor="bottom-left", visible=False
        )
        return arrow, text

    def _add_trail(self) -> viser.LineSegmentsHandle:
        segments = path_segments(self._run.centres)
        return self._scene.add_line_segments(
            f"{self._root}/trail",
            (segments if len(segments) else np.zeros((1, 2, 3))).astype(np.float32),
            line_colour(self._colour),
            thickness=1.5,
            thickness_units="screen",
        )
