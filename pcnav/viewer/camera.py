"""The camera of one browser: where it looks from, what it follows, how it fits what there is."""

import time
from enum import StrEnum

import numpy as np
import viser

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import rotation_from_xyzw
from pcnav.viewer.frames import Shot
from pcnav.viewer.layers import vertical_fov
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.render_options import CAMERA_FOV_RAD, vector
from pcnav.viewer.server import UP, drawing

_MAX_WIDENING = 2.5
"""Other things are fitted into the picture up to so many times the target's own size."""


_MOVES_WITHIN_S = 5.0


class Viewpoint(StrEnum):
    """Where the browser looks from."""

    CHASER = "chaser's eye"
    ORBIT = "orbit"
    FOLLOW = "follow"


def fitted_view(loaded: LoadedRun, frame: int, shot: Shot | None) -> tuple[FloatArray, FloatArray]:
    """A place (3,) that sees target and returns, and what it looks at (3,), camera frame."""
    position, centre = loaded.viewpoint(frame)
    widened = 1.0
    if shot is not None and len(shot.points):
        away = np.linalg.norm(shot.points.astype(np.float64) - centre, axis=1)
        # All but stray returns.
        reach = float(np.quantile(away, 0.98))
        widened = float(np.clip(reach / (0.5 * loaded.size_m), 1.0, _MAX_WIDENING))
    return centre + widened * (position - centre), centre


class Viewfinder:
    """The camera of one browser."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._followed: FloatArray | None = None
        """The target's place that the camera was last carried along to."""
        self._placed: tuple[float, ...] | None = None
        """Where the page was told to look from last."""
        self._left: list[tuple[tuple[float, ...], float]] = []
        """Where it looked from before, and when it was told to leave."""

    @property
    def state(self) -> tuple[float, ...]:
        """Place (3), what it looks at (3), field of view.

        A page that was told where to look from says for a while that it looks from where it did
        before: until it has had the time to move, it is where it was told to be.
        """
        told, now_s = self._told, time.monotonic()
        self._left = [(each, at_s) for each, at_s in self._left if now_s - at_s < _MOVES_WITHIN_S]
        if self._placed is None or np.allclose(told, self._placed):
            return told
        # Place, direction and field of view come to a page one by one: either of the first two may
        # be as it was.
        late = (
            np.allclose(told[part], each[part]) and not np.allclose(each[part], self._placed[part])
            for each, _ in self._left
            for part in (slice(3), slice(3, 6))
        )
        return self._placed if any(late) else told

    @property
    def _told(self) -> tuple[float, ...]:
        """As the page said last, or was told since."""
        camera = self._client.camera
        return (*camera.position.tolist(), *camera.look_at.tolist(), float(camera.fov))

    def pixels(self, points: FloatArray) -> FloatArray:
        """(n, 2) where the browser sees points (n, 3); nan behind it."""
        camera = self._client.camera
        w, x, y, z = camera.wxyz
        p = (points - camera.position) @ rotation_from_xyzw(np.array([x, y, z, w]))
        focal_px = 0.5 * camera.image_height / np.tan(0.5 * camera.fov)
        ahead = np.where(p[:, 2:] > 0.0, p[:, 2:], np.nan)
        return np.asarray(focal_px * p[:, :2] / ahead)

    def set_state(self, state: tuple[float, ...]) -> None:
        """As `state` has it."""
        self._followed = None
        self._place(np.array(state[:3]), np.array(state[3:6]), state[6])

    def look_from(
        self, viewpoint: Viewpoint, loaded: LoadedRun, frame: int, shot: Shot | None
    ) -> None:
        """Move to a viewpoint."""
        position, centre = fitted_view(loaded, frame, shot)
        self._followed = centre if viewpoint is Viewpoint.FOLLOW else None
        if viewpoint is Viewpoint.CHASER:
            eye: PinholeCamera | None = None if loaded.frames is None else loaded.frames.camera()
            ahead = np.array([0.0, 0.0, max(float(centre[2]), 1.0)])
            self._place(np.zeros(3), ahead, CAMERA_FOV_RAD if eye is None else vertical_fov(eye))
            return
        self._place(position, centre, CAMERA_FOV_RAD)

    def follow(self, loaded: LoadedRun, frame: int) -> None:
        """Carry the camera along with the target, without touching what the user turned."""
        # Another thread may look from elsewhere in the meantime.
        followed = self._followed
        if followed is None or not loaded.run.has_estimate[frame]:
            return
        centre = loaded.centre(frame)
        shift = centre - followed
        if self._followed is followed:
            self._followed = centre
        if np.linalg.norm(shift) > 0.0:
            self._client.camera.position = np.asarray(self._client.camera.position) + shift

    def _place(self, position: FloatArray, look_at: FloatArray, fov_rad: float) -> None:
        handle = self._client.camera
        state = (*map(float, position), *map(float, look_at), float(fov_rad))
        self._left.append((self._told, time.monotonic()))
        self._placed = state
        with drawing(self._client):
            handle.up_direction = UP
            handle.fov = fov_rad
            handle.position = vector(position)
            handle.look_at = vector(look_at)
