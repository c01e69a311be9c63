"""From the frames of an arc to the rigid set of points behind them, and its pose at every frame.

The axes of the map are those of the world at the frame the map begins with. Nothing is assumed of
the motion: the poses are fitted frame by frame. Wrong matches are kept out by consensus: a point
enters the map when two frames agree on it, and an observation counts when it agrees with the map.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.stereo import StereoRig
from pcnav.estimators.features.photogrammetric_frame import Alignment, align, best_triple, consensus
from pcnav.filtering.error_state import innovation_gate
from pcnav.recordings.tracks import TrackFrame

_PROBABILITY = 0.999
_MIN_POINTS = 3
_PARTNERS = 5
"""Frames after one that are tried as its partner."""
_REFINEMENTS = 2


@dataclass(frozen=True)
class TriangulatedFrame:
    """The points triangulated from one frame."""

    time_s: float
    features: IntArray
    """(n,)"""
    p_world: FloatArray
    """(n, 3) from the chaser, m."""
    noise: FloatArray
    """(n, 3, 3) m^2, world axes."""


@dataclass(frozen=True)
class MapPose:
    """A frame of the arc and the pose of the map in it."""

    frame: int
    """Its place in the arc."""
    R_world_map: FloatArray
    """(3, 3)"""
    t_world: FloatArray
    """(3,) origin of the map, m."""
    covariance: FloatArray
    """(6, 6) of the rotation error (world axes, rad) and of t (m), the map taken as exact."""
    agrees: BoolArray
    """(n,) per feature of the frame, whether it agrees with the map."""


@dataclass(frozen=True)
class FeatureMap:
    """Points that move as one body, and its poses."""

    points: dict[int, FloatArray]
    """(3,) by feature, map axes, m."""
    noise: dict[int, FloatArray]
    """(3, 3) m^2."""
    poses: tuple[MapPose, ...]
    """In order of time, of the frames that show enough of the map."""


def triangulated(frame: TrackFrame, rig: StereoRig) -> TriangulatedFrame:
    """Triangulate a frame; features whose disparity is not positive are left out."""
    kept = rig.disparity(frame.pixels) > 0.0
    p_rig, noise = rig.triangulate(frame.pixels[kept])
    R = frame.R_cam_world
    return TriangulatedFrame(frame.time_s, frame.features[kept], p_rig @ R, R.T @ noise @ R)


def build_map(frames: Sequence[TriangulatedFrame], rng: np.random.Generator) -> FeatureMap | None:
    """The map of an arc; None when no two frames agree on three points of a body."""
    for k in range(len(frames)):
        initial = _initial(frames, k, rng)
        if initial is not None:
            break
    else:
        return None
    candidates: dict[int, tuple[FloatArray, FloatArray]] = {}
    poses: list[MapPose] = []
    for k, seen in enumerate(frames):
        posed = pose_in_map(seen, k, *initial, rng)
        if posed is not None:
            poses.append(posed)
            _extend(initial, candidates, seen, posed)
    found = FeatureMap(*initial, tuple(poses))
    for _ in range(_REFINEMENTS):
        found = _refined(found, frames)
    return found


_Points = tuple[dict[int, FloatArray], dict[int, FloatArray]]


def _initial(
    frames: Sequence[TriangulatedFrame], k: int, rng: np.random.Generator
) -> _Points | None:
    """Points of a frame that a following frame confirms, from their mean."""
    first = frames[k]
    for other in frames[k + 1 : k + 1 + _PARTNERS]:
        shared, a, b = np.intersect1d(first.features, other.features, return_indices=True)
        rigid = moves_rigidly(
            other.p_world[b], first.p_world[a], other.noise[b], first.noise[a], rng
        ).pairs
        if rigid.sum() >= _MIN_POINTS:
            rows = a[rigid]
            centre = first.p_world[rows].mean(axis=0)
            names = shared[rigid].tolist()
            points = dict(zip(names, first.p_world[rows] - centre, strict=True))
            return points, dict(zip(names, first.noise[rows], strict=True))
    return None


@dataclass(frozen=True)
class RigidMotion:
    """Pairs of points that move as one body, and how."""

    pairs: BoolArray
    """(n,) none without agreement."""
    fit: Alignment | None
    """To those pairs."""


def moves_rigidly(
    p_a: FloatArray,
    p_b: FloatArray,
    noise_a: FloatArray,
    noise_b: FloatArray,
    rng: np.random.Generator,
) -> RigidMotion:
    """Which pairs of points (n, 3) move as one body from b to a.

    Three pairs cannot outvote one another: they agree all or not at all.
    """
    none = np.zeros(len(p_a), dtype=np.bool_)
    if not (_is_frame(p_a) and _is_frame(p_b)):
        return RigidMotion(none, None)
    fit = align(p_a, p_b, noise_a, noise_b)
    if float(fit.chi_square) < innovation_gate(_PROBABILITY, 3 * len(p_a) - 6):
        return RigidMotion(~none, fit)
    pairs = consensus(p_a, p_b, noise_a, noise_b, rng, _PROBABILITY)
    if not pairs.any():
        return RigidMotion(none, None)
    return RigidMotion(pairs, align(p_a[pairs], p_b[pairs], noise_a[pairs], noise_b[pairs]))


def _is_frame(points: FloatArray) -> bool:
    try:
        best_triple(points)
    except ValueError:
        return False
    return True


def pose_in_map(
    seen: TriangulatedFrame,
    place: int,
    points: dict[int, FloatArray],
    noise: dict[int, FloatArray],
    rng: np.random.Generator,
) -> MapPose | None:
    """Where the map is in a frame, by the points that agree; None where too few do."""
    known = np.array([feature in points for feature in seen.features.tolist()], dtype=np.bool_)
    if known.sum() < _MIN_POINTS:
        return None
    names = seen.features[known].tolist()
    p_map = np.stack([points[name] for name in names])
    noise_map = np.stack([noise[name] for name in names])
    p, own = seen.p_world[known], seen.noise[known]
    motion = moves_rigidly(p, p_map, own, noise_map, rng)
    if motion.fit is None:
        return None
    agrees = np.zeros(len(seen.features), dtype=np.bool_)
    agrees[np.flatnonzero(known)[motion.pairs]] = True
    fit = motion.fit
    return MapPose(place, fit.R_a_b, fit.t_a, fit.covariance, agrees)


def _extend(
    initial: _Points,
    candidates: dict[int, tuple[FloatArray, FloatArray]],
    seen: TriangulatedFrame,
    posed: MapPose,
) -> None:
    """Add the features that a second frame confirms to the map under construction."""
    points, noise = initial
    R = posed.R_world_map
    for k, name in enumerate(seen.features.tolist()):
        if name in points:
            continue
        p, own = R.T @ (seen.p_world[k] - posed.t_world), R.T @ seen.noise[k] @ R
        if name in candidates:
            before, earlier = candidates[name]
            apart = p - before
            if apart @ np.linalg.solve(own + earlier, apart) < innovation_gate(_PROBABILITY, 3):
                points[name], noise[name] = before, earlier
        candidates[name] = p, own


def _refined(found: FeatureMap, frames: Sequence[TriangulatedFrame]) -> FeatureMap:
    """Points averaged over all frames that agree, then the poses fitted to them again.

    Views from all sides know together what each lacks along its line of sight. The points' noise
    is left out of the second fit: it is common to all poses.
    """
    information = {name: np.zeros((3, 3)) for name in found.points}
    weighted = {name: np.zeros(3) for name in found.points}
    for posed in found.poses:
        seen, R = frames[posed.frame], posed.R_world_map
        weights = np.linalg.inv(R.T @ seen.noise[posed.agrees] @ R)
        back = (seen.p_world[posed.agrees] - posed.t_world) @ R
        for name, weight, p in zip(
            seen.features[posed.agrees].tolist(), weights, back, strict=True
        ):
            information[name] += weight
            weighted[name] += weight @ p
    shown = [name for name, weight in information.items() if weight.any()]
    points = {
        name: np.asarray(np.linalg.solve(information[name], weighted[name]), np.float64)
        for name in shown
    }
    noise = {name: np.asarray(np.linalg.inv(information[name]), np.float64) for name in shown}
    return FeatureMap(points, noise, _fitted(found.poses, frames, points))


def _fitted(
    poses: Sequence[MapPose],
    frames: Sequence[TriangulatedFrame],
    points: dict[int, FloatArray],
) -> tuple[MapPose, ...]:
    """Poses fitted to the points, those of as many features at once."""
    groups: dict[int, list[tuple[MapPose, BoolArray]]] = {}
    for posed in poses:
        names = frames[posed.frame].features.tolist()
        kept = posed.agrees & np.array([name in points for name in names])
        if kept.sum() >= _MIN_POINTS:
            groups.setdefault(int(kept.sum()), []).append((posed, kept))
    fitted = []
    for group in groups.values():
        seen = [(frames[posed.frame], kept) for posed, kept in group]
        p_map = [[points[name] for name in s.features[kept].tolist()] for s, kept in seen]
        p_world = np.stack([s.p_world[kept] for s, kept in seen])
        noise = np.stack([s.noise[kept] for s, kept in seen])
        fit = align(p_world, np.array(p_map), noise)
        fitted += [
            MapPose(posed.frame, fit.R_a_b[k], fit.t_a[k], fit.covariance[k], kept)
            for k, (posed, kept) in enumerate(group)
        ]
    return tuple(sorted(fitted, key=lambda posed: posed.frame))
