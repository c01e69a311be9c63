"""The motions that take the surface of a target nearly onto itself, and how much then differs.

Turns about the centre of the surface are tried on a coarse map of what lies nearest to any place,
the most promising are moved to where they fit best, and what then lies further from the surface
than a tolerance is measured on the faces themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import (
    exp_rotation,
    invert_transform,
    make_transform,
    rotation_angle,
    rotation_from_xyzw,
    transform_points,
)
from pcnav.target.surface_samples import SurfaceSamples, edge_points, visible_probes

_GRID = 6_000
"""Rotations of the grid: 14 degrees apart."""
_GRID_POINTS, _ROUGH_POINTS, _FINE_POINTS = 120, 160, 250
_SEEN_POINTS = 400
"""Of a surface that is seen: what little tells attitudes apart is to be among them."""
_ROUGH_STARTS, _FINE_STARTS = 120, 24
_SHIFT_STEPS = 3
_ROUGH_STEPS, _FIRST_STEPS, _FINE_STEPS = 10, 4, 12
_FIRST_SLACK = 0.05
"""Share of the area that a coarse fit may leave off the surface where a fine one would not."""
_LIKE_NONE_RAD = np.radians(10.0)
"""A smaller turn takes any surface nearly onto itself."""
_ONE_RAD = np.radians(6.0)
"""Matches closer than this are one."""
_REACH_FRACTION = 0.1
"""Points further from the surface than this share of the diameter count as having no part there."""
_SLIDE_WEIGHT = 0.2
"""Of the distance along the surface, which a map of samples knows only to their spacing."""
_STILL_FRACTION = 1e-6


@dataclass(frozen=True)
class SelfMatch:
    """A motion of the model frame after which the target looks nearly as before."""

    T_model: FloatArray
    """(4, 4), proper. A target at ``T_cam_model`` looks nearly like one at
    ``T_cam_model @ T_model``."""
    differing_share: float
    """Share of the area seen from outside that the motion, or its inverse, takes further from the
    surface than the tolerance: 0 for a symmetry."""


class SelfMatcher:
    """Compares a mesh with itself."""

    def __init__(self, mesh: trimesh.Trimesh, tolerance_m: float) -> None:
        """Points within the tolerance of the surface, m, count as lying on it."""
        self.samples, self.probes = SurfaceSamples(mesh), visible_probes(mesh)
        self._tolerance_m = tolerance_m
        self._few = self.probes.some(_ROUGH_POINTS)
        edges = edge_points(mesh, _FINE_POINTS)
        # Surfaces slide along themselves without leaving themselves; edges hold them.
        self._fine = np.vstack([self.probes.some(_FINE_POINTS), edges])
        self._rough = self._fine[:: max(1, len(self._fine) // _ROUGH_POINTS)]

    @property
    def diameter_m(self) -> float:
        """Of the mesh."""
        return self.samples.diameter_m

    def all_over(self, max_share: float) -> list[SelfMatch]:
        """What is found from turns of all kinds, see `near`."""
        points = self.probes.some(_GRID_POINTS)
        return self.near(
            list(self._fitted_roughly(self._promising(points), self._rough)), max_share
        )

    def turned(self, points: FloatArray, count: int) -> list[FloatArray]:
        """Motions (4, 4) other than none, ``count`` of them, the likeliest first, after which
        points (n, 3) that were seen lie nearest to this surface, roughly."""
        some = points[:: max(1, len(points) // _SEEN_POINTS)]
        turns = np.concatenate(
            [self._shifted(part, some[::3]) for part in np.array_split(self._turns, 16)]
        )
        return _distinct(list(self._fitted_roughly(self._best_of(turns, some), some)))[:count]

    def near(self, starts: Sequence[FloatArray], max_share: float) -> list[SelfMatch]:
        """Motions near some (4, 4 each), the likeliest first, that leave at most a share of the
        area beyond the tolerance, the least first. Turns of less than 10 degrees are left out."""
        found: list[SelfMatch] = []
        for start in _distinct(starts)[:_FINE_STARTS]:
            finer = self.fitted_to_all(start, max_share + _FIRST_SLACK)
            if finer is None:
                continue
            share = self.differing_share(finer)
            if share <= max_share and self._is_new(finer, found):
                found.append(SelfMatch(finer, share))
        return sorted(found, key=lambda match: match.differing_share)

    def differing_share(self, T_model: FloatArray) -> float:
        """Share of the area seen that a motion (4, 4) or its inverse takes off the surface."""
        both = (T_model, invert_transform(T_model))
        return max(self._share(T, self.probes.points) for T in both)

    def fitted_to_all(self, T_model: FloatArray, max_share: float) -> FloatArray | None:
        """(4, 4) a motion moved to where the surface lies nearest to itself, see `fitted`; None if
        a first look finds clearly more than a share of it elsewhere."""
        T = self.fitted(T_model, self._rough, _FIRST_STEPS)
        if self._share(T, self._few) > 1.5 * max_share:
            return None
        return self.fitted(T, self._fine, _FINE_STEPS)

    def fitted(self, T_model: FloatArray, points: FloatArray, steps: int) -> FloatArray:
        """(4, 4) a motion moved to where points (n, 3) lie nearest to the surface; those that have
        no part there count little."""
        T, width_m = T_model, 0.25 * _REACH_FRACTION * self.diameter_m
        for _ in range(steps):
            moved = transform_points(T, points)
            nearest, along = self.samples.closest(moved, neighbours=3)
            apart = nearest - moved
            step = self._step(moved[None], apart[None], along[None], width_m, slide=0.0)
            T, width_m = step[0] @ T, max(0.7 * width_m, self._tolerance_m)
            if np.abs(step[0] - np.eye(4)).max() < _STILL_FRACTION * max(self.diameter_m, 1.0):
                break
        return T

    def _is_new(self, T: FloatArray, found: Sequence[SelfMatch]) -> bool:
        known = [match.T_model for match in found]
        return len(_distinct([*known, T])) > len(known)

    def _share(self, T: FloatArray, points: FloatArray) -> float:
        return float(self.samples.is_off(transform_points(T, points), self._tolerance_m).mean())

    def _promising(self, points: FloatArray) -> FloatArray:
        """(n, 4, 4) turns that leave points (n, 3) nearest to the surface."""
        return self._best_of(self._turns, points)

    @cached_property
    def _turns(self) -> FloatArray:
        """(n, 4, 4) turns of all kinds about the middle of the surface."""
        R = np.concatenate([_turns_about(self.probes.axes), _rotation_grid()])
        return turns_about_point(self.probes.centre, R[rotation_angle(R) > _LIKE_NONE_RAD])

    def _best_of(self, turns: FloatArray, points: FloatArray) -> FloatArray:
        """(n, 4, 4) those that leave points (m, 3) nearest to the surface, the nearest first."""
        # In parts, which bounds the memory.
        cost = [self._mean_distance(part, points) for part in np.array_split(turns, 16)]
        order = np.argsort(np.concatenate(cost), kind="stable")
        return np.asarray(turns[order[:_ROUGH_STARTS]])

    def _shifted(self, T: FloatArray, points: FloatArray) -> FloatArray:
        """Motions (n, 4, 4) shifted to where points (m, 3) lie nearer to the surface: what is seen
        of a body need not turn about its middle, a ball with boxes on it turns about the ball's."""
        width_m = 0.5 * _REACH_FRACTION * self.diameter_m
        for _ in range(_SHIFT_STEPS):
            moved = transform_points(T, points)
            nearest, normal = self.samples.nearest_roughly(moved)
            off = np.sum((nearest - moved) * normal, axis=-1)
            weight = 1.0 / (1.0 + (off / width_m) ** 2) ** 2
            H = np.swapaxes(normal * weight[..., None], 1, 2) @ normal
            H += 1e-3 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(3)
            g = np.sum((weight * off)[..., None] * normal, axis=1)
            T = T.copy()
            T[:, :3, 3] += np.linalg.solve(H, g[..., None])[..., 0]
        return T

    def _mean_distance(self, T: FloatArray, points: FloatArray) -> FloatArray:
        """(k,) of points (n, 3) from the surface, roughly, after motions (k, 4, 4), m."""
        moved = transform_points(T, points)
        nearest, normal = self.samples.nearest_roughly(moved)
        # Samples are further apart than what is told apart here: of the way to one, what leads
        # along the surface counts only beyond their spacing.
        way = moved - nearest
        apart = np.abs(np.sum(way * normal, axis=-1))
        along = np.linalg.norm(way, axis=-1) - self.samples.spacing_m
        apart = np.maximum(apart, along)
        return np.asarray(np.minimum(apart, _REACH_FRACTION * self.diameter_m).mean(axis=1))

    def _fitted_roughly(self, T: FloatArray, points: FloatArray) -> FloatArray:
        """Motions (n, 4, 4) moved to where points (m, 3) fit best on the coarse map, the best
        fitting first."""
        width_m = 0.2 * _REACH_FRACTION * self.diameter_m
        for _ in range(_ROUGH_STEPS):
            moved = transform_points(T, points)
            nearest, normal = self.samples.nearest_roughly(moved)
            T = self._step(moved, nearest - moved, normal, width_m, _SLIDE_WEIGHT) @ T
        return np.asarray(T[np.argsort(self._mean_distance(T, points), kind="stable")])

    def _step(
        self,
        moved: FloatArray,
        apart: FloatArray,
        along: FloatArray,
        width_m: float,
        slide: float,
    ) -> FloatArray:
        """(k, 4, 4) motions by which points (k, n, 3) that lie ``apart`` from the surface come
        nearer to it: one Gauss-Newton step of the distances along unit vectors and, with a weight,
        of the distances themselves. Those much over a width count little."""
        size, centre = self.diameter_m, self.probes.centre
        weight = 1.0 / (1.0 + np.sum(apart**2, axis=-1) / width_m**2) ** 2
        lever = (moved - centre) / size
        J = np.concatenate([np.cross(lever, along), along], axis=-1)
        H = np.swapaxes(J * weight[..., None], 1, 2) @ J
        e = weight * np.sum(apart * along, axis=-1)
        g = np.einsum("kn,kni->ki", e, J)
        if slide > 0.0:
            for axis in np.eye(3):
                J = np.concatenate([np.cross(lever, axis), np.broadcast_to(axis, lever.shape)], -1)
                H += slide * np.swapaxes(J * weight[..., None], 1, 2) @ J
                g += slide * np.einsum("kn,kni->ki", weight * (apart @ axis), J)
        # A body of revolution does not say how to turn it: then it is not turned.
        H += 1e-9 * np.trace(H, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        step = np.linalg.solve(H, g[..., None])[..., 0]
        R = exp_rotation(step[:, :3] / size)
        return make_transform(R, centre - R @ centre + step[:, 3:])


def near_symmetries(matcher: SelfMatcher, max_share: float = 0.4) -> tuple[SelfMatch, ...]:
    """The motions after which a mesh looks nearly as before, that which changes least first.

    These are the poses that a right pose is mistaken for: a start has to rule out each of them,
    ``T_cam_model @ match.T_model``, by the share of the surface that differs. Symmetries are among
    them, with a share of 0 or nearly, the identity and turns of less than 10 degrees are not. About
    an axis the target is nearly round about there are some, not all.

    Args:
        matcher: of the mesh, and of what no sensor tells from its surface.
        max_share: of the area seen from outside that may lie beyond the tolerance.
    """
    return tuple(matcher.all_over(max_share))


def turns_about_point(point: FloatArray, R: FloatArray) -> FloatArray:
    """(..., 4, 4) turns R (..., 3, 3) about a point (3,)."""
    return make_transform(R, point - R @ point)


def _turns_about(axes: FloatArray) -> FloatArray:
    """(n, 3, 3) half, third and quarter turns about axes, columns of (3, 3)."""
    return np.stack([exp_rotation(2.0 * np.pi / n * a) for a in axes.T for n in (2, 3, -3, 4, -4)])


def _rotation_grid() -> FloatArray:
    """(n, 3, 3) rotations spread evenly (super-Fibonacci spiral, Alexa 2022)."""
    s = np.arange(_GRID) + 0.5
    inner, outer = np.sqrt(s / _GRID), np.sqrt(1.0 - s / _GRID)
    a, b = 2.0 * np.pi * s / np.sqrt(2.0), 2.0 * np.pi * s / 1.533751168755204288118041
    xyzw = [inner * np.sin(a), inner * np.cos(a), outer * np.sin(b), outer * np.cos(b)]
    return rotation_from_xyzw(np.stack(xyzw, axis=1))


def _distinct(motions: Sequence[FloatArray]) -> list[FloatArray]:
    """Those of motions (4, 4) that are neither the identity nor an earlier one."""
    kept: list[FloatArray] = []
    for motion in motions:
        between = motion[:3, :3].T @ np.stack([np.eye(4), *kept])[:, :3, :3]
        angles = rotation_angle(between)
        if angles[0] > _LIKE_NONE_RAD and angles.min() > _ONE_RAD:
            kept.append(motion)
    return kept
