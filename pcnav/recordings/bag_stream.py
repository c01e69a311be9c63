"""Depth frames in a stream of MCAP with messages of ROS 2, as standard input may bring them.

What a bag holds is read of it as it comes: see `pcnav.recordings.bag`. An image waits for the
camera (CameraInfo), and, where /tf moves the camera, for the transforms around its time.
"""

import logging
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcnav.config.recording import RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, pixels_without_ray
from pcnav.core.errors import InputError
from pcnav.recordings.arriving import Arrival
from pcnav.recordings.bag import TF, TF_STATIC, camera_of_info, depth_of_message
from pcnav.recordings.bag_images import CLOUD, COMPRESSED, IMAGE
from pcnav.recordings.bag_topics import CAMERA_INFO, camera_topic, depth_topic
from pcnav.recordings.bag_transforms import TransformTree
from pcnav.recordings.depth_camera import DepthCamera
from pcnav.recordings.depth_image import ImageSize, require_size, size_of
from pcnav.recordings.depth_units import depth_in_metres
from pcnav.recordings.given_frames import GivenFrames
from pcnav.recordings.intake import SkippedFrame
from pcnav.recordings.mcap_messages import Came, McapMessages
from pcnav.recordings.region import Region, restricted
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.recordings.time_line import zero_of

_PATIENCE_S = 1.0
"""So long an image waits for transforms that hold its time."""
_MM = 0.001
"""Metres of a stored integer (REP 118)."""
_WHERE = Path("standard input")
_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class _Waiting:
    """An image without its camera's pose so far."""

    came: Came
    stamp_s: float
    """From the whole second on that the stream began in."""


