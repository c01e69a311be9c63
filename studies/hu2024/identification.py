"""Fig. 5: the attitude of the principal axes as it is identified, many runs at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from pcnav.batch.monte_carlo import RunBatch
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import R_cam_hill
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.blocks import ATTITUDE, POSITION
from pcnav.dynamics.inertia_parameters import inertia_of, parameters_of
from pcnav.dynamics.state import NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.attitude_inertia.rotation_fit import fit_rotation_arc, positive
from pcnav.estimators.attitude_inertia.rotation_model import SIZE
from pcnav.estimators.features.photogrammetric_frame import align, best_triple, photogrammetric_axes
from pcnav.estimators.principal_axes.inertia_identification import (
    angular_rate,
    momentum_rows,
    solve_normal,
)
from pcnav.estimators.principal_axes.principal_frame import clearest_order, principal_axes
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.simulation.stereo import draw_points, simulate_motion

from ..folder import StudyFigure
from ..tables import table
from . import paper

REPORT_S = (2.0, 3.0, 5.0, 7.5, 10.0, 15.0, 20.0, 30.0)
"""Lengths of the arcs; the last ends where the first blackout begins."""
_MAX_ATTITUDES = 60
_MAX_STEPS = 8
"""Of a fit, which starts from that of the arc before."""
_BAD_FIT = 1.5


class Method(StrEnum):
    """How the axes are identified."""

    PRINTED = "three points, plain least squares"
    """(6)-(17) as printed."""
    ARC = "all points, rotation fitted to the arc"
    """Ours."""


Squared = dict[Method, FloatArray]
"""(runs, report times) squared attitude errors, rad^2."""


def run_identification(batch: RunBatch[float]) -> Squared:
    """Identify the axes of every run at every report time, at an angular resolution (rad).

    The points and the noise of a run are its seed's.
    """
    truth = _truth()
    points, p_world, noise = _observed(truth, batch.case.settings, batch.seeds)
    arcs = _fitted(truth, p_world, noise)
    corners = _corners(p_world, arcs[-1])
    of_arcs = [_arc_squared(truth, points, arc, corners) for arc in arcs]
    return {
        Method.PRINTED: _printed(truth, points, p_world, corners),
        Method.ARC: np.stack(of_arcs, axis=1),
    }


def _truth() -> Trajectory:
    """The motion up to the last report."""
    scenario = paper.scenario()
    times = scenario.times_s[scenario.times_s <= REPORT_S[-1] + 1e-9]
    return simulate_motion(replace(scenario, times_s=times), np.random.default_rng(0))


def _observed(
    truth: Trajectory, resolution_rad: float, seeds: tuple[int, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True points (B, N, 3), triangulated ones (B, n, N, 3) in world axes and their covariances.

    The image is taken to be large enough for all points, which a passing of 5 m needs.
    """
    scenario = paper.scenario()
    stereo = scenario.stereo.model_copy(
        update={"pixel_sigma_px": resolution_rad * scenario.stereo.focal_px}
    )
    rig = stereo.rig
    R_hill_world = np.stack([scenario.orbit.R_hill_world(t) for t in truth.time_s])
    R_cam_world = R_cam_hill(truth[POSITION]) @ R_hill_world
    r_world = np.einsum("nji,nj->ni", R_hill_world, truth[POSITION])
    generators = [np.random.default_rng(seed) for seed in seeds]
    points = np.stack([draw_points(scenario.features, each) for each in generators])
    p_world = r_world[:, None] + points[:, None] @ np.swapaxes(truth[ATTITUDE], 1, 2)
    pixels = rig.project(p_world @ np.swapaxes(R_cam_world, 1, 2))
    drawn = np.stack([each.standard_normal(pixels.shape[1:]) for each in generators])
    p_rig, noise = rig.triangulate(pixels + rig.pixel_sigma_px * drawn)
    R = R_cam_world[:, None]
    return points, p_rig @ R_cam_world, np.swapaxes(R, -1, -2) @ noise @ R


@dataclass(frozen=True)
class _Arc:
    """What is identified from an arc."""

    frame: int
    """Its last."""
    R_world_map: FloatArray
    """(B, 3, 3) there."""
    inertia: FloatArray
    """(B, 3, 3) map axes."""
    shape: FloatArray
    """(B, N, 3) points in the map."""


