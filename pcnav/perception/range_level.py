"""The level of the white noise along the rays, and how it grows with range, learnt from frames.

Each face of each frame gives the variance of its residuals about their own smooth fit: neither an
error of the pose nor one that the face shares is in it.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.perception.correlated_ranges import face_field
from pcnav.perception.modality import RangeResiduals
from pcnav.perception.sensor_noise import SensorNoise

_MIN_PIXELS = 60
"""Fewer pixels of a face are not used."""
_GATE = 4.0
"""Residuals beyond this many deviations are outliers,"""
_KEPT_VARIANCE = 0.99893
"""and those within it have this share of the variance."""
_MAD_TO_SD = 1.4826
_FACE_SPREAD = 0.15
"""Variances of faces differ by this much for other reasons: incidence, paint."""
_MEMORY = 0.98
"""What a frame says is worth this much in the next."""
_GROWTHS = (0, 1, 2)
_CLEAR_GROWTH = 9.0
"""By so much must the weighted squares fall for noise to grow with range."""
_MIN_FRAMES = 5
_TOLERATED = 0.06
"""Stated noise that is right to this share is not changed."""
_LAG_PX = 3
"""Neighbours err alike; pixels so far apart do not, and show the same surface."""


@dataclass(frozen=True)
class FaceLevel:
    """Variance of the white noise of one face in one frame."""

    range_m: float
    variance_m2: float
    n_pixels: int


def face_levels(seen: RangeResiduals, noise: SensorNoise) -> list[FaceLevel]:
    """Of the faces of which enough is seen."""
    levels = []
    faces, counts = np.unique(seen.face[seen.agrees], return_counts=True)
    for face in faces[counts >= _MIN_PIXELS].tolist():
        chosen = np.flatnonzero((seen.face == face) & seen.returned)
        sure = seen.agrees[chosen]
        r, range_m = seen.residual_m[chosen], float(np.mean(seen.range_m[chosen]))
        terms = smooth_terms(seen.u[chosen], seen.v[chosen])
        if face < 0:
            # Of surfaces that are on no plane, the pose moves some nearer and others farther.
            terms = np.hstack([terms, seen.jacobian[chosen]])
        # More than half of the returns may be from something before the face: what agrees with it
        # says where its returns are and, cut off as it is, how wide about to look for more.
        centre = float(np.median(r[sure]))
        floor = 0.3 * float(noise.sigma_at(range_m))
        scale = max(_MAD_TO_SD * float(np.median(np.abs(r[sure] - centre))), floor)
        near = np.abs(r - centre) < 2.0 * _GATE * scale
        for _ in range(2):
            fit = np.linalg.lstsq(terms[near], r[near], rcond=1e-8)[0]
            rest = r - terms @ fit
            scale = max(_MAD_TO_SD * float(np.median(np.abs(rest[near]))), floor)
            near = np.abs(rest) < _GATE * scale
        n = int(np.count_nonzero(near))
        if n < _MIN_PIXELS:
            continue
        squares = float(rest[near] @ rest[near]) / max(n - terms.shape[1], 1)
        levels.append(FaceLevel(range_m, squares / _KEPT_VARIANCE, n))
    return levels


def smooth_terms(u: FloatArray, v: FloatArray) -> FloatArray:
    """(n, 6) an offset, two tilts and three bends over pixels (n,)."""
    field_ = face_field(u, v)
    one, a, b = field_.T
    return np.column_stack([field_, a**2 - one, a * b, b**2 - one])


@dataclass(frozen=True)
class RangeLevel:
    """What the frames so far tell of the white noise, as a regression of the logarithm of the
    variance on that of the range."""

    stated_m: float | None
    """What the recording says; None where it says nothing."""
    reference_m: float = 1.0
    sums: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Weighted sums of 1, x, x^2, y, x y and y^2."""
    frames: int = 0

    def with_levels(self, levels: list[FaceLevel]) -> "RangeLevel":
        """Take in the faces of a frame."""
        if not levels:
            return self
        reference_m = self.reference_m if self.frames else levels[0].range_m
        sums = self.sums * _MEMORY
        for level in levels:
            x = np.log(level.range_m / reference_m)
            y = np.log(max(level.variance_m2, 1e-300))
            weight = 1.0 / (2.0 / level.n_pixels + _FACE_SPREAD**2)
            sums = sums + weight * np.array([1.0, x, x * x, y, x * y, y * y])
        return replace(self, reference_m=reference_m, sums=sums, frames=self.frames + 1)

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of it; as it is where that is right."""
        if self.frames < _MIN_FRAMES:
            return noise
        w, x, xx, y, xy, yy = self.sums
        left, level = [], []
        for growth in _GROWTHS:
            # The mean of y - 2 g x, and the squares about it.
            mean = (y - 2.0 * growth * x) / w
            squares = yy - 4.0 * growth * xy + 4.0 * growth**2 * xx
            left.append(squares - w * mean**2)
            level.append(mean)
        best = int(np.argmin(left))
        if left[0] - left[best] < _CLEAR_GROWTH:
            best = 0
        sigma_m = float(np.exp(0.5 * level[best]))
        if best == 0 and noise.growth == 0 and self._is_right(sigma_m, noise.sigma_m):
            return noise
        return replace(noise, sigma_m=sigma_m, growth=_GROWTHS[best], reference_m=self.reference_m)

    def _is_right(self, sigma_m: float, current_m: float) -> bool:
        return bool(abs(np.log(sigma_m / current_m)) < _TOLERATED)


def first_guess(depth_m: DepthImage, camera: PinholeCamera) -> float | None:
    """Range noise, m, of a frame (height, width) of which nothing is known; None without returns.

    Ranges of pixels a few apart on a smooth surface change evenly: the median of the second
    differences, which edges and outliers hardly move, gives the deviation. Rows and columns of a
    flat face quantised to a step show no difference at all; the step's own deviation is the least.
    """
    range_m = depth_m.astype(np.float64) * range_per_depth(camera)
    step_m = _step(depth_m)
    found = []
    for image in (range_m, range_m.T):
        a, b, c = image[:, : -2 * _LAG_PX], image[:, _LAG_PX:-_LAG_PX], image[:, 2 * _LAG_PX :]
        whole = (a > 0.0) & (b > 0.0) & (c > 0.0)
        if np.count_nonzero(whole) >= _MIN_PIXELS:
            bend = np.abs(a - 2.0 * b + c)[whole]
            found.append(_MAD_TO_SD * float(np.median(bend)) / np.sqrt(6.0))
    if not found:
        return None
    return float(max(min(found), step_m / np.sqrt(12.0)))


def _step(depth_m: DepthImage) -> float:
    """The smallest difference between depths of an image: the step they are stored in."""
    values = np.unique(depth_m[depth_m > 0.0])
    return float(np.min(np.diff(values))) if len(values) > 1 else 0.0
