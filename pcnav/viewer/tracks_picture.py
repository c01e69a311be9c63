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
from pcnav.recordings.monocular_tracks import is_monocular_recording, read_monocular_tracks
from pcnav.recordings.stereo_tracks import read_stereo_tracks
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.feature_outcomes import FeatureOutcomes
from pcnav.runs.run import FeatureTable
from pcnav.viewer.features_told import colour_of
from pcnav.viewer.palette import ACCEPTED_COLOUR, MASS_CENTRE, REJECTED_COLOUR, SENSOR, Rgb

_WIDTH_PX, _HEIGHT_PX = 800, 457
_EMPTY: Rgb = (14, 16, 24)
_TAIL_FRAMES = 12
_DOT_PX, _CROSS_PX = 4, 6
_MANY, _SMALL_DOT_PX = 100, 3
"""Tracks; of more the dots would hide each other."""
_REACH_PX = 16.0
"""What is clicked at lies no farther away."""
_BORDER, _MIN_WINDOW_PX = 1.6, 24.0
"""What is enlarged is shown with as much again beside it, and never by less of its image."""


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
        self,
        time_s: float,
        features: FeatureTable | None,
        T_cam_body: FloatArray | None,
        outcomes: FeatureOutcomes | None = None,
    ) -> npt.NDArray[np.uint8]:
        """(height, width, 3) the image at a time: tracks with where they came from, in the colour
        of what became of them then (of most frames, where that is not told), and crosses where
        the estimated points should be seen."""
        at, colours = self._rows.get(time_s), _colours(features, outcomes)
        seen, expected = self._marks(time_s, features, T_cam_body)
        scale, corner = self._window(np.vstack([seen, expected]))
        picture = self._background(time_s, scale, corner)
        pen = ImageDraw.Draw(picture)
        dot = _DOT_PX if len(seen) <= _MANY else _SMALL_DOT_PX
        if at is not None:
            for number, trail in _trails(self.frames[max(0, at - _TAIL_FRAMES) : at + 1]).items():
                colour = colours.get(number, SENSOR)
                path = [tuple(pixel) for pixel in (corner + scale * np.array(trail))]
                pen.line(path, fill=colour, width=1)
                x, y = path[-1]
                pen.ellipse((x - dot, y - dot, x + dot, y + dot), fill=colour)
        for x, y in corner + scale * expected:
            pen.line((x - _CROSS_PX, y, x + _CROSS_PX, y), fill=MASS_CENTRE)
            pen.line((x, y - _CROSS_PX, x, y + _CROSS_PX), fill=MASS_CENTRE)
        width, height = round(_WIDTH_PX / scale), round(_HEIGHT_PX / scale)
        if width < self.size_px[0] and height < self.size_px[1]:
            told = f"{width} x {height} px of {self.size_px[0]} x {self.size_px[1]}"
            pen.text((10, 8), told, fill=SENSOR, font_size=20)
        return np.asarray(picture)

    def feature_at(
        self,
        place: FloatArray,
        time_s: float,
        features: FeatureTable | None,
        T_cam_body: FloatArray | None,
    ) -> int | None:
        """Number of the track at a place (2,) of the `picture`, its sides 1 long; None for none."""
        at = self._rows.get(time_s)
        if at is None or not len(self.frames[at].features):
            return None
        seen, expected = self._marks(time_s, features, T_cam_body)
        scale, corner = self._window(np.vstack([seen, expected]))
        off = corner + scale * seen - place * np.array([_WIDTH_PX, _HEIGHT_PX])
        away = np.linalg.norm(off, axis=1)
        nearest = int(np.argmin(away))
        return int(self.frames[at].features[nearest]) if away[nearest] <= _REACH_PX else None

    def _marks(
        self, time_s: float, features: FeatureTable | None, T_cam_body: FloatArray | None
    ) -> tuple[FloatArray, FloatArray]:
        """(n, 2) pixels of the tracks and (m, 2) of the points as estimated."""
        at, expected = self._rows.get(time_s), np.zeros((0, 2))
        if features is not None and T_cam_body is not None:
            expected = self._projected(features.p_body, T_cam_body)
        seen = np.zeros((0, 2)) if at is None else self.frames[at].pixels[:, :2]
        return seen, expected

    def _window(self, pixels: FloatArray) -> tuple[float, FloatArray]:
        """Scale and corner (2,) of the image in the picture: all of it, or what holds some pixels
        (n, 2) where they take but little of it. Scales are powers of two, for a picture at rest."""
        size, picture = np.array(self.size_px, dtype=float), np.array([_WIDTH_PX, _HEIGHT_PX])
        whole = float(np.min(picture / size))
        scale, middle = whole, 0.5 * size
        if len(pixels):
            low, high = pixels.min(axis=0), pixels.max(axis=0)
            fitting = float(np.min(picture / np.maximum(_BORDER * (high - low), _MIN_WINDOW_PX)))
            powers = np.floor(np.log2(fitting / whole))
            if powers >= 1.0:
                scale, middle = whole * 2.0**powers, 0.5 * (low + high)
        return scale, 0.5 * picture - scale * middle

    def _projected(self, p_body: FloatArray, T_cam_body: FloatArray) -> FloatArray:
        """(m, 2) pixels of the points (n, 3) that are known and before the camera."""
        p_cam = transform_points(T_cam_body, p_body[np.isfinite(p_body).all(axis=1)])
        p_cam = p_cam[p_cam[:, 2] > 0.0]
        return np.asarray(p_cam[:, :2] / p_cam[:, 2:] * self.focal_px + self.centre_px)

    def _background(self, time_s: float, scale: float, corner: FloatArray) -> Image.Image:
        picture = Image.new("RGB", (_WIDTH_PX, _HEIGHT_PX), _EMPTY)
        seen = self._image(time_s)
        if seen is not None:
            # No more of it than is seen: enlarged it may be as large as a wall.
            low = np.clip(-corner / scale, 0.0, self.size_px)
            high = np.clip((np.array(picture.size) - corner) / scale, 0.0, self.size_px)
            size = np.maximum(np.round(scale * (high - low)), 1.0).astype(int)
            grey = Image.fromarray(seen).convert("RGB")
            part = grey.resize((int(size[0]), int(size[1])), box=(*low.tolist(), *high.tolist()))
            at = np.round(corner + scale * low).astype(int)
            picture.paste(part, (int(at[0]), int(at[1])))
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


