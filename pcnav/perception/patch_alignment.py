"""Patches of an image found again in a later one, where they are seen from another side.

A small patch of a surface that turns is sheared, stretched and lit anew. Matching it by a shift
alone drifts by a tenth of a pixel for every degree; here the patch may also change by a linear map
of its coordinates and by gain and offset of its grey levels. The linearisation is that of the
first image (inverse compositional: Baker and Matthews 2004; affine patches: Shi and Tomasi 1994),
with gain and offset as two more columns, so the normal matrix of a patch is made once.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcnav.core.arrays import BoolArray, FloatArray

_MAX_STEPS = 12
_SETTLED_PX = 0.003
_MIN_GAIN = 0.1
_MIN_AREA, _MAX_AREA = 0.3, 3.0
"""Of a patch, over that of its first sight: beyond, the two images resolve it too differently."""
_TINY = 1e-9

SmoothImage = npt.NDArray[np.float32]
"""(height, width) grey levels without the finest grain, which no interpolation carries over."""


@dataclass(frozen=True)
class Patches:
    """n patches as first seen, and how their grey levels change with where they are taken."""

    grey: FloatArray
    """(n, m) grey levels of the m pixels of each."""
    rows: FloatArray
    """(n, 8, m) weighted least squares: grey levels of a later image to the changes of
    place (2), of the linear map (4), of gain and offset."""
    usable: BoolArray
    """(n,) whether the patch has structure in all directions."""

    @property
    def error_gain(self) -> FloatArray:
        """(n,) px of error of the place, per axis, for each grey level of independent noise."""
        return np.asarray(np.sqrt(0.5 * np.sum(self.rows[:, :2] ** 2, axis=(1, 2))))

    def and_those(self, other: "Patches") -> "Patches":
        """These, then the others."""
        return Patches(
            np.concatenate([self.grey, other.grey]),
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.usable, other.usable]),
        )


@dataclass(frozen=True)
class Alignment:
    """Where patches are found."""

    pixels: FloatArray
    """(n, 2)"""
    linear: FloatArray
    """(n, 2, 2) takes offsets from a patch's middle in its first image to offsets in this one."""
    correlation: FloatArray
    """(n,) of the grey levels, 1 where gain and offset explain all that differs."""
    residual: FloatArray
    """(n,) RMS of the grey levels that gain and offset leave, over the gain: those of the patch."""
    settled: BoolArray
    """(n,) whether the alignment converged within the image."""


@dataclass(frozen=True)
class PatchGrid:
    """The pixels of a patch about its middle."""

    side: int
    """Odd, px."""

    @property
    def offsets(self) -> FloatArray:
        """(m, 2) px."""
        line = np.arange(self.side) - 0.5 * (self.side - 1)
        u, v = np.meshgrid(line, line)
        return np.column_stack([u.ravel(), v.ravel()])

    @property
    def weights(self) -> FloatArray:
        """(m,) falling off from the middle, so that what enters at the rim counts little."""
        return np.asarray(np.exp(-0.5 * np.sum((self.offsets / (0.3 * self.side)) ** 2, axis=1)))


def patches_of(image: SmoothImage, pixels: FloatArray, grid: PatchGrid) -> Patches:
    """The patches about pixels (n, 2) of an image. Those that leave the image are not usable."""
    places = pixels[:, None, :] + grid.offsets
    grey = _sampled(image, places)
    step = np.array([0.5, 0.0])
    by_u = _sampled(image, places + step) - _sampled(image, places - step)
    by_v = _sampled(image, places + step[::-1]) - _sampled(image, places - step[::-1])
    u, v = grid.offsets.T
    one = np.ones_like(grey)
    columns = np.stack([by_u, by_v, by_u * u, by_u * v, by_v * u, by_v * v, grey, one], axis=1)
    columns = np.nan_to_num(columns)
    weighted = columns * grid.weights
    normal = weighted @ np.swapaxes(columns, 1, 2)
    scale = np.sqrt(np.einsum("nii->ni", normal)) + _TINY
    normal = normal / (scale[:, :, None] * scale[:, None, :])
    usable = np.all(np.isfinite(grey), axis=1) & (np.linalg.eigvalsh(normal)[:, 0] > _TINY)
    normal[~usable] = np.eye(8)
    rows = np.linalg.solve(normal, weighted / scale[:, :, None]) / scale[:, :, None]
    return Patches(np.nan_to_num(grey), rows, usable)


