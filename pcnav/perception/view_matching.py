"""Poses of a target from the look of its whole surface: no rectangle, edge or corner is needed.

The target is seen once from directions all over the sphere, without perspective, on a coarse metric
grid: which cells it covers and how deep they lie. A part of a frame is laid out on the same grid,
along its mean ray and at turns in the image plane. How well each view fits at each turn follows
from a few products of matrices (cells that both cover and their difference in depth, cells where
the view shows a surface and the frame sees through it, cells that only the frame covers), so it
costs the same for any mesh. The best are aligned with the surface seen from outside, all at once.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.perception.distinct_poses import distinct
from pcnav.perception.part_layout import Layout, PartCloud
from pcnav.perception.regions import Region
from pcnav.perception.sampled_views import SampledViews, Templates
from pcnav.perception.surface_alignment import aligned
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Target

_FIRST_TURN_STEP = 2
_DEPTH_SD_FRACTION = 0.05
"""Depths that scatter by this share of the diameter about a view's count half."""
_STRAY_WEIGHT = 0.6
_STRAY_WEIGHT_WINDOW = 0.25
"""What a cell that only the frame covers counts against a view; less where the part of the frame
was cut out of a larger object."""
_SHIFTS = tuple(
    sorted(
        ((x, y) for x in range(-4, 5, 2) for y in range(-4, 5, 2)),
        key=lambda s: s[0] ** 2 + s[1] ** 2,
    )
)
"""Where the middle of the target may be beside that of its returns, cells."""
_NEAR_SHIFTS = _SHIFTS[:5]
_SHIFTS_MATCHED = 4
_MIN_COMMON_CELLS = 6
_MAX_MATCHES = 60
_MAX_ALIGNED = 12


@dataclass(frozen=True)
class ViewMatch:
    """A pose that a sampled view proposes."""

    T_cam_model: FloatArray
    """(4, 4)"""
    fit: float
    """0 to 1: how well the surfaces lie on one another, a share of the returns."""


class PartLayout:
    """A part of a frame, laid out to be compared with the views of a target."""

    def __init__(self, region: Region, whole: Frame, views: SampledViews) -> None:
        self._views, self._part = views, PartCloud.of(region, whole)
        self._padded = self._part.layout(views.cell_m)
        self._is_partial = not region.is_whole or _is_cut(region.frame.depth_m > 0.0)
        self._stray = _STRAY_WEIGHT_WINDOW if region.is_window else _STRAY_WEIGHT
        self._poses: list[FloatArray] = []
        self._scores: list[FloatArray] = []

    def first_score(self) -> float:
        """0 to 1: how well any view fits, on few directions, turns and shifts."""
        few = _NEAR_SHIFTS if self._is_partial else _NEAR_SHIFTS[:1]
        score = max(self._coarse_score(shift) for shift in few)
        # A patch much smaller than the target fits anywhere on it.
        typical = float(np.median(self._views.templates.covered.sum(axis=1)))
        share = float(self._padded.covered.sum(axis=(1, 2)).max()) / max(typical, 1.0)
        return score * float(min(share, 1.0) ** 0.5)

    def match(self) -> float:
        """Compare with all views and keep the best; how well that fits.

        Where part of the target may be hidden, its middle is not that of its returns: what few
        views say of all shifts chooses those that all views are compared at.
        """
        shifts: Sequence[tuple[int, int]] = _SHIFTS[:1]
        if self._is_partial:
            scores = np.array([self._coarse_score(shift) for shift in _SHIFTS])
            shifts = [_SHIFTS[k] for k in np.argsort(-scores)[:_SHIFTS_MATCHED].tolist()]
        for shift in shifts:
            layout = self._padded.at(shift, 1, self._views.cell_m)
            score, offset = _scores(self._views.templates, layout, self._views, self._stray)
            best = np.argpartition(-score.ravel(), _MAX_MATCHES)[:_MAX_MATCHES]
            view, turn = np.unravel_index(best, score.shape)
            self._poses.append(self._poses_of(layout, view, turn, offset[view, turn]))
            self._scores.append(score[view, turn])
        return float(np.concatenate(self._scores).max())

    def _coarse_score(self, shift: tuple[int, int]) -> float:
        layout = self._padded.at(shift, _FIRST_TURN_STEP, self._views.cell_m)
        templates = self._views.templates.first()
        return float(_scores(templates, layout, self._views, self._stray)[0].max())

    def matches(self, target: Target) -> list[ViewMatch]:
        """Poses near those kept, aligned with the returns, the best fitting first."""
        poses, scores = np.concatenate(self._poses), np.concatenate(self._scores)
        kept = np.argsort(-scores)[:_MAX_MATCHES]
        surface, D = self._views.surface, self._views.diameter_m
        poses, fits = aligned(poses[kept], self._part.points_cam, surface, D, finely=False)
        chosen = distinct(poses, np.argsort(-fits), target, _MAX_ALIGNED)
        poses, fits = aligned(poses[chosen], self._part.points_cam, surface, D, finely=True)
        chosen = distinct(poses, np.argsort(-fits), target, _MAX_ALIGNED)
        return [ViewMatch(poses[k], float(fits[k])) for k in chosen]

    def _poses_of(
        self, layout: Layout, view: IntArray, turn: IntArray, offset: FloatArray
    ) -> FloatArray:
        """(k, 4, 4) the pose of each view at its turn and depth."""
        templates = self._views.templates
        R_turned_ray = layout.R_turned_ray[turn]
        R_cam_turned = np.swapaxes(R_turned_ray @ self._part.R_ray_cam, 1, 2)
        # The centre of the view lies at that of the layout.
        at = np.column_stack([layout.centre[turn], offset]) - templates.centre[view]
        poses = np.tile(np.eye(4), (len(view), 1, 1))
        poses[:, :3, :3] = R_cam_turned @ templates.R_view_model[view]
        poses[:, :3, 3] = np.einsum("kij,kj->ki", R_cam_turned, at) + self._part.mean_cam
        return poses


def _is_cut(seen: BoolArray) -> bool:
    """Whether returns (height, width) reach the border of the image."""
    return bool(seen[[0, -1]].any() or seen[:, [0, -1]].any())


def _scores(
    templates: Templates, layout: Layout, views: SampledViews, stray: float
) -> tuple[FloatArray, FloatArray]:
    """(n, t) how well each view fits at each turn, 0 to 1, and (n, t) the depth it fits at."""
    T, t = templates.covered, templates.depth
    F, d = layout.covered, layout.depth
    both = T @ F.T
    enough = np.maximum(both, 1.0)
    first = (T @ d.T - t @ F.T) / enough
    second = (T @ (d * d).T - 2.0 * (t @ d.T) + (t * t) @ F.T) / enough
    variance = np.maximum(second - first**2, 0.0)
    agree = both / (1.0 + variance / (_DEPTH_SD_FRACTION * views.diameter_m) ** 2)
    through = T @ layout.free.T
    only_frame = F.sum(axis=1)[None, :] - both
    score = agree / (both + through + stray * only_frame + 1e-6)
    score[both < _MIN_COMMON_CELLS] = 0.0
    return score, first
