"""A made-up run whose errors are drawn from the covariance it states."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.records import ACCEPTED, RectangleRecord

FIRST_ESTIMATE = 3
SD = np.repeat([0.05, 0.002, 0.03, 0.01, 0.001, 0.02], [3, 3, 3, 3, 3, 5])
T_CAM_WORLD = make_transform(exp_rotation(np.array([0.3, -1.2, 0.4])), np.zeros(3))


OUTPUT = Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True)


@dataclass(frozen=True)
class SyntheticRun:
    """The frames of a run and the truth behind it."""

    estimates: tuple[Estimate, ...]
    truth: Trajectory
    output: Output = OUTPUT


def correlated_covariance(generator: np.random.Generator, time_s: float) -> FloatArray:
    """A (20, 20) covariance with strong correlations that shrinks with time."""
    factor = np.eye(STATE_SIZE) + 0.5 * generator.standard_normal((STATE_SIZE, STATE_SIZE))
    correlation = factor @ factor.T
    scale = SD * (0.15 + np.exp(-time_s / 10.0)) / np.sqrt(np.diagonal(correlation))
    return np.asarray(correlation * scale[:, None] * scale)


def true_state(time_s: float) -> NavigationState:
    """A smooth motion; it need not obey any dynamics to be compared with."""
    return NavigationState(
        r_hill=np.array([25.0 + 0.01 * time_s, -1.0 + 0.5 * np.sin(0.02 * time_s), 0.3]),
        v_hill=np.array([0.01, 0.01 * np.cos(0.02 * time_s), 0.0]),
        com_model=np.array([0.12, -0.05, 0.2]),
        R_world_body=exp_rotation(np.array([0.02, 0.15, -0.03]) * time_s),
        omega_body=np.array([0.02, 0.15, -0.03]),
        inertia_ratios=np.array([1.3, 0.8, 0.02, -0.01, 0.03]),
    )


def frame_estimate(
    index: int, truth: NavigationState, generator: np.random.Generator, inflation: float
) -> Estimate:
    """One frame; the error is drawn from the covariance, times ``inflation``."""
    time_s = 0.5 * index
    dof = int(generator.integers(0, 4)) * 6
    nis = float(generator.chisquare(dof)) if dof else np.nan
    if index < FIRST_ESTIMATE:
        return Estimate(time_s, "acquiring", notes={"n_rectangles": 0})
    covariance = correlated_covariance(generator, time_s)
    error = generator.multivariate_normal(np.zeros(STATE_SIZE), covariance, method="cholesky")
    # The truth is the estimate moved by the error; with a small error the reverse holds as well.
    # The covariance is that of a result: by the inertia ratios, not by the filter's parameters.
    off = -inflation * error
    ratios = truth.inertia_ratios + off[INERTIA_RATIOS]
    off[INERTIA_RATIOS] = 0.0
    state = replace(truth.retract(off), inertia_ratios=ratios)
    pose = state.T_cam_model(T_CAM_WORLD, np.eye(3))
    outcomes = (ACCEPTED, "side too short", ACCEPTED, "normal away from camera <45 deg>")
    records = tuple(
        RectangleRecord(
            time_s=time_s,
            rectangle=("front", "panel, +y", "", "rear")[k],
            length_m=4.0 / 3.0 + k,
            width_m=1.0,
            T_cam_rect=pose,
            sd=np.array([0.001, 0.002, np.inf, 0.01, 0.02, 0.03]) * (k + 1),
            case="IXYZ"[k],
            outcome=outcomes[k],
        )
        for k in range(dof // 6 + (index % 7 == 0))
    )
    status = "locked" if dof else "coasting"
    explained = 0.95 + 0.04 * float(np.sin(0.3 * index))
    return Estimate(
        *(time_s, status, state.values, covariance, pose, nis, dof),
        notes={"inlier_ratio": explained, "n_rectangles": dof // 6},
        records=records,
    )


@pytest.fixture(scope="session")
def make_run() -> Callable[..., SyntheticRun]:
    """Makes a run of so many frames, its errors ``inflation`` times what it states."""

    def make(frames: int, inflation: float = 1.0) -> SyntheticRun:
        generator = np.random.default_rng(7)
        time_s: FloatArray = 0.5 * np.arange(frames, dtype=np.float64)
        states = [true_state(t) for t in time_s]
        estimates = tuple(
            frame_estimate(i, state, generator, inflation) for i, state in enumerate(states)
        )
        truth = Trajectory(
            time_s=time_s,
            layout=MASS_CENTRE_LAYOUT,
            values={
                name: np.array([state.values[name] for state in states])
                for name in true_state(0.0).values
            },
            T_cam_target=np.array([s.T_cam_model(T_CAM_WORLD, np.eye(3)) for s in states]),
        )
        return SyntheticRun(estimates, truth)

    return make