class BagStream:
    """The frames of a stream, in order, each once."""

    def __init__(
        self, messages: McapMessages, info: SequenceInfo, table: RecordingTable, region: Region
    ) -> None:
        self._messages, self._info, self._table = messages, info, table
        self._region = region
        self._infos: dict[str, Any] = {}
        self._depth: str | None = None
        self._camera: DepthCamera | None = None
        if table.camera_px is not None:
            self._camera = DepthCamera(table.camera_px, None, table.unit_m)
        self._seen_by: PinholeCamera | None = None
        self._why_not: InputError | None = None
        self._waiting: deque[_Waiting] = deque()
        self._tree = TransformTree()
        self._is_carried: bool | None = None
        self._origin_s: int | None = None
        self._passed_s = 0.0
        self._images = self._taken = self._left_out = 0
        self._last_s = -float("inf")
        self._skipped: list[SkippedFrame] = []
        self._ready: Arrival | None = None

    @property
    def recording(self) -> GivenFrames | None:
        """What is known of the frames; they themselves are not kept."""
        return None if self._seen_by is None else GivenFrames(self._info, self._seen_by)

    @property
    def why_not(self) -> InputError | None:
        """What the first image waits for."""
        return self._why_not

    @property
    def has_ended(self) -> bool:
        """By the end of the stream, or because as many frames as are wanted were taken."""
        return self._taken == self._table.frames or (
            self._messages.is_over and not self._waiting and self._ready is None
        )

    @property
    def skipped(self) -> tuple[SkippedFrame, ...]:
        """Images that held no depth."""
        return tuple(self._skipped)

    @property
    def remarks(self) -> tuple[str, ...]:
        """Of images that were left out."""
        skipped = f"{len(self._skipped)} frames could not be read and were coasted over"
        out = f"{self._left_out} images without a transform, or after later ones, were left out"
        said = ((self._skipped, skipped), (self._left_out, out))
        return tuple(sentence for some, sentence in said if some)

    def look(self) -> bool:
        """Whether a frame is ready. Raises `InputError` for a stream of something else."""
        if self._ready is not None or self._taken == self._table.frames:
            return self._ready is not None
        self._try_next(gives_up=False)
        while self._ready is None and (came := self._messages.next()) is not None:
            self._take_in(came)
            self._try_next(gives_up=False)
        if self._ready is None:
            # What an image waits for is not among all that has come.
            self._try_next(gives_up=True)
        return self._ready is not None

    def take(self) -> Arrival:
        """The frame that is ready."""
        arrival, self._ready = self._ready, None
        assert arrival is not None, "look() found one"
        self._taken += 1
        self._tree.forget(self._last_s + self._passed_s - _PATIENCE_S)
        return arrival

    def _take_in(self, came: Came) -> None:
        """Sort one message to where it belongs."""
        if self._origin_s is None:
            self._origin_s = came.log_ns // 10**9
        if came.topic in (TF, TF_STATIC):
            try:
                self._tree.add(came.content(), came.topic == TF_STATIC, self._origin_s)
            except ValueError as error:
                raise InputError(_WHERE, came.topic, str(error)) from error
        elif came.kind == CAMERA_INFO:
            self._infos.setdefault(came.topic, came.content())
        elif came.kind in (IMAGE, COMPRESSED, CLOUD) and self._is_wanted(came):
            stamp = came.content().header.stamp
            ns = int(stamp.sec) * 10**9 + int(stamp.nanosec) or came.log_ns
            stamp_s = ns // 10**9 - self._origin_s + (ns % 10**9) * 1e-9
            self._waiting.append(_Waiting(came, stamp_s))

    def _is_wanted(self, came: Came) -> bool:
        """Whether an image is depth of the target, and among those that are to be taken."""
        if self._depth is None:
            try:
                self._depth = depth_topic(_WHERE, self._messages.kinds, self._table.topic)
            except InputError as error:
                # Another topic may come.
                self._why_not = error
                return False
        if came.topic != self._depth:
            return False
        place, self._images = self._images - self._table.start, self._images + 1
        return place >= 0 and place % self._table.every == 0

    def _try_next(self, gives_up: bool) -> None:
        """Make a frame of the image that waits longest, where all it needs is there."""
        while self._waiting and self._ready is None:
            first = self._waiting[0]
            if not self._has_camera(first):
                return
            T = self._camera_pose(first)
            waits = time.monotonic() - first.came.came_s < _PATIENCE_S
            if T is None and (not gives_up or (waits and not self._messages.is_over)):
                return
            if self._is_carried is None:
                self._settle(first, T)
            T = T if self._is_carried else np.eye(4)
            self._waiting.popleft()
            if T is None or not first.stamp_s - self._passed_s > self._last_s:
                self._left_out += 1
                continue
            frame = self._frame(first, T)
            self._last_s = frame.time_s
            self._ready = Arrival(restricted(frame, self._region), first.came.came_s)

    def _has_camera(self, first: _Waiting) -> bool:
        if self._camera is not None:
            return True
        kinds, chosen = self._messages.kinds, self._table.camera_topic
        assert self._depth is not None, "it is an image of that topic"
        try:
            topic = camera_topic(_WHERE, kinds, self._depth, chosen)
        except InputError as error:
            self._why_not, topic = error, None
        if topic not in self._infos:
            expected = "expected CameraInfo beside the images, or --camera FX FY CX CY"
            self._why_not = self._why_not or InputError(_WHERE, first.came.topic, expected)
            return False
        self._camera = camera_of_info(_WHERE, self._infos[topic], self._table.unit_m)
        return True

    def _camera_pose(self, first: _Waiting) -> FloatArray | None:
        """(4, 4) T_cam_world of an image; None where the transforms do not reach its time."""
        frame = first.came.content().header.frame_id
        seen = self._tree.camera_transforms(frame, np.array([first.stamp_s]))
        if self._is_carried is False:
            if seen is not None:
                expected = f"expected transforms of {frame} with its first image, or none at all"
                raise InputError(_WHERE, TF, expected)
            return np.eye(4)
        return None if seen is None or not np.isfinite(seen[1]).all() else seen[1][0]

    def _settle(self, first: _Waiting, T: FloatArray | None) -> None:
        """Whether transforms carry the camera: for good, since the world is another one then."""
        frame = first.came.content().header.frame_id
        self._is_carried = T is not None
        where = f"carried by {TF}" if self._is_carried else "at rest, as no transform holds it"
        _LOG.info("%s: depth of %s, the camera (%s) %s", _WHERE, self._depth, frame, where)

    def _frame(self, image: _Waiting, T_cam_world: FloatArray) -> Frame:
        """Of an image; blind where it holds no depth. Raises `InputError` for another size."""
        assert self._camera is not None and self._origin_s is not None, "an image waited for it"
        camera, name = self._camera, f"{self._depth}[{self._images}]"
        index = self._taken
        try:
            stored = depth_of_message(image.came.kind, image.came.content())
        except ValueError as error:
            if self._seen_by is None:
                raise InputError(_WHERE / name, "message", str(error)) from error
            time_s = image.stamp_s - self._passed_s
            self._skipped.append(SkippedFrame(index, time_s, str(error)))
            return Frame.blind(index, time_s, self._seen_by, T_cam_world)
        if self._seen_by is None:
            size = size_of(stored)
            self._seen_by = PinholeCamera(*size, *camera.intrinsics, camera.form.lens)
            zero_s = zero_of(self._origin_s + image.stamp_s, None)
            self._passed_s = image.stamp_s if zero_s else -float(self._origin_s)
            self._info = SequenceInfo(
                self._info.name, 0.0, None, self._info.target_mesh, time_zero_s=zero_s
            )
        seen_by = self._seen_by
        require_size(_WHERE / name, stored, ImageSize(seen_by.width, seen_by.height))
        step_m = camera.unit_m or (1.0 if stored.dtype.kind == "f" else _MM)
        depth_m = depth_in_metres(stored, step_m, camera.form, seen_by)
        unseen = pixels_without_ray(seen_by)
        if unseen is not None:
            depth_m[unseen] = 0.0
        time_s = image.stamp_s - self._passed_s
        return Frame(index, time_s, depth_m, seen_by, T_cam_world, unseen)
