"""Forecasts against SciPy's integration of the equations of motion, and closed forms."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.state import NavigationState
from pcnav.evaluation.forecast.accelerations import Accelerations
from pcnav.evaluation.forecast.cloud import Cloud
from pcnav.evaluation.forecast.point import Limits, TargetPoint, forecast
from pcnav.evaluation.forecast.spread import spread_of_vectors
from pcnav.evaluation.forecast.start import ForecastStart
from pcnav.evaluation.forecast.windows import Window, stays_within, windows
from tests.evaluation.forecast.independent import Bodies, moved, point_in_hill

MEAN_MOTION = 1.1e-3
STATE = NavigationState(
    r_hill=np.array([18.0, -3.0, 2.0]),
    v_hill=np.array([0.01, -0.02, 0.005]),
    com_model=np.array([0.3, -0.2, 0.5]),
    R_world_body=exp_rotation(np.array([0.4, -1.1, 0.7])),
    omega_body=np.array([0.05, -0.12, 0.08]),
    inertia_ratios=np.array([0.8, 1.3, 0.05, -0.04, 0.02]),
)
NONE = Accelerations.known(0.0, 0.0)
TIP = TargetPoint("tip", np.array([1.5, 4.0, -0.7]))


def start_of(sd: FloatArray, **changes: Any) -> ForecastStart:
    start = ForecastStart(0.0, STATE, np.diag(sd**2), MEAN_MOTION, True, NONE)
    return replace(start, **changes)


def inertia(ratios: FloatArray) -> FloatArray:
    yy, zz, xy, xz, yz = np.moveaxis(ratios, -1, 0)
    ones = np.ones_like(yy)
    rows = [[ones, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def bodies(errors: FloatArray) -> tuple[Bodies, FloatArray]:
    """Those of errors (M, 20) of the state, and the arms of the tip."""
    R = STATE.R_world_body @ Rotation.from_rotvec(errors[:, 9:12]).as_matrix()
    assert TIP.p_model is not None
    return (
        Bodies(
            STATE.r_hill + errors[:, :3],
            STATE.v_hill + errors[:, 3:6],
            R,
            STATE.omega_body + errors[:, 12:15],
            inertia(STATE.inertia_ratios + errors[:, 15:]),
        ),
        TIP.p_model - STATE.com_model - errors[:, 6:9],
    )


def test_what_is_known_goes_where_the_equations_lead() -> None:
    found = forecast(
        start_of(np.zeros(20)), TIP, np.array([0.0, 60.0]), np.random.default_rng(0), n=4
    )
    at, arm = bodies(np.zeros((1, 20)))
    places = [
        point_in_hill(moved(at, MEAN_MOTION, t), arm, MEAN_MOTION * t)[0]
        for t in (59.95, 60.0, 60.05)
    ]
    last = found.instants[-1]
    np.testing.assert_allclose(last.position.mean, places[1], atol=2e-6)
    np.testing.assert_allclose(last.velocity.mean, (places[2] - places[0]) / 0.1, atol=1e-5)
    R_hill_world = Rotation.from_euler("y", MEAN_MOTION * 60.0).as_matrix()
    R = R_hill_world @ moved(at, MEAN_MOTION, 60.0).R_world_body[0]
    np.testing.assert_allclose(last.attitude.mean, R, atol=1e-6)


def test_the_ellipsoid_is_true_where_the_attitude_is_hardly_known() -> None:
    """95 % of independent motions are within it, and far fewer within that of first order."""
    sd = np.repeat([0.01, 1e-4, 0.02, 0.15, 0.006, 0.03], [3, 3, 3, 3, 3, 5])
    start, ahead = start_of(sd), 60.0
    found = forecast(start, TIP, np.array([ahead]), np.random.default_rng(0)).instants[0]
    errors = np.random.default_rng(1).standard_normal((400, 20)) * sd
    at, arms = bodies(errors)
    after = moved(at, MEAN_MOTION, ahead)
    truths = point_in_hill(after, arms, MEAN_MOTION * ahead)
    assert found.position.holds(truths).mean() == pytest.approx(0.95, abs=0.033)
    R_hill_world = Rotation.from_euler("y", MEAN_MOTION * ahead).as_matrix()
    within = found.attitude.holds(R_hill_world @ after.R_world_body)
    assert within.mean() == pytest.approx(0.95, abs=0.033)
    np.testing.assert_allclose(found.position.mean, truths.mean(axis=0), atol=0.2)
    # To first order the same doubt is an ellipsoid about the nominal place.
    steps = 1e-5 * np.vstack([np.zeros(20), np.eye(20)])
    nominal, arms = bodies(steps)
    ends = point_in_hill(moved(nominal, MEAN_MOTION, ahead), arms, MEAN_MOTION * ahead)
    by_error = (ends[1:] - ends[0]).T / 1e-5
    off = truths - ends[0]
    squared = np.einsum(
        "mi,ij,mj->m", off, np.linalg.inv(by_error @ np.diag(sd**2) @ by_error.T), off
    )
    assert np.mean(squared < 7.815) < 0.85


def test_accelerations_widen_a_kinematic_motion_as_integrated_white_noise() -> None:
    by_place, by_turn, t = 4e-6, 9e-7, 40.0
    sd = np.zeros(20)
    sd[3:6], sd[12:15] = 1e-3, 2e-4
    still = replace(STATE, omega_body=np.zeros(3), com_model=np.zeros(3))
    start = start_of(
        sd,
        state=still,
        mean_motion_rad_s=0.0,
        torque_free=False,
        accelerations=Accelerations.known(by_place, by_turn),
    )
    centre = TargetPoint("centre", None)
    found = forecast(start, centre, np.arange(0.0, 41.0, 4.0), np.random.default_rng(2), n=4000)
    last = found.instants[-1]
    expected = {
        "position": (last.position, 1e-6 * t**2 + by_place * t**3 / 3.0),
        "velocity": (last.velocity, 1e-6 + by_place * t),
        "attitude": (last.attitude, 4e-8 * t**2 + by_turn * t**3 / 3.0),
    }
    for name, (spread, variance) in expected.items():
        variances = np.diagonal(spread.covariance)
        np.testing.assert_allclose(variances, variance, rtol=0.1, err_msg=name)


def test_only_bodies_are_drawn() -> None:
    sd = np.zeros(20)
    sd[15:] = 0.5
    cloud = Cloud.drawn(start_of(sd), 1000, np.random.default_rng(3))
    moments = np.linalg.eigvalsh(cloud.inertia)
    assert (moments[:, 0] > 0.0).all()
    assert (moments[:, 0] + moments[:, 1] >= moments[:, 2] - 1e-12).all()
    assert np.std(moments[:, 2]) > 0.05


def test_windows_are_those_of_a_spin() -> None:
    """A face that looks at the chaser at first, and turns by three degrees a second."""
    spinning = replace(
        STATE,
        r_hill=np.array([20.0, 0.0, 0.0]),
        v_hill=np.zeros(3),
        com_model=np.zeros(3),
        R_world_body=np.eye(3),
        omega_body=np.deg2rad([0.0, 0.0, 3.0]),
        inertia_ratios=np.array([1.0, 2.0, 0.0, 0.0, 0.0]),
    )
    start = start_of(np.full(20, 1e-9), state=spinning, mean_motion_rad_s=0.0)
    face = TargetPoint("face", np.zeros(3), np.array([-1.0, 0.0, 0.0]))
    ahead, limits = np.arange(0.0, 142.0, 2.0), Limits(facing_rad=np.deg2rad(31.0))
    found = forecast(start, face, ahead, np.random.default_rng(4), limits, n=50)
    assert windows(found, 0.95) == (Window(0.0, 10.0, 1.0), Window(110.0, 130.0, 1.0))
    # Of a face with two sides the back counts as well.
    both = forecast(
        start, replace(face, two_sided=True), ahead, np.random.default_rng(4), limits, n=50
    )
    assert [each.begin_s for each in windows(both, 0.95)] == [0.0, 50.0, 110.0]
    turning = replace(limits, turning_rad_s=np.deg2rad(2.9))
    slow = forecast(start, face, ahead[:3], np.random.default_rng(4), turning, n=50)
    assert windows(slow, 0.5) == ()


def test_a_forecast_is_good_until_its_doubt_exceeds_the_tolerance() -> None:
    ahead, radius = np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.1, 0.2, 0.4, 0.3])
    assert stays_within(ahead, radius, 0.3) == 1.0
    assert np.isnan(stays_within(ahead, radius, 0.05))
    assert np.isinf(stays_within(ahead, radius, 0.5))


def test_the_ellipsoid_of_a_ring_holds_what_is_on_it() -> None:
    """Of values around an axis the chi-square size would be too large: all lie at one distance."""
    angle = np.random.default_rng(5).uniform(0.0, 2.0 * np.pi, 3000)
    ring = np.stack([np.cos(angle), np.sin(angle), 1e-3 * np.sin(7.0 * angle)], axis=1)
    spread = spread_of_vectors(ring)
    assert spread.reach < 2.2 < 2.795
    assert spread.holds(ring).mean() == pytest.approx(0.95, abs=1e-3)
    assert not spread.holds(np.array([0.0, 0.0, 0.1]))