def _colours(features: FeatureTable | None, outcomes: FeatureOutcomes | None) -> dict[int, Rgb]:
    """By feature: of what became of it, else whether it is rejected in more frames than not."""
    if outcomes is not None:
        pairs = zip(outcomes.feature.tolist(), outcomes.outcome, strict=True)
        return {number: colour_of(outcome) for number, outcome in pairs}
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


def tracked_images(path: Path, result: Path | None, *, is_rig: bool) -> TrackedImages | None:
    """Of a recording of a rig or of one camera; None where it cannot be read.

    Of images the ``result`` folder holds the tracks that were found in them.
    """
    try:
        if is_rig:
            tracks = read_stereo_tracks(path)
            rig = tracks.rig
            focal = (rig.focal_px, rig.focal_px)
            return TrackedImages(rig.size_px, focal, rig.centre_px, tracks.frames)
        images = open_images(path) if is_image_sequence(path) else None
        folder = path if images is None else result
        own = None
        if images is None or (folder is not None and is_monocular_recording(folder)):
            assert folder is not None
            own = read_monocular_tracks(folder)
    except InputError:
        return None
    camera = own.camera if own is not None else images.camera if images is not None else None
    if camera is None:
        return None
    size, focal = (camera.width, camera.height), (camera.fx, camera.fy)
    frames = () if own is None else own.frames
    return TrackedImages(size, focal, (camera.cx, camera.cy), frames, images)
