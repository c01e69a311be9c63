"""Corners followed through images: Lucas-Kanade forward and backward, and a geometric check."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pcnav.config.image_motion import FeatureTrackerTable
from pcnav.core._extras import opencv
from pcnav.core.arrays import BoolArray, FloatArray, IntArray, picked
from pcnav.core.camera import PinholeCamera
from pcnav.perception.patch_alignment import Patches, PatchGrid, SmoothImage, align, patches_of
from pcnav.recordings.images import GreyImage
from pcnav.recordings.tracks import TrackFrame

_EDGE_PX = 4.0
"""Corners closer to the edge of the image than this are let go: their patch is cut."""
_MIN_CHECKED = 8
_BRIGHT_PERCENT = 99.0
_GRAIN_PX = 5
_MAX_RESIDUAL = 2.0
"""Of a patch over the median of the image."""


@dataclass(frozen=True)
class _Followed:
    """The corners of the last image."""

    image: GreyImage
    features: IntArray
    """(n,)"""
    pixels: FloatArray
    """(n, 2)"""
    patches: Patches
    """Of the images that the corners were first seen in."""
    linear: FloatArray
    """(n, 2, 2) how each patch is seen now, over how it was then."""


@dataclass
class FeatureTracker:
    """Follows corners from image to image and finds new ones where some were lost.

    A corner is found near where the last image leads, by the patch of the image it was first seen
    in, which may have been sheared, stretched and lit anew since: so its error does not grow from
    image to image. When that patch no longer fits, the corner is let go. One that is lost and
    found again gets a new number.
    """

    camera: PinholeCamera
    settings: FeatureTrackerTable
    _last: _Followed | None = field(default=None, init=False)
    _next: int = field(default=0, init=False)
    _grain: float = field(default=0.0, init=False)
    """Grey levels by which patches differ from their first sight, median of the last image."""

    def step(self, image: GreyImage) -> tuple[IntArray, FloatArray]:
        """Numbers (n,) and pixels (n, 2) of the corners of an image (height, width).

        Raises `InputError` without OpenCV.
        """
        smooth = self._smooth(image)
        if self._last is None:
            kept = _no_corners(image, smooth, self._grid)
        else:
            kept = self._follow(self._last, image, smooth)
        new = self._corners(image, kept.pixels, self.settings.max_features - len(kept.features))
        patches = patches_of(smooth, new, self._grid)
        fit = patches.usable & (
            self._errors_px(patches, self._grain) <= self.settings.pixel_sigma_px
        )
        new, patches = new[fit], picked(patches, fit)
        numbers: IntArray = np.arange(self._next, self._next + len(new), dtype=np.intp)
        self._last = _Followed(
            image,
            np.concatenate([kept.features, numbers]),
            np.concatenate([kept.pixels, new]),
            kept.patches.and_those(patches),
            np.concatenate([kept.linear, np.broadcast_to(np.eye(2), (len(new), 2, 2))]),
        )
        self._next += len(new)
        return self._last.features, self._last.pixels

    @property
    def _grid(self) -> PatchGrid:
        return PatchGrid(self.settings.window_px)

    def _smooth(self, image: GreyImage) -> SmoothImage:
        sigma = self.settings.smoothing_px
        blurred = opencv("following features").GaussianBlur(
            np.asarray(image, dtype=np.float32), (0, 0), sigma
        )
        return np.asarray(blurred, dtype=np.float32)

    def _follow(self, last: _Followed, image: GreyImage, smooth: SmoothImage) -> _Followed:
        """The corners of the last image that are found in this one."""
        if not len(last.features):
            return _no_corners(image, smooth, self._grid)
        there, found = self._flow(last.image, image, last.pixels)
        back, found_back = self._flow(image, last.image, there)
        returned = np.linalg.norm(back - last.pixels, axis=1) <= self.settings.backward_px
        at = np.flatnonzero(found & found_back & returned & self._inside(there))
        patches = picked(last.patches, at)
        aligned = align(smooth, patches, there[at], last.linear[at], self._grid)
        near = np.linalg.norm(aligned.pixels - there[at], axis=1) <= self.settings.anchor_px
        alike = aligned.correlation >= self.settings.min_correlation
        good = aligned.settled & near & alike & self._inside(aligned.pixels)
        good &= self._as_good_as_stated(patches, aligned.residual, good)
        good[good] = self._sharing_a_motion(last.pixels[at[good]], aligned.pixels[good])
        return _Followed(
            image,
            last.features[at[good]],
            aligned.pixels[good],
            picked(patches, good),
            aligned.linear[good],
        )

    def _as_good_as_stated(
        self, patches: Patches, residual: FloatArray, matched: BoolArray
    ) -> BoolArray:
        """(n,) patches that differ by no more than the noise, and whose noise places them well.

        What differs more than others in the same image holds two surfaces, or an edge of shadow.
        """
        if not matched.any():
            return matched
        self._grain = float(np.median(residual[matched]))
        like_noise = residual <= _MAX_RESIDUAL * self._grain
        return np.asarray(
            like_noise & (self._errors_px(patches, residual) <= self.settings.pixel_sigma_px)
        )

    def _errors_px(self, patches: Patches, residual: FloatArray | float) -> FloatArray:
        """(n,) standard deviation of a patch's place, per axis, from the grey levels that differ.

        Smoothing makes the noise of neighbours alike: its density at the wavelengths of a patch
        stays what it was, while its variance falls by 4 pi times the square of the width.
        """
        alike = max(1.0, float(np.sqrt(4.0 * np.pi)) * self.settings.smoothing_px)
        return np.asarray(patches.error_gain * residual * alike)

    def _flow(
        self, first: GreyImage, second: GreyImage, pixels: FloatArray
    ) -> tuple[FloatArray, BoolArray]:
        """Where pixels (n, 2) went, by a shift of the patch, and whether that is known."""
        side = self.settings.window_px
        cv2 = opencv("following features")
        there, found, _ = cv2.calcOpticalFlowPyrLK(
            first,
            second,
            _points(pixels),
            None,
            winSize=(side, side),
            maxLevel=self.settings.pyramid_levels,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-3),
        )
        pixels = np.asarray(there, dtype=np.float64).reshape(-1, 2)
        return pixels, np.asarray(found).ravel() != 0

    def _sharing_a_motion(self, before: FloatArray, now: FloatArray) -> BoolArray:
        """(n,) the matches that lie on the epipolar lines of one motion, or have not moved."""
        everything = np.ones(len(before), dtype=np.bool_)
        limit = self.settings.geometric_check_px
        moved = np.linalg.norm(now - before, axis=1)
        if len(before) < _MIN_CHECKED or np.median(moved) < limit:
            # Of a target that hardly moves the epipolar lines are open; any match would pass.
            return everything
        cv2 = opencv("checking features")
        _, mask = cv2.findEssentialMat(
            np.ascontiguousarray(before),
            np.ascontiguousarray(now),
            cameraMatrix=self.camera.matrix,
            method=cv2.USAC_ACCURATE,
            prob=0.9999,
            threshold=limit,
        )
        agreeing = everything if mask is None else np.asarray(mask).ravel() != 0
        return agreeing if agreeing.sum() >= _MIN_CHECKED else everything

    def _corners(self, image: GreyImage, taken: FloatArray, wanted: int) -> FloatArray:
        """(n, 2) at most so many corners, away from the pixels (m, 2) taken."""
        if wanted <= 0:
            return np.zeros((0, 2))
        cv2 = opencv("finding features")
        spacing = self.settings.spacing_px
        free = self._inland(image)
        for u, v in np.rint(taken).astype(int):
            cv2.circle(free, (int(u), int(v)), int(np.ceil(spacing)), 0, -1)
        found = cv2.goodFeaturesToTrack(image, wanted, self.settings.quality, spacing, mask=free)
        if found is None:
            return np.zeros((0, 2))
        side = (5, 5)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 1e-3)
        refined = cv2.cornerSubPix(image, found, side, (-1, -1), criteria)
        pixels = np.asarray(refined, dtype=np.float64).reshape(-1, 2)
        return pixels[self._inside(pixels)]

    def _inland(self, image: GreyImage) -> GreyImage:
        """255 where corners may be: away from the outline against dark space.

        What looks like a corner there moves with the outline, not with the target.
        """
        cv2 = opencv("finding features")
        bright = float(np.percentile(image[image > 0], _BRIGHT_PERCENT)) if image.any() else 0.0
        target = np.asarray(image > self.settings.dark_fraction * bright, dtype=np.uint8)
        side = 2 * int(np.ceil(self.settings.outline_px)) + 1
        # Closing first: dark grains within the target are no outline.
        grain = np.ones((_GRAIN_PX, _GRAIN_PX), dtype=np.uint8)
        closed = cv2.morphologyEx(target, cv2.MORPH_CLOSE, grain)
        inland = cv2.erode(closed, np.ones((side, side), dtype=np.uint8))
        return np.asarray(255 * inland, dtype=np.uint8)

    def _inside(self, pixels: FloatArray) -> BoolArray:
        high = np.array([self.camera.width, self.camera.height]) - 1.0 - _EDGE_PX
        return np.asarray(np.all((pixels >= _EDGE_PX) & (pixels <= high), axis=1))


def _points(pixels: FloatArray) -> npt.NDArray[np.float32]:
    """(n, 1, 2) as OpenCV takes and overwrites them."""
    return np.array(pixels, dtype=np.float32, order="C").reshape(-1, 1, 2)


def _no_corners(image: GreyImage, smooth: SmoothImage, grid: PatchGrid) -> _Followed:
    nothing: IntArray = np.zeros(0, dtype=np.intp)
    nowhere = np.zeros((0, 2))
    return _Followed(
        image, nothing, nowhere, patches_of(smooth, nowhere, grid), np.zeros((0, 2, 2))
    )


def track_features(
    images: Iterable[tuple[float, FloatArray, GreyImage]],
    camera: PinholeCamera,
    settings: FeatureTrackerTable,
) -> Iterator[TrackFrame]:
    """Tracks of images given as time (s), R_cam_world (3, 3) and grey levels.

    Raises `InputError` without OpenCV.
    """
    tracker = FeatureTracker(camera, settings)
    for time_s, R_cam_world, image in images:
        features, pixels = tracker.step(image)
        yield TrackFrame(time_s, R_cam_world, features, pixels)
