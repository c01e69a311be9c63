"""What can be done to a target without a trace: turns of a finite group, and about a round axis.

Whether a motion leaves a trace is a matter of the sensor: it does where enough of the surface seen
from outside is moved off itself by more than noise and pixels hide. The search is `self_matches`.
"""

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import (
    exp_rotation,
    invert_transform,
    log_rotation,
    make_transform,
    nearest_rotation,
    rotation_angle,
    transform_points,
)
from pcnav.target.mesh import mesh_diameter
from pcnav.target.roundness import Roundness
from pcnav.target.self_matches import SelfMatcher, turns_about_point

_SAME_ANGLE_RAD = np.radians(1.0)
_NOISE_FRACTION, _PIXEL_FRACTION = 0.002, 1.0 / 180.0
"""A sensor nobody says anything of: noise and size of a pixel over the diameter, which a target
that fills most of an image of 256 pixels has."""
_TOLERANCE_NOISE, _TOLERANCE_PIXELS = 3.0, 0.5
_ROUND_NOISE = 1.5
_MAX_SHARE = 0.005
_SPECK_PIXELS = 4.0
_UNLIKE_MOMENTS = 0.15
_SCANNED = 20
_ROUGHLY_ROUND_SHARE = 0.1
_HALF_TURN_RAD = np.radians(179.0)
_MAX_ORDER = 120
_GOLDEN_RAD = np.pi * (3.0 - np.sqrt(5.0))
_MATCHED_VERTICES, _VERTEX_SHARE = 3_000, 0.3


@dataclass(frozen=True)
class Resolution:
    """What a sensor tells from a surface, at the distance that it works at."""

    noise_m: float
    """Standard deviation of ranges."""
    pixel_m: float
    """What a pixel sees of a surface across the line of sight."""

    @staticmethod
    def usual(diameter_m: float) -> "Resolution":
        """Of a sensor of which nothing is known but that it sees a target of this diameter well."""
        return Resolution(_NOISE_FRACTION * diameter_m, _PIXEL_FRACTION * diameter_m)

    @property
    def tolerance_m(self) -> float:
        """Nearer to a surface than this nothing is seen to be off it."""
        return max(_TOLERANCE_NOISE * self.noise_m, _TOLERANCE_PIXELS * self.pixel_m)


@dataclass(frozen=True)
class Symmetry:
    """All motions that a target looks the same after: those of a group, each maybe followed by any
    turn about a round axis."""

    motions: FloatArray
    """(n, 4, 4) proper rigid motions of the model frame, the identity first, then by angle."""
    roundness: Roundness | None = None

    @property
    def name(self) -> str:
        """For tables: see `group_name`; of round bodies "round about z" and "ball"."""
        return symmetry_name(self.motions, self.roundness)


def find_symmetry(mesh: trimesh.Trimesh, resolution: Resolution | None = None) -> Symmetry:
    """The symmetry of a mesh (metres), as a sensor of some resolution sees it.

    A motion is a symmetry when it moves less than half a percent of the area seen from outside off
    the surface by more than three deviations of the noise and half a pixel, and nothing at all by
    more than four pixels. Reflections are none. A body is round about an axis when the facets of
    its mesh are finer than the noise.
    """
    resolution = resolution or Resolution.usual(mesh_diameter(mesh))
    return _Finder(mesh, resolution).found()


