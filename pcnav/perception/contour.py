"""Where the outline of a target lies in an image, compared with where a pose predicts it.

The occluding edges of the mesh are projected (`edge_crossings`), and pixels on the wrong side of
them are counted (`edge_counts`). Over a straight edge these counts have a mean and a tilt, two
measurements whose errors come from the pixel grid alone (`grid_variances`) and follow in closed
form from how uncertain the prediction is.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray, picked
from pcnav.perception.calibration_fields import by_fields
from pcnav.perception.edge_conflicts import KnownError, conflicts_px, in_doubt
from pcnav.perception.edge_counts import EdgeCounts, count_offsets, edge_counts
from pcnav.perception.edge_crossings import EdgeCrossings, edge_crossings
from pcnav.perception.edge_stretches import Stretches, goes_on
from pcnav.perception.grid_variances import bent_grid_variances, grid_variances
from pcnav.perception.mesh_edges import MeshEdges
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.rendering import RenderedDepth

_SHARP_PX = 0.3
"""Predictions better than this need one pixel on each side of an edge."""
_MAX_REACH_PX = 4
_SATURATED = 0.6
"""Beyond this share of the pixels looked at on each side, a count is only a bound."""
_RUN_GATE_SIGMA = 4.0
"""An edge displaced by more standard deviations than this is not the one of the mesh."""
_EDGE_SD_PX = 0.01
"""How well mesh and lens are known at best, along an edge."""
_ONE_PIXEL_SIGMA = 2.5
"""A single displaced pixel may be at most so many standard deviations: its law has a long tail that
a variance alone does not tell, and the gates go by variances."""
_MAX_SIGNS = 65_536
"""Edges of larger meshes draw their signs in turn from so many."""
_MEAN_ABS_NORMAL = float(np.sqrt(2.0 / np.pi))
"""Mean absolute value of a standard normal variable."""


@dataclass(frozen=True)
class ContourRuns:
    """Unbroken stretches of edges, each with its displacement and tilt. Pixels.

    Measured minus predicted, positive where the near part covers more than predicted.
    """

    value: FloatArray
    """(n,)"""
    variance: FloatArray
    """(n,)"""
    jacobian: FloatArray
    """(n, 6) by the pose: translation of the model origin (m, camera axes), rotation (rad, model
    axes)."""
    triangle: IntArray
    """(n,) of the mesh, seen beside the edge."""
    shared: FloatArray
    """(n, 4) by the offsets of the outline, see `SensorNoise.outline_offset_px`."""
    by_fields: FloatArray
    """(n, 6) by errors of the calibration, see `pcnav.perception.calibration_fields`."""
    own_variance: FloatArray
    """(n,) without the scatter of the outline, see `SensorNoise.outline_sd_px`,"""
    by_scatter: FloatArray
    """(n,) and what a scatter of one pixel adds."""
    by_twist: FloatArray
    """(n, 6) by how the target moves while the frame is taken, rates of the pose; (n, 0) where its
    pixels are exposed at once."""

    def __len__(self) -> int:
        return len(self.value)

    def by_pose_and_shared(self, noise: SensorNoise) -> FloatArray:
        """(n, 6 + k) derivatives by the pose and by the errors that a frame shares, each of one
        deviation; an offset of the ranges moves no outline."""
        if not noise.has_shared_errors:
            return self.jacobian
        shared = self.shared * noise.outline_offset_sd_px
        return np.hstack([self.jacobian, np.zeros((len(self), 1)), shared])


def contour_runs(
    edges: MeshEdges,
    depth_m: DepthImage,
    rendered: RenderedDepth,
    doubt: PoseDoubt,
    dropout: float,
    noise: SensorNoise,
    unknown: BoolArray | None = None,
    known: KnownError | None = None,
) -> ContourRuns:
    """The outline of a frame against the view rendered at a pose.

    Args:
        edges: of the mesh.
        depth_m: (height, width) the frame.
        rendered: the view from the pose.
        doubt: about the pose.
        dropout: share of the returns that are lost at random.
        noise: of the sensor: where it sees an outline.
        unknown: (height, width) pixels that say nothing of the outline, see `OutlineFrame`.
        known: what else says where the target is; the doubt alone by default.
    """
    crossings = edge_crossings(edges, rendered, doubt.T_cam_model)
    signs = count_offsets(min(len(edges), _MAX_SIGNS), doubt.T_cam_model)
    shift_px = signs[crossings.edge % max(len(signs), 1)]
    shift_px = shift_px + crossings.by_offsets(0) @ noise.outline_offset_px
    jacobian = crossings.displacement_jacobian(rendered.camera, doubt)
    variance_px = doubt.variance(jacobian)
    doubt_px = float(np.sqrt(variance_px.max())) if len(variance_px) else 0.0
    reach = contour_reach(doubt_px)
    counted = edge_counts(
        *(crossings, shift_px, depth_m, rendered, reach, doubt, dropout, edges.diameter_m),
        among_others=unknown is not None and bool(unknown.any()),
    )
    if unknown is not None:
        counted = replace(counted, usable=counted.usable & ~crossings.any_beside(unknown, reach))
    kept = _between_others(crossings, counted)
    counted = replace(picked(counted, kept), shift_px=shift_px[kept])
    if known is None:
        known = KnownError(np.zeros(6), doubt.covariance)
    crossings, jacobian = picked(crossings, kept), jacobian[kept]
    by_twist = _by_twist(crossings, jacobian, rendered)
    return _runs(crossings, counted, (jacobian, by_twist), doubt, reach, noise, known)


def _by_twist(
    crossings: EdgeCrossings, jacobian: FloatArray, rendered: RenderedDepth
) -> FloatArray:
    """(n, 6) of displacements with derivatives (n, 6) by the pose: a pixel exposed a time t after
    that of the frame sees t times as much of a rate as of a shift. (n, 0) where all are at once."""
    exposure = None if rendered.moving is None else rendered.moving.exposure
    if exposure is None or exposure.times_s is None:
        return np.empty((len(jacobian), 0))
    u, v = crossings.across(np.rint(crossings.minor).astype(np.intp)[:, None])
    height, width = exposure.index.shape
    at = np.clip(v[:, 0], 0, height - 1), np.clip(u[:, 0], 0, width - 1)
    return np.asarray(exposure.times_s[exposure.index[at]][:, None] * jacobian)


def contour_reach(doubt_px: float) -> int:
    """How many pixels on each side of an edge are counted, where it may be so far off, pixels."""
    return 1 if doubt_px < _SHARP_PX else min(int(np.ceil(2.0 * doubt_px)) + 1, _MAX_REACH_PX)


def _between_others(crossings: EdgeCrossings, counted: EdgeCounts) -> BoolArray:
    """(n,) usable crossings whose neighbours along the edge are usable, too.

    At the last crossing before a corner, or before something hides the edge, the pixels beside it
    may be cut by the other edge as well.
    """
    joined = np.zeros(len(crossings.edge) + 1, dtype=np.bool_)
    joined[1:-1] = goes_on(crossings, counted.kind)
    joined[1:-1] &= counted.usable[1:] & counted.usable[:-1]
    return np.asarray(joined[1:] & joined[:-1])


def _runs(
    crossings: EdgeCrossings,
    counted: EdgeCounts,
    derivatives: tuple[FloatArray, FloatArray],
    doubt: PoseDoubt,
    reach: int,
    noise: SensorNoise,
    known: KnownError,
) -> ContourRuns:
    jacobian, by_twist = derivatives
    if len(crossings.edge) == 0:
        empty = np.empty(0)
        none = np.empty(0, dtype=np.intp)
        shared = np.empty((0, 4))
        by_six = np.empty((0, 6))
        return ContourRuns(empty, empty, by_six, none, shared, by_six, empty, empty, by_six)
    stretches = Stretches.of(crossings, counted.kind)
    starts, n = stretches.starts, stretches.n
    by_offsets = crossings.by_offsets(counted.kind)
    expected = by_offsets @ noise.outline_offset_px
    offset_px2 = ((by_offsets[starts] * noise.outline_offset_sd_px) ** 2).sum(axis=1)
    doubt_px2 = stretches.total(doubt.variance(jacobian)) / n + offset_px2
    variances = _variances(crossings, counted, stretches, expected, doubt_px2, noise)
    # As far as one looked, or farther: no better known than before, unless it was followed.
    looked = (counted.displacement_px - counted.shift_px) * stretches.weights[0]
    gap = stretches.total(counted.gap_px * stretches.weights[0])
    reached = (np.abs(stretches.total(looked)) > _SATURATED * reach) & (gap == 0.0)
    variances[0] += np.where(reached, doubt_px2, 0.0)
    fields = by_fields(jacobian, crossings.p_cam, doubt.T_cam_model)
    all_derivatives = jacobian, by_offsets, fields, by_twist
    means, tilts = (
        _of(stretches, weight, counted.displacement_px - expected, all_derivatives)
        for weight in stretches.weights
    )
    by_scatter = [n * stretches.total(weight**2) for weight in stretches.weights]
    scattered = variances[0] + noise.outline_sd_px**2 * by_scatter[0]
    apart = conflicts_px(means.value, scattered, means.jacobian, known)
    # What ends far inside is displaced by as much, or cut.
    half, conflict = in_doubt(np.where(apart == 0.0, -gap, apart))
    means = means._replace(value=means.value - half)
    common = np.maximum(stretches.largest(counted.common_px2), conflict)
    variances[0] += common
    variances[1] += common * n / np.maximum(stretches.spread, 0.5)
    rows = []
    for power, (value, H, shared, fields, twist) in enumerate((means, tilts)):
        own, scatter = variances[power], by_scatter[power]
        variance = own + noise.outline_sd_px**2 * scatter
        innovation = doubt.variance(H) + variance
        innovation += ((shared * noise.outline_offset_sd_px) ** 2).sum(axis=1)
        kept = np.abs(value) < _RUN_GATE_SIGMA * np.sqrt(innovation)
        kept &= n > power
        picked_rows = (value, variance, H, counted.triangle[starts], shared, fields)
        rows.append(tuple(part[kept] for part in (*picked_rows, own, scatter, twist)))
    return ContourRuns(*(np.concatenate(part) for part in zip(*rows, strict=True)))


class _Measured(NamedTuple):
    value: FloatArray
    jacobian: FloatArray
    shared: FloatArray
    by_fields: FloatArray
    by_twist: FloatArray


def _of(
    stretches: Stretches,
    weight: FloatArray,
    displacement_px: FloatArray,
    derivatives: tuple[FloatArray, ...],
) -> _Measured:
    """The means, or tilts, of stretches, and of derivatives by the pose, by the offsets of the
    outline, by errors of the calibration, and by the twist."""
    parts = (displacement_px * weight, *(of * weight[:, None] for of in derivatives))
    return _Measured(*(stretches.total(part) for part in parts))


def _variances(
    crossings: EdgeCrossings,
    counted: EdgeCounts,
    stretches: Stretches,
    expected_px: FloatArray,
    doubt_px2: FloatArray,
    noise: SensorNoise,
) -> list[FloatArray]:
    """(k,) each, of the mean and of the tilt of what was counted over stretches, by the pixel
    grid."""
    starts, n = stretches.starts, stretches.n
    # Where a line as far from the edge as these would be, pixels were counted.
    apart = np.abs(np.abs(expected_px - counted.shift_px)[starts])
    displaced = np.hypot(apart, _MEAN_ABS_NORMAL * np.sqrt(doubt_px2))
    if crossings.is_bent:
        grid = bent_grid_variances(crossings.minor, stretches.weights, starts, displaced)
    else:
        grid = grid_variances(n, crossings.slope[starts], displaced)
    extra = counted.extra_variance[starts] * np.where(counted.kind[starts] == 0, 1.0, displaced)
    edge_px2 = stretches.ragged_px2(counted.displacement_px - expected_px, extra)
    edge_px2 += _EDGE_SD_PX**2
    variances = []
    for of_grid, weight in zip(grid, stretches.weights, strict=True):
        weight_2 = stretches.total(weight**2)
        variance = of_grid + extra * weight_2 + edge_px2 * n * weight_2
        # Displaced pixels are few and whole: one is no outlier.
        one = stretches.largest(np.abs(weight))
        variances.append(np.maximum(variance, (one / _ONE_PIXEL_SIGMA) ** 2))
    return variances