def _corners(p_world: FloatArray, arc: _Arc) -> IntArray:
    """(B, 3) the points of every run whose frame is G of (6).

    The widest triangle of the first frame, in the order that leaves the signs of (17) the clearest.
    """
    chosen = []
    for first, inertia, shape in zip(p_world[:, 0], arc.inertia, arc.shape, strict=True):
        triple = np.array(best_triple(first))
        chosen.append(triple[list(clearest_order(shape[triple], inertia))])
    return np.array(chosen)


def _triangle(points: FloatArray, corners: IntArray) -> FloatArray:
    """(B, ..., 3, 3) the chosen points of (B, ..., N, 3)."""
    rows = corners.reshape(len(corners), *([1] * (points.ndim - 3)), 3, 1)
    return np.take_along_axis(points, np.broadcast_to(rows, (*points.shape[:-2], 3, 1)), axis=-2)


def _printed(
    truth: Trajectory, points: FloatArray, p_world: FloatArray, corners: IntArray
) -> FloatArray:
    """(B, report times) squared errors of (6)-(17)."""
    R_world_g = photogrammetric_axes(_triangle(p_world, corners))
    rates = angular_rate(R_world_g, truth.time_s)
    rows = momentum_rows(R_world_g[:, 1:-1], rates)
    # Every epoch adds to the normal equations: the sums up to a time are the recursive solution.
    sums = np.cumsum(np.einsum("bnie,bnif->bnef", rows, rows, optimize=True), axis=1)
    squared = []
    for last in _last_frames(truth):
        _, axes = principal_axes(solve_normal(sums[:, last - 2]))
        squared.append(_squared(truth, points, corners, R_world_g[:, last] @ axes, last))
    return np.stack(squared, axis=1)


def _arc_squared(truth: Trajectory, points: FloatArray, arc: _Arc, corners: IntArray) -> FloatArray:
    """(B,) squared errors of an arc's axes."""
    R_map_t = _unique_axes(_triangle(arc.shape, corners), arc.inertia)
    return _squared(truth, points, corners, arc.R_world_map @ R_map_t, arc.frame)


def _unique_axes(triangle: FloatArray, inertia: FloatArray) -> FloatArray:
    """(B, 3, 3) principal axes in those that triangles (B, 3, 3) and inertia are given in."""
    R_a_g = photogrammetric_axes(triangle)
    _, axes = principal_axes(np.swapaxes(R_a_g, -1, -2) @ inertia @ R_a_g)
    return np.asarray(R_a_g @ axes)


