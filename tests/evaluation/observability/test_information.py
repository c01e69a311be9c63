"""The information of arcs: against batch least squares, closed forms and simple systems."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.config.principal_axes import PrincipalAxesTable
from pcnav.core.spatial import exp_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    AttitudeSet,
    RotationState,
    parameters_from_printed,
)
from pcnav.evaluation.observability.information import (
    expected_uncertainty,
    reference_arc,
    time_to_reach,
    whitened,
)
from pcnav.evaluation.observability.report import observability_of
from pcnav.evaluation.observability.reported import ROTATION
from pcnav.evaluation.observability.subjects import (
    TargetMotion,
    attitude_subject,
    bank_subject,
    principal_subject,
    timing_of,
)
from pcnav.recordings.tracks import StereoTracks, TrackFrame
from pcnav.simulation.motion import rotate_torque_free

PLACE = np.array([[1.0, 0.0]]) / 0.2
"""Of a point on a line, whose state is position and velocity; seen to 0.2."""


def coast(state, time_s, step_s, density=0.0):
    F = np.array([[1.0, step_s], [0.0, 1.0]])
    Q = density * np.array([[step_s**3 / 3, step_s**2 / 2], [step_s**2 / 2, step_s]])
    return F @ state, F, Q


def _line(count=9, density=0.0, weights=None, seen=PLACE):
    times_s, start = np.arange(float(count)), np.array([1.0, 0.5])
    return reference_arc(
        partial(coast, density=density), start, times_s, lambda state, k: seen, weights
    )


def test_information_of_a_straight_line():
    arc = _line()
    design = np.column_stack([np.ones(9), np.arange(9.0)])
    prior = np.diag([4.0, 9.0])
    known = expected_uncertainty(arc, prior)
    at_start = np.linalg.inv(design.T @ design / 0.04 + np.linalg.inv(prior))
    F = np.array([[1.0, 8.0], [0.0, 1.0]])
    np.testing.assert_allclose(known.covariance, F @ at_start @ F.T, rtol=1e-9)
    np.testing.assert_allclose(known.sd[-1], np.sqrt(np.diag(known.covariance)))
    # The prior's part of the batch solution: gain times prior times gain.
    part = F @ at_start @ np.linalg.inv(prior) @ at_start @ F.T
    np.testing.assert_allclose(known.covariance_from_prior, part, rtol=1e-7)
    np.testing.assert_allclose(known.prior_part[-1], np.diag(part), rtol=1e-7)


def test_a_state_that_nothing_measures_is_the_priors():
    known = expected_uncertainty(_line(5, seen=np.zeros((0, 2))), np.eye(2))
    np.testing.assert_allclose(known.prior_part, known.sd**2)


def test_a_frame_of_weight_three_is_three_frames():
    once = _line(weights=np.full(9, 3.0))
    thrice = _line(seen=np.tile(PLACE, (3, 1)))
    prior = np.eye(2)
    np.testing.assert_allclose(
        expected_uncertainty(once, prior).sd, expected_uncertainty(thrice, prior).sd, rtol=1e-9
    )


def test_process_noise_and_output_jacobian_enter():
    quiet = expected_uncertainty(_line(), np.eye(2))
    loud = expected_uncertainty(_line(density=0.1), np.eye(2), lambda state: np.array([[0.0, 2.0]]))
    assert loud.sd.shape == (9, 1)
    assert loud.sd[-1, 0] > 2.0 * quiet.sd[-1, 1]
    middle = expected_uncertainty(_line(), np.eye(2), frame=4)
    np.testing.assert_allclose(np.sqrt(np.diag(middle.covariance)), middle.sd[4])


def test_time_to_reach():
    times_s = np.array([5.0, 6.0, 8.0])
    sd = np.array([1.0, 0.1, 0.001])
    assert time_to_reach(times_s, sd, 2.0) == 0.0
    assert time_to_reach(times_s, sd, 0.01) == pytest.approx(2.0)
    assert time_to_reach(times_s, sd, 1e-4) == np.inf


def test_thinned_times_keep_all_frames_weight():
    times_s = 3.0 + 0.1 * np.arange(5000, dtype=np.float64)
    timing = timing_of(times_s, np.array([0.0, 0.05, 0.0]))
    of_arc = timing.weights[: timing.frames]
    assert timing.frames < 400
    assert of_arc.sum() == pytest.approx(5000)
    assert timing.times_s[0] == times_s[0]
    assert timing.times_s[timing.frames - 1] == pytest.approx(times_s[-1])
    assert timing.index(0) == 0
    assert timing.index(timing.frames - 1) == 4999
    assert np.all(np.diff(timing.times_s) * 0.05 <= 0.4 + 1e-9)


RATE = np.radians([5.0, 2.3, 3.5])
PRINTED = np.array([0.85, 1.37, 0.13, 0.17, -0.11])


def _attitude_report(ratios, rate, duration_s=150.0):
    start = RotationState(np.eye(3), rate, parameters_from_printed(np.array(ratios)))
    table = AttitudeInertiaTable(inertia_ratio_sd=0.2, angular_acceleration_psd_rad2_s3=0.0)
    times_s = np.arange(0.0, duration_s, 1.0)
    return observability_of(attitude_subject("test", table, start, times_s))


def test_report_of_a_nutation_and_of_a_spin():
    nutation = _attitude_report(PRINTED, RATE)
    assert nutation.rank.rank == 11
    assert nutation.not_observable == ()
    assert all(np.isfinite(reach.after_s) for reach in nutation.reach)
    spin = _attitude_report([0.85, 1.37, 0.0, 0.0, 0.0], np.radians([0.0, 2.3, 0.0]))
    assert spin.rank.rank == 8
    assert spin.not_observable == ("Jxx/Jzz", "Jyy/Jzz", "Jxz/Jzz")
    reach = {each.name: each.after_s for each in spin.reach}
    assert reach["Jxx/Jzz"] == np.inf
    assert reach["Jxy/Jzz"] < 150.0
    text = " ".join(cell for table in spin.tables() for row in table.rows for cell in row)
    assert "not by this motion" in text
    assert "prior only" in text


def test_expected_sd_of_attitudes_is_that_of_the_fit():
    """The empirical information against numerical derivatives of the whole arc."""
    ratios = parameters_from_printed(PRINTED)
    start = RotationState(np.eye(3), RATE, ratios)
    table = AttitudeInertiaTable(
        inertia_ratio_sd=0.2, attitude_sd_deg=0.5, angular_acceleration_psd_rad2_s3=0.0
    )
    subject = attitude_subject("test", table, start, np.arange(0.0, 40.0, 1.0))
    arc = subject.arc.first(subject.frames)
    step, numerical = 1e-6, np.linalg.inv(subject.prior_covariance)
    information, transition = numerical, np.eye(11)
    sides = [[start.retract(s * step * e) for s in (1.0, -1.0)] for e in np.eye(11)]
    reference = start
    for k, (before, time_s) in enumerate(zip([0.0, *arc.times_s], arc.times_s, strict=False)):
        if k:
            h = time_s - before
            transition = arc.step(k)[0] @ transition
            reference = arc.propagate(reference, before, h)[0]
            sides = [[arc.propagate(s, before, h)[0] for s in pair] for pair in sides]
        H = np.array(
            [(reference.local(a) - reference.local(b))[:3] / (2.0 * step) for a, b in sides]
        ).T
        seen = arc.measured(k) @ transition
        information = information + seen.T @ seen
        numerical = numerical + arc.weights[k] * H.T @ H / np.radians(0.5) ** 2
    scale = np.sqrt(np.diag(information))
    np.testing.assert_allclose(
        numerical / np.outer(scale, scale), information / np.outer(scale, scale), atol=1e-5
    )
    known = expected_uncertainty(arc, subject.prior_covariance, ROTATION.output_jacobian)
    reported = ROTATION.output_jacobian(start)
    covariance = reported @ np.linalg.inv(information) @ reported.T
    # Constants: at the end what they are at the start.
    np.testing.assert_allclose(
        known.sd[-1, INERTIA], np.sqrt(np.diag(covariance))[INERTIA], rtol=1e-6
    )


def _tracks(moments=(1.0, 0.8, 0.6), frames: int = 40) -> tuple[StereoTracks, TargetMotion]:
    rng = np.random.default_rng(2)
    rig = StereoRig(1.0, 1000.0, (511.5, 511.5), (1024, 1024), 0.1)
    orbit = KeplerOrbit(1e-3, 0.0, 0.0)
    seen = np.arange(6, dtype=np.intp)
    looking = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    blank = np.zeros((6, 4))
    tracks = StereoTracks(
        "test", rig, orbit, tuple(TrackFrame(float(t), looking, seen, blank) for t in range(frames))
    )
    state = NavigationState(
        r_hill=np.array([15.0, 0.5, -0.5]),
        v_hill=np.array([0.01, 0.0, 0.01]),
        com_model=np.zeros(3),
        R_world_body=exp_rotation(np.array([0.3, 0.2, -0.1])),
        omega_body=RATE,
        inertia_ratios=ratios_from_inertia(np.diag(moments)),
    )
    points = dict(enumerate(rng.uniform(-1.0, 1.0, (6, 3))))
    motion = TargetMotion(float(frames - 1), state, points)
    return tracks, motion


def test_features_tell_the_principal_ratios_of_a_nutation():
    report = observability_of(principal_subject("test", PrincipalAxesTable(), *_tracks()))
    assert report.not_observable == ()
    by_name = {state.name: state for state in report.states}
    assert by_name["p_x"].posterior_sd < 0.05
    assert report.rank.rank == 11


def test_a_spinning_ball_hides_its_axes_and_its_centre_along_the_spin():
    """The bank believes in an inertia. Of a ball no axis differs; and all points turn about the
    same axis wherever on it the centre lies."""
    tracks, ball = _tracks((1.0, 1.0, 1.0))
    report = observability_of(bank_subject("test", InertiaBankTable(), tracks, ball))
    assert {"attitude x", "attitude y", "attitude z"} <= set(report.not_observable)
    hidden = [each for each in report.weakest if "position" in each.name and not each.known]
    axis = tracks.orbit.R_hill_world(ball.time_s) @ ball.state.R_world_body @ RATE
    axis /= np.linalg.norm(axis) * np.sign(axis[np.argmax(np.abs(axis))])
    (along,) = hidden
    largest = "xyz"[int(np.argmax(np.abs(axis)))]
    assert along.name.split(" + ")[0] == f"{np.max(np.abs(axis)):.2f} position {largest}"
    known = observability_of(bank_subject("test", InertiaBankTable(), *_tracks()))
    worst = {state.name: state.posterior_sd for state in known.states}
    assert worst["attitude x"] < 0.9 * np.radians(5.0)


@pytest.mark.parametrize("moments", [(1.0, 0.8, 0.6), (0.6, 0.8, 1.0), (0.8, 0.6, 1.0)])
def test_the_arc_in_principal_axes_is_the_motion_of_the_body(moments):
    """Whatever the order of the moments: in left-handed axes a free body turns another way."""
    tracks, motion = _tracks(moments)
    later = replace(motion, time_s=0.0)
    subject = principal_subject("test", PrincipalAxesTable(), tracks, later)
    end, times_s = subject.arc.states[subject.frames - 1], np.array([0.0, 39.0])
    assert np.linalg.det(end.R_world_body) == pytest.approx(1.0)
    state, points = motion.state, np.stack(list(motion.points.values()))
    R, omega = rotate_torque_free(state.R_world_body, state.omega_body, np.diag(moments), times_s)
    np.testing.assert_allclose(end.points @ end.R_world_body.T, points @ R[1].T, atol=1e-6)
    np.testing.assert_allclose(end.R_world_body @ end.omega_body, R[1] @ omega[1], atol=1e-7)


def test_measurements_are_whitened():
    state = RotationState(np.eye(3), RATE, parameters_from_printed(PRINTED))
    noise = np.array([[4.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]])
    measured = AttitudeSet(state.R_world_body, noise)
    H = measured.jacobian(state)
    W = whitened(np.concatenate([H, H]), np.stack([noise, noise]))
    np.testing.assert_allclose(W.T @ W, 2.0 * H[0].T @ np.linalg.solve(noise, H[0]), atol=1e-12)
