"""The chain of attitudes: exact without noise, true covariances, key frames, rates, translation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from pcnav.config.image_motion import ImageMotionTable, MatchSolver, Reference, Smoothing
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform, rotation_angle
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.image_motion.chain import ChainFrame, run_chain
from pcnav.estimators.image_motion.rates import (
    continuous_xyzw,
    differences,
    local_polynomial,
    rotation_history,
)
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.estimators.image_motion.translation import (
    Known,
    RelativeView,
    Verdict,
    translation,
)
from pcnav.recordings.tracks import MonocularTracks, TrackFrame
from pcnav.simulation.images import ImageMotion, TrackFaults, monocular_tracks
from pcnav.simulation.motion import rotate_torque_free

CAMERA = PinholeCamera(2048, 2048, 2909.0, 2909.0, 1024.0, 1024.0)
ADJACENT = ImageMotionTable(reference=Reference.ADJACENT)
KEY_FRAMES = ImageMotionTable(reference=Reference.KEY_FRAME)
INERTIA = np.diag([1.0, 2.0, 2.4])


def scene(
    seed: int,
    faults: TrackFaults,
    frames: int = 12,
    interval_s: float = 4.0,
    R_cam_world: FloatArray | None = None,
    places_m: FloatArray | None = None,
) -> tuple[MonocularTracks, ImageMotion, FloatArray, FloatArray]:
    """Tracks, motion, and the true attitudes and rates."""
    rng = np.random.default_rng(seed)
    times_s: FloatArray = np.arange(frames, dtype=np.float64) * interval_s
    omega: FloatArray = np.asarray(np.deg2rad([1.0, 0.4, -0.3]), dtype=np.float64)
    R, rates = rotate_torque_free(np.eye(3), omega, INERTIA, times_s)
    normals = rng.standard_normal((80, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = normals * [2.5, 2.0, 1.5]
    at_rest = np.broadcast_to(np.eye(3), (frames, 3, 3))
    attitude = at_rest if R_cam_world is None else R_cam_world
    places = np.broadcast_to([0.0, 0.0, 30.0], (frames, 3)) if places_m is None else places_m
    poses = make_transform(attitude @ R, places)
    truth = Trajectory(times_s, POSE_LAYOUT, T_cam_target=poses)
    motion = ImageMotion(truth, attitude, np.ones(3))
    tracks = monocular_tracks(CAMERA, motion, (points, normals), faults, rng)
    return tracks, motion, R, rates


def errors(frames: tuple[ChainFrame, ...], R: FloatArray) -> FloatArray:
    """(n, 3) theta of the frames after the first, nan where there is no attitude."""
    found = np.full((len(frames), 3), np.nan)
    for k, frame in enumerate(frames):
        if frame.R_world_body is not None:
            found[k] = log_rotation(frame.R_world_body.T @ R[k])
    return found[1:]


@pytest.mark.parametrize("settings", [ADJACENT, KEY_FRAMES])
def test_exact_matches_give_the_exact_attitude(settings: ImageMotionTable) -> None:
    tracks, _, R, _ = scene(1, TrackFaults())
    frames = run_chain(tracks, settings)
    assert frames[0].outcome is Outcome.FIRST
    assert all(frame.outcome is Outcome.MEASURED for frame in frames[1:])
    assert np.abs(errors(frames, R)).max() < 1e-9


def test_the_chasers_own_attitude_is_taken_out() -> None:
    turns = 0.02 * np.arange(12)[:, None] * np.array([0.3, -0.5, 1.0])
    R_cam_world = exp_rotation(turns)
    tracks, _, R, rates = scene(2, TrackFaults(), R_cam_world=R_cam_world)
    frames = run_chain(tracks, KEY_FRAMES)
    assert np.abs(errors(frames, R)).max() < 1e-9
    history = rotation_history(frames, ImageMotionTable(smoothing=Smoothing.NONE))
    # Inertial rates: the camera's own rate is not in them.
    assert history.omega_body[1:-1] == pytest.approx(rates[1:-1], abs=1e-3)
    assert history.R_cam_body == pytest.approx(R_cam_world @ R, abs=1e-9)


@pytest.mark.parametrize("settings", [ADJACENT, KEY_FRAMES])
def test_the_covariance_of_a_chain_is_true(settings: ImageMotionTable) -> None:
    """Pairs share the noise of the frame between them: taken as independent, the error of the
    attitude would be overstated by the number of pairs."""
    squared, alone, count = [], 0.0, 0
    for seed in range(24):
        tracks, _, R, _ = scene(seed, TrackFaults(0.1), frames=7)
        frames = run_chain(tracks, settings)
        last = frames[-1]
        if last.covariance is None or last.segment:
            continue
        theta = errors(frames, R)[-1]
        squared.append(theta @ np.linalg.solve(last.covariance, theta))
        parts = [f.relative.covariance for f in frames if f.relative is not None]
        alone += sum(float(np.trace(part)) for part in parts if part is not None)
        count += 1
    degrees = 3 * len(squared)
    assert count >= 20
    assert chi2.ppf(0.001, degrees) < sum(squared) < chi2.ppf(0.999, degrees)
    if settings.reference is Reference.ADJACENT:
        assert alone / count > 2.0 * float(np.trace(last.covariance))  # type: ignore[arg-type]


@pytest.mark.study
def test_key_frames_reduce_the_drift() -> None:
    every = ADJACENT.model_copy(
        update={"min_significance": 0.0, "ambiguous_chi_square": 0.0, "max_sd_deg": 180.0}
    )
    rms, share = {}, {}
    for name, settings in (("every", every), ("certain", ADJACENT), ("key", KEY_FRAMES)):
        found = []
        for seed in range(3):
            tracks, _, R, _ = scene(seed, TrackFaults(0.3), frames=21, interval_s=1.5)
            found.append(errors(run_chain(tracks, settings), R))
        rms[name] = np.sqrt(np.nanmean(np.square(found)[:, -8:]))
        share[name] = np.isfinite(found).mean()
    assert rms["key"] < 0.7 * rms["every"]
    # Waiting until a turn is certain does not drift either, but leaves gaps.
    assert share["key"] > 0.8 > 0.7 > share["certain"]


def test_frames_without_an_attitude_say_why() -> None:
    tracks, _, R, _ = scene(3, TrackFaults(0.1))
    frames = list(tracks.frames)
    nothing = TrackFrame(frames[4].time_s, np.eye(3), np.zeros(0, dtype=np.intp), np.zeros((0, 2)))
    # A picture sent twice: the same pixels at a later time.
    frames[4] = nothing
    frames[7] = replace(frames[6], time_s=frames[7].time_s)
    found = run_chain(replace(tracks, frames=tuple(frames)), ADJACENT)
    assert found[4].outcome is Outcome.FEW_MATCHES and found[4].R_world_body is None
    assert found[7].outcome is Outcome.NO_MOTION and found[7].covariance is None
    # The chain goes on from the last attitude.
    assert found[5].reference == 3 and found[8].reference == 6
    assert np.nanmax(np.abs(errors(found, R))) < np.deg2rad(2.0)
    assert all(frame.segment == 0 for frame in found)


def test_a_chain_that_lost_all_features_begins_anew() -> None:
    tracks, _, R, _ = scene(4, TrackFaults())
    frames = [
        replace(frame, features=frame.features + (1000 if k >= 6 else 0))
        for k, frame in enumerate(tracks.frames)
    ]
    found = run_chain(replace(tracks, frames=tuple(frames)), KEY_FRAMES)
    assert [frame.segment for frame in found] == [0] * 6 + [1] * 6
    assert found[6].outcome is Outcome.FIRST
    # From its own start each segment is right.
    later = found[-1].R_world_body
    assert later is not None
    assert rotation_angle((R[-1] @ R[6].T).T @ later) < 1e-9


def test_a_rotation_far_from_the_rate_is_not_believed() -> None:
    tracks, _, _, _ = scene(5, TrackFaults(0.1))
    frames = list(tracks.frames)
    # A target that all at once has turned 40 degrees is one whose features were mixed up.
    far = scene(5, TrackFaults(0.1), frames=30)[0].frames[20]
    frames[6] = replace(far, time_s=frames[6].time_s)
    found = run_chain(replace(tracks, frames=tuple(frames)), ADJACENT)
    assert found[6].R_world_body is None
    assert found[7].reference == 5 and found[7].outcome is Outcome.MEASURED


def test_the_printed_chain_answers_always() -> None:
    printed = ImageMotionTable(solver=MatchSolver.EIGHT_POINT, reference=Reference.ADJACENT)
    tracks, _, R, _ = scene(6, TrackFaults())
    assert np.abs(errors(run_chain(tracks, printed), R)).max() < 1e-7
    noisy = run_chain(scene(6, TrackFaults(0.5))[0], printed)
    assert all(frame.R_world_body is not None for frame in noisy)


def test_rates_by_differences_and_by_polynomials() -> None:
    times_s = np.arange(0.0, 20.0, 0.5)
    omega = np.deg2rad(np.array([3.0, 1.0, -2.0]))
    R, rates = rotate_torque_free(np.eye(3), omega, INERTIA, times_s)
    assert differences(times_s, R)[1:-1] == pytest.approx(rates[1:-1], abs=1e-5)
    smooth, fitted = local_polynomial(times_s, R, 7, 3)
    assert fitted == pytest.approx(rates, abs=1e-6)
    assert rotation_angle(np.swapaxes(smooth, 1, 2) @ R).max() < 1e-5
    noise = exp_rotation(1e-3 * np.random.default_rng(7).standard_normal((len(times_s), 3)))
    plain = differences(times_s, R @ noise) - rates
    fitted = local_polynomial(times_s, R @ noise, 9, 2)[1] - rates
    assert np.std(fitted[4:-4]) < 0.5 * np.std(plain[4:-4])


def test_quaternions_are_continuous() -> None:
    angles = np.linspace(0.1, 6.0, 50)
    R = exp_rotation(angles[:, None] * np.array([0.0, 0.6, 0.8]))
    quaternions = continuous_xyzw(R)
    assert np.sum(quaternions[1:] * quaternions[:-1], axis=1).min() > 0.9
    assert Rotation.from_quat(quaternions).as_matrix() == pytest.approx(R)


FIRST, SECOND = np.array([1.0, -2.0, 30.0]), np.array([1.5, -1.0, 28.0])
R_TURN = exp_rotation(np.array([0.2, -0.1, 0.15]))
R_CAMERAS = exp_rotation(np.array([0.01, 0.02, -0.01]))


def view(second: FloatArray = SECOND, cameras: FloatArray = R_CAMERAS) -> RelativeView:
    t = second - R_TURN @ FIRST
    return RelativeView(R_TURN, t / np.linalg.norm(t), cameras)


def known(names: str, second: FloatArray = SECOND) -> Known:
    """Known quantities by letter: d, e directions; r, s ranges; l the length of t."""
    values = {
        "d": ("direction_first", FIRST / np.linalg.norm(FIRST)),
        "e": ("direction_second", second / np.linalg.norm(second)),
        "r": ("range_first_m", float(np.linalg.norm(FIRST))),
        "s": ("range_second_m", float(np.linalg.norm(second))),
        "l": ("length_m", float(np.linalg.norm(second - R_TURN @ FIRST))),
    }
    return Known(**dict(values[name] for name in names))


@pytest.mark.parametrize("names", ["dres", "drl", "esl", "der", "des", "del", "derl"])
def test_enough_is_known_for_the_translation(names: str) -> None:
    answer = translation(view(), known(names))
    assert answer.verdict is Verdict.FOUND
    assert answer.places[0].first_m == pytest.approx(FIRST)
    assert answer.places[0].second_m == pytest.approx(SECOND)
    assert answer.places[0].displacement_m == pytest.approx(R_CAMERAS.T @ SECOND - FIRST)


def test_directions_alone_give_the_direction_of_the_displacement() -> None:
    answer = translation(view(), known("de"))
    assert answer.verdict is Verdict.DIRECTION_ONLY and "range" in answer.missing
    scale = float(np.linalg.norm(FIRST))
    assert scale * answer.places[0].displacement_m == pytest.approx(R_CAMERAS.T @ SECOND - FIRST)


@pytest.mark.parametrize("names", ["drs", "ers"])
def test_ranges_and_one_direction_have_one_or_two_answers(names: str) -> None:
    answer = translation(view(), known(names))
    assert answer.verdict in (Verdict.FOUND, Verdict.TWO_ANSWERS)
    assert min(np.linalg.norm(each.second_m - SECOND) for each in answer.places) < 1e-9


def test_what_is_missing_is_said() -> None:
    assert translation(view(), known("rs")).verdict is Verdict.OPEN
    assert "direction" in translation(view(), known("rs")).missing
    moving = translation(view(), known("d"))
    assert moving.verdict is Verdict.MOVES and moving.missing and not moving.places
    # A target that only rotates: seen by a camera that turns, it stays where it is.
    still = translation(view(R_CAMERAS @ FIRST), known("d"))
    assert still.verdict is Verdict.OPEN
    assert translation(view(R_CAMERAS @ FIRST), known("e", R_CAMERAS @ FIRST)).verdict is (
        Verdict.OPEN
    )
    backwards = replace(known("der"), direction_second=-SECOND / np.linalg.norm(SECOND))
    assert translation(view(), backwards).verdict is Verdict.CONTRADICTION
    # Out of the plane of the first direction and the motion: the rays never meet.
    side = np.cross(view().R_second_first @ FIRST, view().direction)
    aside = SECOND / np.linalg.norm(SECOND) + 0.1 * side / np.linalg.norm(side)
    apart = replace(known("der"), direction_second=aside / np.linalg.norm(aside))
    assert translation(view(), apart).verdict is Verdict.CONTRADICTION
    short = replace(known("drs"), range_second_m=0.1)
    assert translation(view(), short).verdict is Verdict.CONTRADICTION