def _fitted(truth: Trajectory, p_world: FloatArray, noise: FloatArray) -> list[_Arc]:
    """All points aligned and the rotation fitted, for every arc; each starts from the last."""
    arcs: list[_Arc] = []
    for last in _last_frames(truth):
        every = max(1, -(-(last + 1) // _MAX_ATTITUDES))
        chosen = np.arange(last, -1, -every)[::-1]
        R, spread, shape = _attitudes(p_world[:, chosen], noise[:, chosen])
        times = truth.time_s[chosen]
        rates = angular_rate(R, times)
        if arcs:
            # Each arc has a map of its own; the turn between them is that of their last frames.
            before = arcs[-1]
            back = np.searchsorted(truth.time_s[chosen], truth.time_s[before.frame] - 1e-9)
            turn = np.swapaxes(R[:, min(int(back), len(chosen) - 1)], -1, -2) @ before.R_world_map
            start = parameters_of(turn @ before.inertia @ np.swapaxes(turn, -1, -2))
        else:
            rows = momentum_rows(R[:, 1:-1], rates)
            linear = solve_normal(np.einsum("bnie,bnif->bef", rows, rows, optimize=True))
            start = positive(parameters_of(linear))
        first_rate = rates[:, : max(1, len(times) // 10)].mean(axis=1)
        parameters = _best_fit(times, R, spread, first_rate, start)
        arcs.append(_Arc(last, R[:, -1], inertia_of(parameters), shape))
    return arcs


def _best_fit(
    times: FloatArray,
    R: FloatArray,
    spread: FloatArray,
    rate: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """(B, 5) inertia parameters; fits that explain their arc badly are begun again from a ball."""
    fit = fit_rotation_arc(times, R, spread, rate, start, _MAX_STEPS)
    found, degrees = fit.start.parameters.copy(), max(3 * len(times) - SIZE, 1)
    bad = np.flatnonzero(fit.cost > _BAD_FIT * degrees)
    if len(bad):
        ball = np.tile(parameters_of(np.eye(3)), (len(bad), 1))
        again = fit_rotation_arc(times, R[bad], spread[bad], rate[bad], ball)
        better = again.cost < fit.cost[bad]
        found[bad[better]] = again.start.parameters[better]
    return found


def _attitudes(p_world: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Attitudes (B, n, 3, 3) of the points, their covariances in map axes, and the map (B, N, 3).

    The map is that of the first frame, then the average over the arc, each view weighted.
    """
    shape = p_world[:, 0] - p_world[:, 0].mean(axis=1, keepdims=True)
    shape_noise: FloatArray | None = noise[:, 0]
    for _ in range(3):
        known = None if shape_noise is None else np.broadcast_to(shape_noise[:, None], noise.shape)
        fit = align(p_world, np.broadcast_to(shape[:, None], p_world.shape), noise, known)
        R = fit.R_a_b[:, :, None]
        weights = np.linalg.inv(np.swapaxes(R, -1, -2) @ noise @ R)
        back = (p_world - fit.t_a[:, :, None])[..., None, :] @ R
        total = weights.sum(axis=1)
        mean = (weights @ np.swapaxes(back, -1, -2)).sum(axis=1)
        shape, shape_noise = np.linalg.solve(total, mean)[..., 0], None
    R = fit.R_a_b
    return R, np.swapaxes(R, -1, -2) @ fit.covariance[..., :3, :3] @ R, shape


def _last_frames(truth: Trajectory) -> list[int]:
    return [int(np.searchsorted(truth.time_s, t - 1e-9)) for t in REPORT_S]


def _squared(
    truth: Trajectory,
    points: FloatArray,
    corners: IntArray,
    R_world_t: FloatArray,
    frame: int,
) -> FloatArray:
    """(B,) squared attitude errors against the true axes, made unique by the true points."""
    R_body_t = _unique_axes(_triangle(points, corners), NavigationState.of(truth, frame).inertia)
    error = log_rotation(np.swapaxes(R_world_t, -1, -2) @ truth[ATTITUDE][frame] @ R_body_t)
    return np.asarray(np.sum(error * error, axis=-1))


Rmse = Mapping[str, Mapping[Method, FloatArray]]
"""(report times,) in degrees by resolution, the finest first, and method."""


def rmse_of(by_level: Mapping[str, Sequence[Squared]]) -> Rmse:
    """RMSE (45) over all runs of each level."""
    return {
        level: {
            method: np.degrees(
                np.sqrt(np.concatenate([each[method] for each in batches]).mean(axis=0))
            )
            for method in Method
        }
        for level, batches in by_level.items()
    }


def falls(rmse: Rmse, method: Method) -> bool:
    """Whether every level falls from its first report to its last."""
    return all(bool(curves[method][-1] < curves[method][0]) for curves in rmse.values())


def rises_with_noise(rmse: Rmse, method: Method) -> bool:
    """Whether at the last report more noise is a larger error."""
    return bool(np.all(np.diff([curves[method][-1] for curves in rmse.values()]) > 0.0))


def rmse_table(key: str, rmse: Rmse, method: Method) -> TextTable:
    """Over the length of the arc."""
    paper_says = "falls within a few seconds, before the first occlusion; more noise, larger error"
    rows = []
    for level, curves in rmse.items():
        values = curves[method]
        ours = "falls" if values[-1] < values[0] else "does not fall"
        rows.append((level, *values, ours, paper_says))
    header = ("resolution", *(f"{t:g} s" for t in REPORT_S), "ours over time", "paper (Fig. 5)")
    return table(key, header, rows)


def rmse_figure(key: str, rmse: Rmse, method: Method) -> StudyFigure:
    """Over the length of the arc."""
    curves = [Curve(level, by[method], style=".-") for level, by in rmse.items()]
    panel, label = Panel("RMSE, deg", curves, Scale.LOG), "length of the arc, s"
    at = np.array(REPORT_S)
    return StudyFigure(key, panels_figure(at, [panel], row_in=2.5, at_label=label, log_at=True))
