"""From an arc of frames to the state of Hu 2024's filter at its end, nothing known before.

Points -> rigid map and its poses -> rotation and inertia -> unique principal frame -> mass centre
-> everything together, from the pixels -> the same under disturbances: smoothed over the arc.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.principal_axes import Identification, PrincipalAxesTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.inertia_parameters import BALL, inertia_of, parameters_of
from pcnav.dynamics.kepler import KeplerOrbit, step_relative
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.principal_inertia import moments_from_ratios, ratios_from_moments
from pcnav.estimators.attitude_inertia.rotation_fit import fit_rotation_arc, positive
from pcnav.estimators.features.feature_map import FeatureMap, build_map, triangulated
from pcnav.estimators.features.photogrammetric_frame import best_triple, photogrammetric_axes
from pcnav.estimators.principal_axes.arc_fit import fit_pixels, weakly_held
from pcnav.estimators.principal_axes.feature_measurements import FeatureView
from pcnav.estimators.principal_axes.feature_state_changes import relabelled
from pcnav.estimators.principal_axes.feature_states import (
    PA_OMEGA,
    PA_R_HILL,
    PA_RATIOS,
    PA_THETA,
    PA_V_HILL,
    PrincipalAxesModel,
    PrincipalState,
)
from pcnav.estimators.principal_axes.inertia_identification import (
    angular_rate,
    batch_least_squares,
    errors_in_variables,
)
from pcnav.estimators.principal_axes.linearised import Prior, smoothed
from pcnav.estimators.principal_axes.principal_choice import (
    axes_certainty,
    signing_triple,
    unique_choice,
)
from pcnav.estimators.principal_axes.principal_frame import (
    clearest_order,
    free_axes,
    principal_axes,
)
from pcnav.recordings.tracks import TrackFrame

_MIN_POSES = 10
_MAX_MISFIT = 1.5
"""Squared residuals over degrees of freedom, hundreds of them; beyond, momentum changes."""
_MAX_ATTITUDES = 40
_MAX_GAP_RAD = 0.5
"""Turn between the attitudes that a rate is differentiated from."""
_SOME = np.array([1.0, 1.0]) / 3.0
"""Ratios far from those of equal moments and of thin bodies."""
_VAGUE = 10.0
"""Before the frames, rates may be off by so many times the largest that they show."""


@dataclass(frozen=True)
class ArcStart:
    """What an arc says at its end."""

    time_s: float
    state: PrincipalState
    covariance: FloatArray
    """(14 + 3N, 14 + 3N)"""
    features: tuple[int, ...]
    """In the order of the state's points."""
    used: tuple[int, ...]
    """Those of the last frame that agree with the others."""
    triple: tuple[int, int, int]
    """The features whose photogrammetric frame gave the axes their signs."""
    is_ready: bool
    """Whether to wait for a longer arc is of no use: the axes are determined if the target turned
    without torque, as (10) has it, or its pixels deny that it does."""


@dataclass(frozen=True)
class _Rotation:
    """Rotation and inertia of the map at the first pose."""

    R_world_map: FloatArray
    omega_map: FloatArray
    inertia: FloatArray
    """(3, 3) N = 3 I / tr(I), map axes."""


def start_from_arc(
    frames: Sequence[TrackFrame],
    rig: StereoRig,
    orbit: KeplerOrbit,
    table: PrincipalAxesTable,
    rng: np.random.Generator,
) -> ArcStart | None:
    """The filter's state at the last frame; None when the frames do not show one rigid body."""
    seen = [triangulated(frame, rig) for frame in frames]
    found = build_map(seen, rng)
    if found is None or len(found.poses) < _MIN_POSES:
        return None
    times = np.array([frames[pose.frame].time_s for pose in found.poses])
    rotation = _identified(found, times, table.identification)
    names = sorted(found.points)
    points = np.stack([found.points[name] for name in names])
    R_map_t, triple = _axes(points, rotation, table.unique_frame, rng)
    centre, r, v = _mass_centre(found, times, orbit, points)
    state = PrincipalState(
        R_world_body=rotation.R_world_map @ R_map_t,
        omega_body=R_map_t.T @ rotation.omega_map,
        ratios=ratios_from_moments(np.diag(R_map_t.T @ rotation.inertia @ R_map_t)),
        r_hill=r,
        v_hill=v,
        points=(points - centre) @ R_map_t,
    )
    state = state.retract(state.admissible(np.zeros(14 + 3 * len(names)), _unit(len(names))))
    views = _views(found, frames, rig, orbit, names)
    model = PrincipalAxesModel(
        orbit, table.acceleration_psd_m2_s3, table.angular_acceleration_psd_rad2_s3
    )
    fit = fit_pixels(times, views, model, state)
    is_disturbed = fit.misfit > _MAX_MISFIT
    # A disturbance leads fits without one astray, as far as no step of least squares brings it
    # back; so the trajectory begins as the frames show it, and with a body like many.
    nominal = _as_seen(found, times, orbit, replace(state, ratios=_SOME) if is_disturbed else state)
    prior = Prior(_vague(nominal), nominal[0] if is_disturbed else None)
    try:
        end = smoothed(nominal, times.tolist(), views, model, prior, table.gate_probability)
    except np.linalg.LinAlgError:
        return None
    if is_disturbed and not end.is_settled:
        return None
    last, covariance = end.state, end.covariance
    if table.unique_frame:
        last, covariance, triple = _signed(last, covariance, triple)
    i, j, k = (names[slot] for slot in triple)
    known = axes_certainty(fit.state, max(1.0, fit.misfit) * fit.covariance)
    is_ready = known.is_determined or is_disturbed
    used = tuple(views[-1].features.tolist())
    return ArcStart(float(times[-1]), last, covariance, tuple(names), used, (i, j, k), is_ready)


