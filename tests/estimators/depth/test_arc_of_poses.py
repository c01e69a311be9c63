"""Frames of an arc compared all at once, against each measurement asked for itself."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray, picked
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.arc_of_poses import ArcOfPoses
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.pose_measurement import ObserverPose, PoseMeasurement, PoseReference
from pcnav.filtering.map_arc_fit import OneByOne, TimedMeasurements, Whitened

N, STEP_S = 1.1e-3, 5.0
MODEL = MassCentreModel(N, 0.0, 0.0)
STATE = NavigationState(
    r_hill=np.array([20.0, 0.5, -0.4]),
    v_hill=np.array([0.01, -0.005, 0.004]),
    com_model=np.array([0.05, -0.03, 0.08]),
    R_world_body=exp_rotation(np.array([0.5, -1.0, 0.7])),
    omega_body=np.array([0.05, -0.08, 0.1]),
    inertia_ratios=np.array([0.8, 1.1, 0.02, -0.03, 0.01]),
)
Timed = TimedMeasurements[NavigationState]


def arc_of(rng: np.random.Generator) -> list[Timed]:
    """Frames with all components, with fewer, with shared errors, with two measurements, none."""
    arc, time_s = [], 100.0
    for count, shared, many in ((6, 0, 1), (4, 0, 1), (5, 2, 1), (3, 0, 2), (0, 0, 0), (6, 0, 1)):
        R = R_hill_world(time_s, N)
        T_cam_world = make_transform(exp_rotation(rng.normal(size=3)), rng.normal(size=3))
        near = STATE.retract(0.05 * rng.normal(size=20)).T_cam_model(T_cam_world, R)
        reference = PoseReference(near, ObserverPose(T_cam_world, R))
        measurements = tuple(
            PoseMeasurement(
                reference,
                rng.normal(size=(count, 6)),
                rng.normal(size=count),
                rng.normal(size=(count, shared)) if shared else None,
            )
            for _ in range(many)
        )
        arc.append(TimedMeasurements(time_s, measurements))
        time_s += STEP_S
    return arc


def rows(seen: list[Whitened]) -> FloatArray:
    """(m, 22) frame, residual and derivative of every component, in order of the frames."""
    found = []
    for part in seen:
        frames = np.broadcast_to(part.frames[:, None], part.residual.shape)
        table = np.concatenate([frames[..., None], part.residual[..., None], part.by_state], -1)
        found.append(table[part.is_measured])
    table = np.vstack(found)
    return np.asarray(table[np.argsort(table[:, 0], kind="stable")])


def test_all_at_once_is_one_by_one() -> None:
    arc = arc_of(np.random.default_rng(3))
    states = MODEL.along(STATE, np.array([timed.time_s for timed in arc])).states
    together, each = ArcOfPoses.of(arc).about(states), OneByOne(arc).about(states)
    # One batch, and the two measurements of one frame each for itself.
    assert max(len(part.frames) for part in together) == 4 and len(together) == 3
    np.testing.assert_allclose(rows(together), rows(each), rtol=1e-9, atol=1e-9)


def test_an_arc_without_measurements_says_nothing() -> None:
    arc: list[Timed] = [TimedMeasurements(STEP_S * k, ()) for k in range(3)]
    states = MODEL.along(STATE, STEP_S * np.arange(3.0)).states
    assert ArcOfPoses.of(arc).about(states) == []


def test_states_along_an_arc_are_those_from_frame_to_frame() -> None:
    times_s = 10.0 + np.array([0.0, 0.5, 1.0, 9.0, 9.0, 40.0])
    path = MODEL.along(STATE, times_s)
    state, by_first = STATE, np.eye(20)
    for k, step_s in enumerate(np.diff(times_s), start=1):
        state, transition, _ = MODEL.propagate(state, 0.0, float(step_s))
        by_first = transition @ by_first
        np.testing.assert_allclose(state.local(picked(path.states, k)), 0.0, atol=1e-13)
        scale = np.abs(by_first).max()
        np.testing.assert_allclose(path.by_first[k] / scale, by_first / scale, atol=1e-13)


@pytest.mark.parametrize("frames", [1, 4])
def test_derivatives_by_the_first_state_are_differences(frames: int) -> None:
    times_s, h = 7.0 * np.arange(float(frames)), 1e-6
    path = MODEL.along(STATE, times_s)
    for i in range(20):
        up, down = (MODEL.along(STATE.retract(s * h * np.eye(20)[i]), times_s) for s in (1, -1))
        slope = picked(down.states, -1).local(picked(up.states, -1)) / (2.0 * h)
        np.testing.assert_allclose(path.by_first[-1][:, i], slope, atol=2e-6)
