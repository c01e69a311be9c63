"""Forecasts: where a run's last estimate says that the target will be, and where it is then."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import rotation_angle
from pcnav.core.statistics import mean
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import NavigationState
from pcnav.evaluation.forecast.accelerations import Accelerations
from pcnav.evaluation.forecast.point import Forecast, TargetPoint, forecast
from pcnav.evaluation.forecast.start import ForecastStart, covariance_at, state_at
from pcnav.files.text_table import TextTable
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import true_motion
from pcnav.target.satellite import Target

from ..following import JudgedRun, follow
from ..tables import Claim, table
from .foreign_mass import foreign_truth
from .foreign_mass import found as target_of

NAME = "forecasts"
AHEAD_S = (10.0, 30.0, 60.0, 120.0)
BAR = (0.91, 0.99)
"""Of truths inside the 95 % ellipsoids."""
QUANTITIES = ("position", "velocity", "attitude")


@dataclass(frozen=True)
class Foretold:
    """Forecasts from the end of one run."""

    target: str
    seed: int
    held: BoolArray | None
    """(4, 2, 3) whether the truth is inside, by time ahead, point (mass centre, a corner of the
    bounding box) and quantity; None of a run that ends without a claim."""


def run_foretold(name: str, seed: int, frames: int) -> Foretold:
    """The track of `foreign_mass.run_foreign` and what it says of the time after its end."""
    of = target_of(name)
    truth = foreign_truth(of, seed, frames)
    run = follow(Scene.of(truth, of.target.mesh), of.target)
    if not run.claims[-1]:
        return Foretold(name, seed, None)
    corner = TargetPoint("corner", np.asarray(of.target.mesh.bounds)[1])
    start, ahead_s = _start(run, truth), np.array(AHEAD_S)
    held = [
        _held(forecast(start, point, ahead_s, _rng(seed)), run, truth, of.target)
        for point in (TargetPoint("mass centre", None), corner)
    ]
    return Foretold(name, seed, np.stack(held, axis=1))


def _rng(seed: int) -> np.random.Generator:
    return np.random.default_rng((seed, 2))


def _start(run: JudgedRun, truth: Pipeline) -> ForecastStart:
    table, last = truth.filter, len(run) - 1
    return ForecastStart(
        float(run.time_s[last]),
        state_at(run.said.trajectory, last),
        covariance_at(run.said.trajectory, last),
        truth.orbit.mean_motion_rad_s,
        torque_free=run.said.words["motion"][last] == "torque_free",
        accelerations=Accelerations.known(
            table.acceleration_psd_m2_s3, table.angular_acceleration_psd_rad2_s3
        ),
    )


def _held(foretold: Forecast, run: JudgedRun, truth: Pipeline, target: Target) -> FloatArray:
    """(4, 3)"""
    rate_hz = truth.scenario.frame_rate_hz
    frames = [len(run) - 1 + round(ahead * rate_hz) for ahead in AHEAD_S]
    longer = truth.scenario.model_copy(update={"frames": frames[-1] + 1})
    motion = true_motion(truth.model_copy(update={"scenario": longer}))
    end = motion.truth.poses[len(run) - 1][:3, :3]
    assert run.said.trajectory.T_cam_target is not None, "it is claimed"
    estimated = run.said.trajectory.T_cam_target[-1][:3, :3]
    # The one of the target's equivalent models that is followed.
    turns = target.symmetry_transforms
    T_true_followed = turns[np.argmin(rotation_angle(estimated.T @ end @ turns[:, :3, :3]))]
    n, rows = foretold.start.mean_motion_rad_s, []
    for frame, instant in zip(frames, foretold.instants, strict=True):
        state, time_s = motion.state(frame), float(motion.truth.time_s[frame])
        p, v, R = _seen(state, time_s, n, foretold.point, T_true_followed)
        rows.append(
            [instant.position.holds(p), instant.velocity.holds(v), instant.attitude.holds(R)]
        )
    return np.array(rows)


def _seen(
    state: NavigationState, time_s: float, n: float, point: TargetPoint, T_model: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position and velocity (3,) of a point in Hill axes, and R_hill_body (3, 3) of the model that
    is followed."""
    R = R_hill_world(time_s, n) @ state.R_world_body
    arm = np.zeros(3)
    if point.p_model is not None:
        arm = T_model[:3, :3] @ point.p_model + T_model[:3, 3] - state.com_model
    # The Hill axes turn about minus their y axis.
    rate = state.omega_body + n * R[1]
    return (
        state.r_hill + R @ arm,
        state.v_hill + R @ np.cross(rate, arm),
        np.asarray(R @ T_model[:3, :3]),
    )


def claims(found: Mapping[str, Sequence[Foretold]]) -> list[Claim]:
    """One of every quantity and time, over all targets."""
    held = _all([run for own in found.values() for run in own])
    expected = f"{BAR[0]:.0%} to {BAR[1]:.0%}"
    return [
        Claim(
            NAME,
            f"{quantity} {ahead:g} s ahead inside 95 %",
            expected,
            share,
            BAR[0] <= share <= BAR[1],
        )
        for j, quantity in enumerate(QUANTITIES)
        for ahead, share in zip(AHEAD_S, _shares(held, j), strict=True)
    ]


def tables(found: Mapping[str, Sequence[Foretold]]) -> list[TextTable]:
    """Shares by target."""
    named = {**found, "all": [run for own in found.values() for run in own]}
    rows: list[list[object]] = [
        [name, quantity, sum(run.held is not None for run in own), *_shares(_all(own), j)]
        for name, own in named.items()
        for j, quantity in enumerate(QUANTITIES)
    ]
    header = ("target", "quantity", "runs", *(f"{ahead:g} s" for ahead in AHEAD_S))
    return [table("forecasts", header, rows, 2)]


def _all(runs: Sequence[Foretold]) -> FloatArray:
    """(runs, 4, 2, 3)"""
    held = [run.held for run in runs if run.held is not None]
    return np.array(held, np.float64).reshape(-1, len(AHEAD_S), 2, len(QUANTITIES))


def _shares(held: FloatArray, quantity: int) -> list[float]:
    """By time ahead; attitudes are the same of both points."""
    points = slice(0, 1) if QUANTITIES[quantity] == "attitude" else slice(None)
    return [mean(held[:, k, points, quantity].ravel()) for k in range(len(AHEAD_S))]
