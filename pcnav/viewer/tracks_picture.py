"""The image of a camera with the feature points that were tracked in it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import transform_points
from pcnav.recordings.images import ImageSequence, is_image_sequence, open_images
from pcnav.recordings.monocular_tracks import read_monocular_tracks
from pcnav.recordings.stereo_tracks import read_stereo_tracks
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.run import FeatureTable
from pcnav.viewer.palette import ACCEPTED_COLOUR, MASS_CENTRE, REJECTED_COLOUR, SENSOR, Rgb

_WIDTH_PX, _HEIGHT_PX = 800, 457
_EMPTY: Rgb = (14, 16, 24)
_TAIL_FRAMES = 12
_DOT_PX, _CROSS_PX = 4, 6


@dataclass(frozen=True)
class TrackedImages:
    """What one camera of a recording saw, of a rig its left one."""

    size_px: tuple[int, int]
    """Width and height."""
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    frames: tuple[TrackFrame, ...] = ()
    images: ImageSequence | None = None
    """None where the recording has tracks alone."""

    @cached_property
    def _rows(self) -> Mapping[float, int]:
        return {frame.time_s: k for k, frame in enumerate(self.frames)}

    def picture(
        self, time_s: float, features: FeatureTable | None, T_cam_body: FloatArray | None
    ) -> npt.NDArray[np.uint8]:
        """(height, width, 3) the image at a time: tracks with where they came from, in the colour
        of what became of them, and crosses where the estimated points should be seen."""
        scale = min(_WIDTH_PX / self.size_px[0], _HEIGHT_PX / self.size_px[1])
        corner = 0.5 * (np.array([_WIDTH_PX, _HEIGHT_PX]) - scale * np.array(self.size_px))
        picture = self._background(time_s, scale, corner)
        pen = ImageDraw.Draw(picture)
        at, colours = self._rows.get(time_s), outcomes(features)
        if at is not None:
            for number, trail in _trails(self.frames[max(0, at - _TAIL_FRAMES) : at + 1]).items():
                colour = colours.get(number, SENSOR)
                path = [tuple(pixel) for pixel in (corner + scale * np.array(trail))]
                pen.line(path, fill=colour, width=1)
                x, y = path[-1]
                pen.ellipse((x - _DOT_PX, y - _DOT_PX, x + _DOT_PX, y + _DOT_PX), fill=colour)
        if features is not None and T_cam_body is not None:
            for x, y in corner + scale * self._projected(features.p_body, T_cam_body):
                pen.line((x - _CROSS_PX, y, x + _CROSS_PX, y), fill=MASS_CENTRE)
                pen.line((x, y - _CROSS_PX, x, y + _CROSS_PX), fill=MASS_CENTRE)
        return np.asarray(picture)

    def _projected(self, p_body: FloatArray, T_cam_body: FloatArray) -> FloatArray:
        """(m, 2) pixels of the points (n, 3) that are known and before the camera."""
        p_cam = transform_points(T_cam_body, p_body[np.isfinite(p_body).all(axis=1)])
        p_cam = p_cam[p_cam[:, 2] > 0.0]
        return np.asarray(p_cam[:, :2] / p_cam[:, 2:] * self.focal_px + self.centre_px)

    def _background(self, time_s: float, scale: float, corner: FloatArray) -> Image.Image:
        picture = Image.new("RGB", (_WIDTH_PX, _HEIGHT_PX), _EMPTY)
        seen = self._image(time_s)
        if seen is not None:
            height, width = seen.shape[:2]
            size = (max(1, round(scale * width)), max(1, round(scale * height)))
            grey = Image.fromarray(seen).convert("RGB").resize(size)
            picture.paste(grey, (int(corner[0]), int(corner[1])))
        return picture

    def _image(self, time_s: float) -> npt.NDArray[np.uint8] | None:
        """The image at a time; None where there is none, or in a video, which is read in order."""
        images = self.images
        if images is None or not images.files:
            return None
        found = np.flatnonzero(images.times_s == time_s)
        if not found.size:
            return None
        k = slice(int(found[0]), int(found[0]) + 1)
        one = replace(
            images,
            files=images.files[k],
            times_s=images.times_s[k],
            R_cam_world=images.R_cam_world[k],
        )
        try:
            return np.asarray(next(iter(one)).grey, dtype=np.uint8)
        except (InputError, StopIteration):
            return None


def outcomes(features: FeatureTable | None) -> dict[int, Rgb]:
    """A colour by feature: accepted, or rejected in more frames than not."""
    if features is None:
        return {}
    mostly = features.frames_rejected > 0.5 * np.maximum(features.frames_seen, 1)
    return {
        int(number): REJECTED_COLOUR if rejected else ACCEPTED_COLOUR
        for number, rejected in zip(features.feature, mostly, strict=True)
    }


def _trails(frames: tuple[TrackFrame, ...]) -> dict[int, list[FloatArray]]:
    """Where each feature of the last of some frames was in those before."""
    if not frames:
        return {}
    trails: dict[int, list[FloatArray]] = {int(number): [] for number in frames[-1].features}
    for frame in frames:
        for number, pixel in zip(frame.features.tolist(), frame.pixels, strict=True):
            if number in trails:
                trails[number].append(pixel[:2])
    return trails


def tracked_images(path: Path, *, is_rig: bool) -> TrackedImages | None:
    """Of a recording of a rig or of one camera; None where it cannot be read."""
    try:
        if is_rig:
            tracks = read_stereo_tracks(path)
            rig = tracks.rig
            focal = (rig.focal_px, rig.focal_px)
            return TrackedImages(rig.size_px, focal, rig.centre_px, tracks.frames)
        images = open_images(path) if is_image_sequence(path) else None
        own = None if images is not None else read_monocular_tracks(path)
    except InputError:
        return None
    camera = own.camera if own is not None else images.camera if images is not None else None
    if camera is None:
        return None
    size, focal = (camera.width, camera.height), (camera.fx, camera.fy)
    frames = () if own is None else own.frames
    return TrackedImages(size, focal, (camera.cx, camera.cy), frames, images)