def align(
    image: SmoothImage, patches: Patches, pixels: FloatArray, linear: FloatArray, grid: PatchGrid
) -> Alignment:
    """Find n patches near pixels (n, 2), each seen through a linear map near ``linear``.

    The maps (n, 2, 2) are those of the last image, the identity for patches first seen there.
    """
    pixels, linear = pixels.copy(), linear.copy()
    settled = np.zeros(len(pixels), dtype=np.bool_)
    active = patches.usable.copy()
    for _ in range(_MAX_STEPS):
        k = np.flatnonzero(active)
        if not len(k):
            break
        seen = _sampled(image, pixels[k, None, :] + grid.offsets @ np.swapaxes(linear[k], 1, 2))
        whole = np.all(np.isfinite(seen), axis=1)
        change = np.einsum("nim,nm->ni", patches.rows[k], np.nan_to_num(seen))
        whole &= change[:, 6] > _MIN_GAIN
        gain = np.where(whole, change[:, 6], 1.0)[:, None]
        shift, turn = change[:, :2] / gain, (change[:, 2:6] / gain).reshape(-1, 2, 2)
        # The patch of the first image would have to move by the change; so this one moves back.
        back, possible = _inverse(np.eye(2) + turn)
        moved = linear[k] @ back
        area = np.linalg.det(moved)
        whole &= possible & (area > _MIN_AREA) & (area < _MAX_AREA)
        by = -np.einsum("nij,nj->ni", moved, shift)
        at = k[whole]
        pixels[at], linear[at] = pixels[at] + by[whole], moved[whole]
        step = np.linalg.norm(by, axis=1) + 0.5 * grid.side * np.abs(turn).max(axis=(1, 2))
        done = whole & (step < _SETTLED_PX * grid.side)
        settled[k[done]] = True
        active[k[done | ~whole]] = False
    correlation, residual = _compared(image, patches, pixels, linear, grid)
    return Alignment(pixels, linear, correlation, residual, settled)


def _compared(
    image: SmoothImage, patches: Patches, pixels: FloatArray, linear: FloatArray, grid: PatchGrid
) -> tuple[FloatArray, FloatArray]:
    """Correlation and residual (n,) of the grey levels; 0 and inf for one that leaves the image."""
    seen = _sampled(image, pixels[:, None, :] + grid.offsets @ np.swapaxes(linear, 1, 2))
    whole = np.all(np.isfinite(seen), axis=1)
    weights = grid.weights / grid.weights.sum()
    a = patches.grey - (patches.grey @ weights)[:, None]
    seen = np.nan_to_num(seen)
    b = seen - (seen @ weights)[:, None]
    first, both, second = a**2 @ weights + _TINY, (a * b) @ weights, b**2 @ weights + _TINY
    correlation = np.where(whole, both / np.sqrt(first * second), 0.0)
    gain = np.maximum(both / first, _MIN_GAIN)
    residual = np.sqrt(np.maximum(second - both**2 / first, 0.0)) / gain
    return correlation, np.where(whole, residual, np.inf)


def _inverse(matrix: FloatArray) -> tuple[FloatArray, BoolArray]:
    """(n, 2, 2) inverses, and which exist."""
    determinant = np.linalg.det(matrix)
    exists = np.abs(determinant) > 0.1
    inverse = np.empty_like(matrix)
    inverse[:, 0, 0], inverse[:, 1, 1] = matrix[:, 1, 1], matrix[:, 0, 0]
    inverse[:, 0, 1], inverse[:, 1, 0] = -matrix[:, 0, 1], -matrix[:, 1, 0]
    return inverse / np.where(exists, determinant, 1.0)[:, None, None], exists


def _sampled(image: SmoothImage, places: FloatArray) -> FloatArray:
    """Grey levels at places (..., 2), between the four pixels about each; nan outside."""
    u, v = places[..., 0], places[..., 1]
    height, width = image.shape
    inside = (u >= 0.0) & (v >= 0.0) & (u < width - 1.0) & (v < height - 1.0)
    u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
    left, top = u.astype(np.intp), v.astype(np.intp)
    right, down = u - left, v - top
    flat, at = image.ravel(), top * width + left
    upper = flat[at] * (1.0 - right) + flat[at + 1] * right
    lower = flat[at + width] * (1.0 - right) + flat[at + width + 1] * right
    return np.where(inside, upper * (1.0 - down) + lower * down, np.nan)
