"""The estimated target in a scene: mesh, axes, doubts and arrows; and the true one as a ghost."""

import numpy as np
import viser

from pcnav.dynamics.state import THETA_BODY
from pcnav.target.mesh import wireframe_edges
from pcnav.viewer.glyphs import (
    Ellipsoid,
    attitude_cone_scale,
    momentum_direction,
    path_segments,
    principal_axes_model,
    sigma_ellipsoid,
    unit_cone,
)
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import ATTITUDE, MASS_CENTRE, MOMENTUM, POSITION, RATE, TRUTH, Rgb
from pcnav.viewer.render_options import Layer, RenderOptions, line_colour, vector, wxyz_of

_GHOST_SCALE = 1.012
"""The true mesh is drawn so much larger: it would be hidden by an estimate that is right."""


class TargetLayer:
    """The estimated target: mesh, axes, doubts and arrows; and the true one as a ghost."""

    def __init__(
        self, scene: viser.SceneApi, root: str, loaded: LoadedRun, colour: Rgb, *, is_first: bool
    ) -> None:
        self._run, self._size, self._is_first = loaded, loaded.size_m, is_first
        self._scene, self._root, self._colour = scene, root, colour
        self._model = scene.add_frame(f"{root}/model", show_axes=False)
        self._com = scene.add_frame(f"{root}/model/com", show_axes=False)
        self._mesh = self._add_edges(f"{root}/model", colour) if loaded.target else None
        self._ghost = scene.add_frame(f"{root}/truth", show_axes=False, visible=False)
        if is_first and loaded.target is not None:
            self._add_edges(f"{root}/truth", TRUTH, _GHOST_SCALE)
        self._add_points()
        com = f"{root}/model/com"
        length = 0.3 * self._size
        # Under the first run's names the axes have their usual colours; two sets would be confused.
        self._body = scene.add_frame(
            f"{com}/body", axes_length=length, axes_radius=0.004 * self._size
        )
        self._principal = scene.add_frame(
            f"{com}/principal",
            axes_length=1.25 * length,
            axes_radius=0.002 * self._size,
            origin_color=MASS_CENTRE,
        )
        self._com_spread = self._add_ellipsoid(f"{com}/spread", MASS_CENTRE, False)
        self._position_spread = self._add_ellipsoid(f"{root}/position", POSITION, True)
        self._cone = self._add_cone(f"{com}/attitude")
        self._rate, self._rate_text = self._add_arrow(f"{com}/rate", RATE)
        self._momentum, self._momentum_text = self._add_arrow(f"{com}/momentum", MOMENTUM)
        self._trail = self._add_trail()

    def show(self, frame: int | None, options: RenderOptions) -> None:
        """Draw a frame of the run; nothing of it where it has no estimate."""
        track = self._run.track
        known = frame is not None and bool(track.has_estimate[frame])
        self._model.visible = known
        self._trail.visible = Layer.TRAIL in options.layers and self._run.has_position
        position_shown = known and Layer.POSITION in options.layers and self._run.has_position
        self._position_spread.visible = position_shown
        self._show_ghost(frame, options)
        if frame is None or not known:
            return
        T = track.T_cam_model[frame]
        magnified = options.magnified or self._run.magnification(frame)
        self._model.wxyz, self._model.position = wxyz_of(T[:3, :3]), vector(T[:3, 3])
        self._com.position = vector(track.com_model[frame])
        if self._mesh is not None:
            self._mesh.visible = Layer.MESH in options.layers
        self._body.visible = Layer.BODY in options.layers and self._is_first
        self._principal.visible = Layer.PRINCIPAL in options.layers and self._is_first
        if self._principal.visible:
            self._principal.wxyz = wxyz_of(principal_axes_model(track.inertia_ratios[frame]))
        self._com_spread.visible = Layer.COM in options.layers and self._run.has_mass_centre
        if self._com_spread.visible:
            spread = sigma_ellipsoid(self._run.com_spread_model(frame))
            self._stretch(self._com_spread, spread, magnified)
        if position_shown:
            spread = sigma_ellipsoid(self._run.position_spread_cam(frame))
            self._stretch(self._position_spread, spread, magnified)
            com_cam = T[:3, :3] @ track.com_model[frame] + T[:3, 3]
            self._position_spread.position = vector(com_cam)
        self._cone.visible = Layer.ATTITUDE in options.layers
        if self._cone.visible:
            sd, length = track.sd[frame, THETA_BODY], 0.5 * self._size
            self._cone.scale = vector(attitude_cone_scale(sd, length, magnified))
        self._show_arrows(frame, options)

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

    def _show_ghost(self, frame: int | None, options: RenderOptions) -> None:
        evaluation = self._run.evaluation
        true = evaluation.T_cam_model if evaluation is not None else None
        shown = frame is not None and true is not None and Layer.TRUTH in options.layers
        if shown and frame is not None and true is not None:
            T = true[frame]
            shown = bool(np.isfinite(T).all())
            if shown:
                self._ghost.wxyz, self._ghost.position = wxyz_of(T[:3, :3]), vector(T[:3, 3])
        self._ghost.visible = shown and self._is_first

    def _show_arrows(self, frame: int, options: RenderOptions) -> None:
        track = self._run.track
        omega = track.omega_body[frame]
        rate = float(np.linalg.norm(omega))
        moving = rate > 0.0 and bool(np.isfinite(omega).all())
        length = 0.8 * self._size
        direction = omega / rate if moving else omega
        for arrow, text, layer, tip, told in (
            (
                self._rate,
                self._rate_text,
                Layer.RATE,
                length * rate / self._run.largest_rate * direction,
                f"ω {np.rad2deg(rate):.3f} deg/s",
            ),
            (
                self._momentum,
                self._momentum_text,
                Layer.MOMENTUM,
                length * momentum_direction(track.inertia_ratios[frame], omega),
                "angular momentum",
            ),
        ):
            shown = layer in options.layers and moving
            arrow.visible = shown
            text.visible = shown and self._is_first
            if shown:
                arrow.points = np.stack([np.zeros(3), tip])[None]
                text.text, text.position = told, vector(1.08 * tip)

    def _add_edges(self, root: str, colour: Rgb, scale: float = 1.0) -> viser.LineSegmentsHandle:
        """A line drawing: surfaces one can see through cost a browser more than all the rest."""
        target = self._run.target
        assert target is not None
        return self._scene.add_line_segments(
            f"{root}/edges",
            wireframe_edges(target.mesh).astype(np.float32),
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
            color=ATTITUDE,
            opacity=0.45,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )

    def _add_arrow(self, name: str, colour: Rgb) -> tuple[viser.ArrowsHandle, viser.LabelHandle]:
        size = self._size
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
        track = self._run.track
        known = track.has_estimate
        R, T = track.T_cam_model[known, :3, :3], track.T_cam_model[known]
        centres = np.einsum("nij,nj->ni", R, track.com_model[known]) + T[:, :3, 3]
        segments = path_segments(centres)
        return self._scene.add_line_segments(
            f"{self._root}/trail",
            (segments if len(segments) else np.zeros((1, 2, 3))).astype(np.float32),
            line_colour(self._colour),
            thickness=1.5,
            thickness_units="screen",
        )

    @staticmethod
    def _stretch(handle: viser.IcosphereHandle, spread: Ellipsoid, magnified: float) -> None:
        handle.scale = vector(np.maximum(magnified * spread.radii, 1e-6))
        handle.wxyz = wxyz_of(spread.R)