class _Finder:
    """Looks for the symmetry of one mesh."""

    def __init__(self, mesh: trimesh.Trimesh, resolution: Resolution) -> None:
        self._vertices = np.asarray(mesh.vertices)
        self._resolution = resolution
        self._matcher = SelfMatcher(mesh, resolution.tolerance_m)
        probes = self._matcher.probes
        self._centre, self._axes = probes.centre, probes.axes
        self._seen = np.vstack([probes.points, probes.corners])
        self._moments = np.linalg.eigvalsh(probes.second_moments)

    def found(self) -> Symmetry:
        """The symmetry."""
        # Moments that differ are exchanged by no symmetry.
        low, middle, high = (
            a > (1.0 - _UNLIKE_MOMENTS) * b
            for a, b in (
                (self._moments[0], self._moments[1]),
                (self._moments[1], self._moments[2]),
                (self._moments[0], self._moments[2]),
            )
        )
        if low and middle and high and (ball := self._ball()) is not None:
            return Symmetry(np.eye(4)[None], ball)
        axes = [
            axis for axis, alike in ((self._axes[:, 2], low), (self._axes[:, 0], middle)) if alike
        ]
        for axis in axes:
            if (roundness := self._round_about(axis)) is not None:
                return Symmetry(self._with_flip(roundness), roundness)
        if not axes:
            half_turns = np.stack([exp_rotation(np.pi * axis) for axis in self._axes.T])
            starts = list(turns_about_point(self._centre, half_turns))
            matches = self._matcher.near(starts, _MAX_SHARE)
        else:
            matches = self._matcher.all_over(_MAX_SHARE)
        motions = [match.T_model for match in matches]
        if low and middle and high:
            for axis in _likely_round_axes(motions):
                if (roundness := self._round_about(axis)) is not None:
                    return Symmetry(self._with_flip(roundness), roundness)
        motions = [self._sharpened(T) for T in motions if self._moves_nothing_far(T)]
        return Symmetry(self._group(motions))

    def _leaves_no_trace(self, T: FloatArray) -> bool:
        return self._moves_nothing_far(T) and self._matcher.differing_share(T) <= _MAX_SHARE

    def _moves_nothing_far(self, T: FloatArray) -> bool:
        """Whether a motion and its inverse leave all that is seen within a few pixels of it."""
        speck_m = _SPECK_PIXELS * self._resolution.pixel_m
        return not any(
            self._matcher.samples.is_off(transform_points(motion, self._seen), speck_m).any()
            for motion in (T, invert_transform(T))
        )

    # Round bodies.

    def _round_about(self, axis: FloatArray) -> Roundness | None:
        """Roundness about an axis near a direction (3,), through a point near the middle."""
        T = np.eye(4)
        # Angles that no polygon is turned by: they tell at once what is not round.
        for angle in (0.47 * np.pi, 0.29 * np.pi):
            start = turns_about_point(self._centre, exp_rotation(angle * axis))
            fitted = self._matcher.fitted_to_all(start, _ROUGHLY_ROUND_SHARE)
            if fitted is None:
                return None
            T, vector = fitted, log_rotation(fitted[:3, :3])
            turned = float(np.linalg.norm(vector))
            if turned < 0.5 * angle or abs(vector @ axis) < 0.9 * turned:
                return None
            axis = vector / turned * np.sign(vector @ axis)
        # (I - R) p = t holds for all points of the axis: that nearest to the middle.
        A = np.vstack([np.eye(3) - T[:3, :3], axis])
        b = np.append(T[:3, 3], axis @ self._centre)
        roundness = Roundness(np.asarray(np.linalg.lstsq(A, b, rcond=None)[0]), axis[None])
        turns = roundness.turns(np.outer(_GOLDEN_RAD * np.arange(1, _SCANNED), axis))
        return self._if_round(roundness, turns)

    def _ball(self) -> Roundness | None:
        # |p|^2 = 2 c . p + const on a sphere about c.
        points = self._matcher.probes.points - self._centre
        A = np.column_stack([2.0 * points, np.ones(len(points))])
        offset = np.linalg.lstsq(A, np.sum(points**2, axis=1), rcond=None)[0][:3]
        ball = Roundness(self._centre + offset, np.eye(3))
        vectors = np.random.default_rng(0).normal(size=(_SCANNED, 3))
        return self._if_round(ball, ball.turns(vectors))

    def _if_round(self, roundness: Roundness, turns: FloatArray) -> Roundness | None:
        """The roundness with how far it holds, if no turn leaves a trace."""
        largest_m = 0.0
        for turn in turns:
            off_m = self._off_by(turn)
            if off_m is None:
                return None
            largest_m = max(largest_m, off_m)
        return replace(roundness, deviation_m=largest_m)

    def _off_by(self, turn: FloatArray) -> float | None:
        """How far a turn moves the surface off itself, in root mean square; None where that is more
        than the noise hides."""
        resolution, probes = self._resolution, self._matcher.probes
        moved = transform_points(turn, self._seen)
        off = self._matcher.samples.distance(moved)
        surface = off[: len(probes.points)]
        far = float(np.mean(surface > 2.0 * resolution.tolerance_m))
        rms = float(np.sqrt(np.mean(surface**2)))
        largest = float(off.max())
        hidden = (
            far <= _MAX_SHARE
            and rms <= _ROUND_NOISE * resolution.noise_m
            and largest < _SPECK_PIXELS * resolution.pixel_m
        )
        return rms if hidden else None

    def _with_flip(self, roundness: Roundness) -> FloatArray:
        """(1 or 2, 4, 4) the identity and, where it is a symmetry, a half turn across the axis."""
        across = np.cross(
            roundness.axes_model[0], np.eye(3)[np.argmin(np.abs(roundness.axes_model[0]))]
        )
        R = exp_rotation(np.pi * across / np.linalg.norm(across))
        T = self._matcher.fitted_to_all(turns_about_point(self._centre, R), _ROUGHLY_ROUND_SHARE)
        flips = [] if T is None or not self._leaves_no_trace(T) else [self._sharpened(T)]
        return np.stack([np.eye(4), *flips])

    # Groups.

    def _sharpened(self, T: FloatArray) -> FloatArray:
        """(4, 4) a symmetry by the corners of the mesh that it takes to corners, where most are."""
        every = max(1, len(self._vertices) // _MATCHED_VERTICES)
        moved = self._vertices[::every]
        tree = cKDTree(self._vertices)
        for reach_m in (self._resolution.tolerance_m, 0.1 * self._resolution.tolerance_m):
            apart, partner = tree.query(transform_points(T, moved), distance_upper_bound=reach_m)
            paired = np.asarray(np.isfinite(apart))
            if np.mean(paired) < _VERTEX_SHARE or np.count_nonzero(paired) < 4:
                return T
            T = _best_motion(moved[paired], self._vertices[np.asarray(partner)[paired]])
        return T

    def _group(self, motions: list[FloatArray]) -> FloatArray:
        """(n, 4, 4) the group that symmetries generate, sorted by angle."""
        found = [np.eye(4)]
        for T in motions:
            if not self._is_among(T, found):
                found.append(T)
        grown = 0
        while grown < len(found) < _MAX_ORDER:
            # Products with each of the first ones reach every element.
            first = found[grown]
            for other in found[1 : 1 + len(motions)]:
                product = first @ other
                if not self._is_among(product, found) and self._leaves_no_trace(product):
                    found.append(product)
            grown += 1
        return self._closed(np.stack(found))

    def _is_among(self, T: FloatArray, others: list[FloatArray]) -> bool:
        return bool(self._members(T[None], np.stack(others))[0])

    def _closed(self, found: FloatArray) -> FloatArray:
        """The largest set of motions that composition does not leave, sorted by angle.

        Only a motion that fits barely within the tolerance can break closure; it is then dropped.
        """
        motions = found
        while True:
            products = motions[:, None] @ motions[None, :]
            member = self._members(products.reshape(-1, 4, 4), motions)
            strays = (~member.reshape(len(motions), -1)).sum(axis=1)
            if not strays.any():
                break
            motions = np.delete(motions, int(np.argmax(strays)), axis=0)
        angles = np.round(rotation_angle(motions[:, :3, :3]), 4)
        axes = np.round(log_rotation(motions[:, :3, :3]), 4)
        order = np.lexsort((axes[:, 0], axes[:, 1], -axes[:, 2], angles))
        return np.asarray(motions[order])

    def _members(self, products: FloatArray, motions: FloatArray) -> BoolArray:
        """(n,) whether each product is one of the motions, within twice their own tolerance."""
        trace = np.einsum("nij,mij->nm", products[:, :3, :3], motions[:, :3, :3])
        angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        # About the middle of the target the translations of equal motions agree best.
        placed, known = (transform_points(T, self._centre[None])[:, 0] for T in (products, motions))
        shift = np.linalg.norm(placed[:, None] - known[None], axis=-1)
        near = (angle < 2.0 * _SAME_ANGLE_RAD) & (shift < 4.0 * self._resolution.tolerance_m)
        return np.asarray(near.any(axis=1))


def _likely_round_axes(motions: list[FloatArray]) -> list[FloatArray]:
    """Axes (3,) that a body may be round about of which turns by any angle and half turns across
    are among its motions (4, 4 each)."""
    if not motions:
        return []
    vectors = log_rotation(np.stack(motions)[:, :3, :3])
    angles = np.linalg.norm(vectors, axis=1)
    axes = vectors / angles[:, None]
    turns, halves = axes[angles < _HALF_TURN_RAD], axes[angles >= _HALF_TURN_RAD]
    across = [np.cross(halves[0], other) for other in halves[1:3]]
    long_enough = [axis / np.linalg.norm(axis) for axis in across if np.linalg.norm(axis) > 0.1]
    return [*turns[:2], *long_enough]


def _best_motion(points: FloatArray, partners: FloatArray) -> FloatArray:
    """(4, 4) that takes points (n, 3) nearest to their partners (Kabsch)."""
    a, b = points.mean(axis=0), partners.mean(axis=0)
    R = nearest_rotation((partners - b).T @ (points - a))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, b - R @ a
    return T


def symmetry_name(motions: FloatArray, roundness: Roundness | None) -> str:
    """Name of a symmetry: `group_name`, or how it is round."""
    if roundness is None:
        return group_name(motions)
    if roundness.is_ball:
        return "ball: round about all axes"
    either = ", alike from both ends" if len(motions) > 1 else ""
    return f"round about {_axis_name(roundness.axes_model[0])}{either}"


def group_name(motions: FloatArray) -> str:
    """Schoenflies name of a group of motions (n, 4, 4), with its axis where it has a main one.

    "C1", "C2 about z", "D2", "D4 about z", "T", "O" or "I"; an axis off the model's is given by
    its direction.
    """
    count = len(motions)
    if count == 1:
        return "C1"
    vectors = log_rotation(motions[1:, :3, :3])
    angles = np.linalg.norm(vectors, axis=1)
    smallest = int(np.argmin(angles))
    order = round(2.0 * np.pi / float(angles[smallest]))
    axis = _axis_name(vectors[smallest] / angles[smallest])
    if count == order:
        return f"C{order} about {axis}"
    if count == 2 * order:
        return "D2" if order == 2 else f"D{order} about {axis}"
    return {12: "T", 24: "O", 60: "I"}.get(count, f"a group of {count}")


def half_turns(mesh: trimesh.Trimesh) -> FloatArray:
    """(3, 4, 4) half turns about the principal axes of a mesh's surface, model frame."""
    corners, area = np.asarray(mesh.triangles), np.asarray(mesh.area_faces)
    middles = corners.mean(axis=1)
    weight = area / area.sum()
    centre = weight @ middles
    # The second moment of a triangle is that of its corners and, ninefold, of its middle, over 12.
    corners, middles = corners - centre, middles - centre
    second = np.einsum("n,nki,nkj->ij", weight, corners, corners)
    second = (second + 9.0 * np.einsum("n,ni,nj->ij", weight, middles, middles)) / 12.0
    axes = np.linalg.eigh(second)[1]
    turns = []
    for axis in axes.T:
        R = 2.0 * np.outer(axis, axis) - np.eye(3)
        turns.append(make_transform(R, centre - R @ centre))
    return np.stack(turns)


def _axis_name(axis: FloatArray) -> str:
    aligned = np.abs(axis) > np.cos(_SAME_ANGLE_RAD)
    if aligned.any():
        return "xyz"[int(np.argmax(aligned))]
    axis = axis * np.sign(axis[int(np.argmax(np.abs(np.round(axis, 6))))])
    return "({:.3f}, {:.3f}, {:.3f})".format(*(axis + 0.0))
