"""Absolute and relative trajectory errors (ATE, RPE) of an estimated trajectory.

As Sturm et al. 2012 define them ("A Benchmark for the Evaluation of RGB-D SLAM Systems", section
IV) and as evo computes them. A pose is ``T_ref_body``: of any body in any frame, the same two in
both trajectories. Poses are already matched in time, row by row, and finite.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import invert_transform, make_transform, rotation_angle

_LINE = 1e-12
"""Second over first singular value of points that lie on a line to working accuracy."""


@dataclass(frozen=True)
class Alignment:
    """The similarity ``p -> scale R p + t`` that brings one set of points nearest to another."""

    R: FloatArray
    """(3, 3), proper."""
    t: FloatArray
    """(3,) m"""
    scale: float

    def apply(self, T: FloatArray) -> FloatArray:
        """Poses (n, 4, 4) moved along: scaled about the origin, then turned and shifted."""
        scaled = T.copy()
        scaled[..., :3, 3] *= self.scale
        return np.asarray(make_transform(self.R, self.t) @ scaled)


@dataclass(frozen=True)
class RelativeErrors:
    """Errors of the motion from one pose to another, pair by pair."""

    translation_m: FloatArray
    """(k,)"""
    rotation_rad: FloatArray
    """(k,) in [0, pi]"""


def umeyama_alignment(
    points: FloatArray, reference: FloatArray, with_scale: bool = False
) -> Alignment | None:
    """The least-squares alignment of points (n, 3) to reference points (n, 3).

    Umeyama 1991, equations (34) to (43). None where the points do not tell a rotation: fewer than
    three of them, or all on one line.
    """
    if len(points) == 0:
        return None
    mean, reference_mean = points.mean(axis=0), reference.mean(axis=0)
    centred, reference_centred = points - mean, reference - reference_mean
    cross = reference_centred.T @ centred / len(points)
    u, d, vt = np.linalg.svd(cross)
    # On a line only the first singular value is more than rounding.
    if d[1] <= _LINE * d[0]:
        return None
    # (43): the last axis is mirrored where the best orthogonal matrix is a reflection.
    sign = np.ones(3)
    sign[2] = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    R = (u * sign) @ vt
    variance = np.sum(centred**2) / len(points)
    scale = float(d @ sign / variance) if with_scale else 1.0
    return Alignment(R, reference_mean - scale * (R @ mean), scale)


def absolute_errors(T_true: FloatArray, T_estimated: FloatArray) -> FloatArray:
    """(n,) distances between the positions of true and estimated poses (n, 4, 4), m: the ATE.

    Nothing is aligned here: poses in one frame need no alignment, and see `aligned` for others.
    """
    _refuse_unmatched(T_true, T_estimated)
    return np.asarray(np.linalg.norm(T_estimated[:, :3, 3] - T_true[:, :3, 3], axis=1))


def aligned(
    T_true: FloatArray, T_estimated: FloatArray, with_scale: bool = False
) -> FloatArray | None:
    """Estimated poses (n, 4, 4) moved as a whole so that their positions fit the true ones best.

    Which is what odometry needs that starts in a frame of its own. None where the positions do not
    tell how to turn the trajectory, see `umeyama_alignment`.
    """
    _refuse_unmatched(T_true, T_estimated)
    alignment = umeyama_alignment(T_estimated[:, :3, 3], T_true[:, :3, 3], with_scale)
    return None if alignment is None else alignment.apply(T_estimated)


def relative_errors(
    T_true: FloatArray, T_estimated: FloatArray, step: int = 1, all_pairs: bool = True
) -> RelativeErrors:
    """Errors of the motion over ``step`` poses: the RPE.

    Of all pairs (i, i + step), or of those that follow each other end to end. The error is
    ``E = (T_true_i^-1 T_true_j)^-1 (T_i^-1 T_j)`` (Sturm 2012 (5)); it does not change when a
    trajectory is moved as a whole.
    """
    _refuse_unmatched(T_true, T_estimated)
    if step < 1:
        raise ValueError(f"step: expected at least 1, got {step}")
    first: IntArray = np.arange(0, len(T_true) - step, 1 if all_pairs else step)
    E = invert_transform(_motion(T_true, first, step)) @ _motion(T_estimated, first, step)
    translation = np.asarray(np.linalg.norm(E[:, :3, 3], axis=1))
    return RelativeErrors(translation, rotation_angle(E[:, :3, :3]))


def root_mean_square(errors: FloatArray) -> float:
    """Of errors (n,); nan without any."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else np.nan


def _motion(T: FloatArray, first: IntArray, step: int) -> FloatArray:
    return np.asarray(invert_transform(T[first]) @ T[first + step])


def _refuse_unmatched(T_true: FloatArray, T_estimated: FloatArray) -> None:
    if T_true.shape != T_estimated.shape or T_true.shape[1:] != (4, 4):
        shapes = f"{T_true.shape} and {T_estimated.shape}"
        raise ValueError(f"poses: expected two arrays (n, 4, 4) matched in time, got {shapes}")