def _unit(points: int) -> FloatArray:
    return np.eye(14 + 3 * points)


def _identified(found: FeatureMap, times: FloatArray, method: Identification) -> _Rotation:
    """Rotation and inertia by one of the methods, from poses thinned to what is needed."""
    every = -(-len(times) // _MAX_ATTITUDES)
    poses, times = found.poses[::every], times[::every]
    R = np.stack([pose.R_world_map for pose in poses])
    noise = np.stack(
        [pose.R_world_map.T @ pose.covariance[:3, :3] @ pose.R_world_map for pose in poses]
    )
    rates = angular_rate(R, times)
    spans = times[2:] - times[:-2]
    near = np.linalg.norm(rates, axis=1) * spans < _MAX_GAP_RAD
    near &= spans < 2.5 * np.median(spans)
    inner, rates = R[1:-1][near], rates[near]
    rate_noise = ((noise[2:] + noise[:-2]) / spans[:, None, None] ** 2)[near]
    linear = errors_in_variables(inner, rates, rate_noise)
    printed = batch_least_squares(inner, rates)
    omega = _first_rate(rates, times[1:-1][near], float(times[0]))
    if method is not Identification.ARC:
        chosen = printed if method is Identification.PRINTED else linear
        return _Rotation(R[0], omega, inertia_of(_parameters(chosen)))
    starts = np.stack([_parameters(linear), _parameters(printed), BALL])
    # Under torque a step may lead to rates beyond numbers: its cost is not finite, nobody takes it.
    with np.errstate(over="ignore", invalid="ignore"):
        fit = fit_rotation_arc(
            times,
            np.broadcast_to(R, (3, *R.shape)),
            np.broadcast_to(noise, (3, *noise.shape)),
            np.tile(omega, (3, 1)),
            starts,
        )
    best = int(fit.cost.argmin())
    start = fit.start
    inertia = inertia_of(start.parameters[best])
    return _Rotation(start.R_world_body[best], start.omega_body[best], inertia)


def _first_rate(rates: FloatArray, times: FloatArray, first: float) -> FloatArray:
    """(3,) rate at the first time, of a straight line through the first few rates."""
    few = slice(0, 10)
    line = np.polyfit(times[few] - first, rates[few], min(1, len(rates[few]) - 1))
    return np.asarray(line[-1])


def _parameters(inertia: FloatArray) -> FloatArray:
    trace = float(np.trace(inertia))
    if not (np.isfinite(trace) and trace > 0.1):
        return BALL
    return positive(parameters_of(inertia))


def _axes(
    points: FloatArray, rotation: _Rotation, unique: bool, rng: np.random.Generator
) -> tuple[FloatArray, tuple[int, int, int]]:
    """R_map_t of the principal axes, and the triple of points that signed them.

    The order of the three points is that which makes both signs the clearest.
    """
    best = best_triple(points)
    i, j, k = (best[at] for at in clearest_order(points[list(best)], rotation.inertia))
    if unique:
        R_map_p = photogrammetric_axes(points[[i, j, k]])
        return R_map_p @ principal_axes(R_map_p.T @ rotation.inertia @ R_map_p)[1], (i, j, k)
    some = photogrammetric_axes(points[rng.permutation(list(best))])
    return some @ free_axes(some.T @ rotation.inertia @ some), (i, j, k)


def _signed(
    state: PrincipalState, covariance: FloatArray, triple: tuple[int, int, int]
) -> tuple[PrincipalState, FloatArray, tuple[int, int, int]]:
    """The state in the axes that (17) asks for now, and the triple in the order that signs them.

    Axes that were identified as if without torque may be off by so much that those they end as
    would have been signed otherwise.
    """
    corners = state.points[list(triple)]
    inertia = np.diag(moments_from_ratios(state.ratios))
    i, j, k = (triple[at] for at in clearest_order(corners, inertia))
    i, j, k = signing_triple(state, covariance, (i, j, k))
    R_body_new = unique_choice(state, state.points[[i, j, k]])
    if float(np.trace(R_body_new)) < 3.0:
        state, covariance = relabelled(state, covariance, R_body_new)
    return state, covariance, (i, j, k)


def _mass_centre(
    found: FeatureMap, times: FloatArray, orbit: KeplerOrbit, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mass centre in map axes, and its r and v in Hill axes at the first time.

    The mass centre is the point that moves on an orbit while the map turns about it:
    ``t(k) = R_world_hill(k) r(k) - R_world_map(k) c``, linear in c and in the orbit's start. The
    part of c along an axis that never turns is not seen; a weak preference for the middle of the
    points decides it.
    """
    transitions = _transitions(orbit, times, found.poses[0].t_world)
    normal, right = np.zeros((9, 9)), np.zeros(9)
    for pose, time, transition in zip(found.poses, times, transitions, strict=True):
        rows = np.hstack([orbit.R_hill_world(float(time)).T @ transition[:3], -pose.R_world_map])
        weight = np.linalg.inv(pose.covariance[3:, 3:])
        normal += rows.T @ weight @ rows
        right += rows.T @ weight @ pose.t_world
    middle = points.mean(axis=0)
    spread = float(np.square(points - middle).sum(axis=1).max())
    normal[6:, 6:] += np.eye(3) / spread
    right[6:] += middle / spread
    x = np.asarray(np.linalg.solve(normal, right), np.float64)
    return x[6:], x[:3], x[3:6]


def _transitions(orbit: KeplerOrbit, times: FloatArray, r: FloatArray) -> list[FloatArray]:
    """(6, 6) of the relative orbit from the first time to all."""
    if orbit.eccentricity == 0.0:
        return [hill_transition(orbit.mean_motion_rad_s, float(t - times[0])) for t in times]
    found = [np.eye(6)]
    for before, after in zip(times[:-1].tolist(), times[1:].tolist(), strict=True):
        *_, step = step_relative(orbit, r, np.zeros(3), before, after - before)
        found.append(step @ found[-1])
    return found


def _views(
    found: FeatureMap,
    frames: Sequence[TrackFrame],
    rig: StereoRig,
    orbit: KeplerOrbit,
    names: Sequence[int],
) -> list[FeatureView]:
    """The frames of the poses with the features that agree with the map."""
    slot = {name: k for k, name in enumerate(names)}
    views = []
    for pose in found.poses:
        frame = frames[pose.frame]
        usable = frame.pixels[rig.disparity(frame.pixels) > 0.0][pose.agrees]
        features = frame.features[rig.disparity(frame.pixels) > 0.0][pose.agrees]
        kept = replace(frame, features=features, pixels=usable)
        slots = np.array([slot[name] for name in features.tolist()], dtype=np.intp)
        views.append(FeatureView(kept, rig, orbit.R_hill_world(frame.time_s), slots))
    return views


def _vague(nominal: Sequence[PrincipalState]) -> FloatArray:
    """(n, n) of the first state's error before the frames say anything: the size of what they show.

    That is hundreds of times what one frame leaves open, and little enough to be told from zero.
    """
    first = nominal[0]
    sd = np.full(first.size, np.linalg.norm(first.points - first.points.mean(axis=0), axis=1).max())
    sd[PA_THETA] = sd[PA_RATIOS] = 1.0
    sd[PA_OMEGA] = _VAGUE * max(float(np.linalg.norm(state.omega_body)) for state in nominal)
    sd[PA_R_HILL] = np.linalg.norm(first.r_hill)
    sd[PA_V_HILL] = _VAGUE * max(float(np.linalg.norm(state.v_hill)) for state in nominal)
    return weakly_held(first, np.diag(sd**2))


def _as_seen(
    found: FeatureMap, times: FloatArray, orbit: KeplerOrbit, first: PrincipalState
) -> list[PrincipalState]:
    """States at all times, each with its own frame's pose, and rates between neighbours.

    ``first`` is the state at the first time, whose axes and points hold for all.
    """
    R_map_body = found.poses[0].R_world_map.T @ first.R_world_body
    names = sorted(found.points)
    centre = found.points[names[0]] - R_map_body @ first.points[0]
    R = np.stack([pose.R_world_map @ R_map_body for pose in found.poses])
    r = np.stack(
        [
            orbit.R_hill_world(time) @ (pose.t_world + pose.R_world_map @ centre)
            for pose, time in zip(found.poses, times.tolist(), strict=True)
        ]
    )
    steps = np.diff(times)
    turns = log_rotation(np.swapaxes(R[:-1], -1, -2) @ R[1:]) / steps[:, None]
    moves = np.diff(r, axis=0) / steps[:, None]
    last = len(steps) - 1
    # Of the two neighbours of a time the nearer: after a gap a turn may be another by a whole one.
    by = [min(max(k - 1, 0), last) for k in range(len(times))]
    by = [
        j if steps[j] <= steps[min(j + (k > 0), last)] else min(k, last) for k, j in enumerate(by)
    ]
    return [
        replace(first, R_world_body=R[k], omega_body=turns[j], r_hill=r[k], v_hill=moves[j])
        for k, j in enumerate(by)
    ]
