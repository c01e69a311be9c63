"""Linking pose hypotheses into motions, deciding between them, and the state they give."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform, rotation_angle
from pcnav.dynamics.inertia_parameters import parameter_covariance
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, NavigationState
from pcnav.estimators.depth.first_state import first_state, start_covariance
from pcnav.estimators.depth.motion_hypotheses import (
    Decision,
    MotionHypotheses,
    MotionHypothesis,
    PoseObservation,
)
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.perception.agreement import Agreement
from pcnav.target.mesh_files.reading import MeshOrigin
from pcnav.target.satellite import Target
from pcnav.target.unknown_density import unknown_density

HALF_TURN = make_transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
OMEGA = np.array([0.2, -0.1, 0.3])
START = exp_rotation(np.array([0.4, 1.0, -0.6]))


def target_with(*motions: FloatArray) -> Target:
    """A target 3 m across with these symmetries besides the identity."""
    mesh = trimesh.creation.box((1.0, 2.0, 2.0))
    return Target(
        name="box",
        mesh_path=Path("box.ply"),
        mesh=mesh,
        rectangles=(),
        symmetry_transforms=np.stack([np.eye(4), *motions]),
        mass=unknown_density(mesh),
        mesh_origin=MeshOrigin(len(mesh.faces), 1.0, "assumed"),
    )


def true_pose(k: int, step_s: float = 0.5) -> FloatArray:
    """T_world_model of a body that turns at OMEGA about itself and drifts."""
    R = START @ exp_rotation(OMEGA * step_s * k)
    return make_transform(R, np.array([20.0 + 0.02 * k, 0.5, -0.3]))


def camera_pose(k: int) -> FloatArray:
    """T_cam_world of a camera that turns: links must be made in the world."""
    return make_transform(exp_rotation(np.array([0.1, 0.3 * k, 0.2])), np.array([0.0, 0.1, 0.2]))


def pose(T_cam_model: FloatArray, share: float) -> SingleFramePose:
    """A pose found in a frame of a thousand pixels, of which it explains a share."""
    agreement = Agreement(round(1000 * share), 1000 - round(1000 * share))
    return SingleFramePose(T_cam_model, np.eye(6), agreement, (), (), converged=True)


def feed(
    start: MotionHypotheses, k: int, *alternatives: tuple[FloatArray, float], still: bool = False
) -> Decision | None:
    """Give the frame k with hypotheses: the true pose turned by each motion, and its share."""
    T_cam_world = np.eye(4) if still else camera_pose(k)
    hypotheses = [
        pose(T_cam_world @ true_pose(k) @ motion, share) for motion, share in alternatives
    ]
    hypotheses.sort(key=lambda h: -h.inlier_ratio)
    return start.add(0.5 * k, T_cam_world, tuple(hypotheses))


def follows(motion: MotionHypothesis, turned: FloatArray) -> bool:
    """Whether every observation is the true attitude turned by a motion of the model."""
    angles = [
        rotation_angle((true_pose(round(s.time_s / 0.5)) @ turned)[:3, :3].T @ s.R_world_body)
        for s in motion.observations
    ]
    return bool(np.max(angles) < 1e-6)


def test_the_best_of_two_alternatives_is_followed_although_it_is_not_the_best_of_each_frame() -> (
    None
):
    start = MotionHypotheses(target_with())
    # A half turn away, and better in the second frame alone.
    shares = [(0.9, 0.6), (0.86, 0.88), (0.95, 0.6)]
    decisions = [feed(start, k, (np.eye(4), a), (HALF_TURN, b)) for k, (a, b) in enumerate(shares)]
    assert decisions[:2] == [None, None]
    decision = decisions[2]
    assert decision is not None and not decision.undecided
    assert follows(decision.motion, np.eye(4))
    assert decision.motion.inlier_ratio == pytest.approx((0.9 + 0.86 + 0.95) / 3)
    assert [s.time_s for s in decision.motion.observations] == [0.0, 0.5, 1.0]


def test_a_observation_that_explains_its_frame_badly_is_dropped_from_its_motion() -> None:
    start = MotionHypotheses(target_with())
    for k, share in enumerate((0.7, 0.95, 0.96)):
        assert feed(start, k, (np.eye(4), share)) is None
    decision = feed(start, 3, (np.eye(4), 0.97))
    assert decision is not None
    assert [s.time_s for s in decision.motion.observations] == [0.5, 1.0, 1.5]


def test_a_motion_needs_the_frames_of_its_observations_however_many_it_left_out() -> None:
    """Every other frame explains itself so badly that the motion leaves it out."""
    start = MotionHypotheses(target_with())
    for k in range(24):
        # Too little for a decision: the rival is as good.
        share = 0.95 if k % 2 else 0.7
        feed(start, k, (np.eye(4), share), (HALF_TURN, share))
        best = start.best
        assert best is not None
        assert {s.time_s for s in best.observations} <= start.times_s
    assert best is not None
    assert 0.5 * 23 - best.observations[0].time_s > 0.5 * (len(best.observations) - 1)


def test_equal_alternatives_are_told_ambiguous_after_ten_frames() -> None:
    start = MotionHypotheses(target_with())
    for k in range(9):
        assert feed(start, k, (np.eye(4), 0.900), (HALF_TURN, 0.899)) is None
    decision = feed(start, 9, (np.eye(4), 0.900), (HALF_TURN, 0.899))
    assert decision is not None and decision.undecided
    assert follows(decision.motion, np.eye(4))
    assert len(decision.motion.observations) == 10


@pytest.mark.parametrize(("fewer_conflicts", "decides"), [(11, False), (13, True)])
def test_a_lead_of_nine_nats_decides(fewer_conflicts: int, decides: bool) -> None:
    """A quarter of a nat for each pixel against a motion: in 3 frames 12 pixels each make 9."""
    start = MotionHypotheses(target_with())
    worse = 0.9 - fewer_conflicts / 1000
    for k in range(2):
        assert feed(start, k, (np.eye(4), 0.9), (HALF_TURN, worse)) is None
    decision = feed(start, 2, (np.eye(4), 0.9), (HALF_TURN, worse))
    assert (decision is not None) == decides
    assert decision is None or not decision.undecided


def test_a_motion_weighs_by_the_pixels_it_explains_in_its_last_frames() -> None:
    shares = (0.9, 0.8, 0.95)
    observations = tuple(
        PoseObservation(0.5 * k, camera_pose(k), pose(camera_pose(k) @ true_pose(k), share))
        for k, share in enumerate(shares)
    )
    motion = MotionHypothesis(observations)
    assert motion.inlier_ratio == pytest.approx(np.mean(shares))
    weights = [motion.log_weight(frames) for frames in (1, 2, 3)]
    assert weights == pytest.approx([0.25 * n for n in (950, 1750, 2650)])


def test_a_doubt_that_resolves_is_decided_then() -> None:
    start = MotionHypotheses(target_with())
    for k in range(4):
        assert feed(start, k, (np.eye(4), 0.9), (HALF_TURN, 0.9)) is None
    decision = feed(start, 4, (np.eye(4), 0.95), (HALF_TURN, 0.5))
    assert decision is not None and not decision.undecided
    assert follows(decision.motion, np.eye(4))


def test_alternatives_that_the_symmetry_makes_equal_need_no_waiting() -> None:
    start = MotionHypotheses(target_with(HALF_TURN))
    for k in range(2):
        assert feed(start, k, (np.eye(4), 0.9), (HALF_TURN, 0.9)) is None
    decision = feed(start, 2, (np.eye(4), 0.9), (HALF_TURN, 0.9))
    assert decision is not None and not decision.undecided
    assert follows(decision.motion, np.eye(4)) or follows(decision.motion, HALF_TURN)


def test_another_alternative_of_a_symmetric_target_is_a_doubt_all_the_same() -> None:
    start = MotionHypotheses(target_with(HALF_TURN))
    other = make_transform(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))
    for k in range(5):
        assert feed(start, k, (np.eye(4), 0.9), (HALF_TURN, 0.9), (other, 0.9)) is None


def test_poor_explanations_are_not_believed() -> None:
    start = MotionHypotheses(target_with())
    for k in range(12):
        assert feed(start, k, (np.eye(4), 0.45)) is None


def test_frames_without_hypotheses_are_passed_over() -> None:
    start = MotionHypotheses(target_with())
    assert feed(start, 0, (np.eye(4), 0.9)) is None
    assert feed(start, 1) is None
    assert feed(start, 2, (np.eye(4), 0.9)) is None
    decision = feed(start, 3, (np.eye(4), 0.9))
    assert decision is not None
    assert [s.time_s for s in decision.motion.observations] == [0.0, 1.0, 1.5]


def test_a_broken_link_starts_over() -> None:
    for jump in (
        make_transform(exp_rotation(np.array([0.0, 0.9, 0.0])), np.zeros(3)),
        make_transform(np.eye(3), np.array([0.0, 1.2, 0.0])),  # over 0.3 diameters
    ):
        start = MotionHypotheses(target_with())
        assert feed(start, 0, (np.eye(4), 0.9), still=True) is None
        assert feed(start, 1, (np.eye(4), 0.9), still=True) is None
        assert feed(start, 2, (jump, 0.9), still=True) is None
        assert feed(start, 3, (jump, 0.9), still=True) is None
        decision = feed(start, 4, (jump, 0.9), still=True)
        assert decision is not None
        assert [s.time_s for s in decision.motion.observations] == [1.0, 1.5, 2.0]


def test_attitude_is_predicted_at_the_last_rate() -> None:
    observations = tuple(
        PoseObservation(0.5 * k, camera_pose(k), pose(camera_pose(k) @ true_pose(k), 0.9))
        for k in range(3)
    )
    ahead = MotionHypothesis(observations).predicted_attitude(3.5)
    np.testing.assert_allclose(ahead, true_pose(7)[:3, :3], atol=1e-12)
    alone = MotionHypothesis(observations[:1]).predicted_attitude(3.5)
    np.testing.assert_allclose(alone, true_pose(0)[:3, :3], atol=1e-12)


@pytest.mark.parametrize("mean_motion_rad_s", [0.0, 1e-3])
def test_first_state_of_exact_observations_is_the_true_one(mean_motion_rad_s: float) -> None:
    com, ratios = np.array([0.1, -0.2, 0.05]), np.array([1.0, 1.0, 0.0, 0.0, 0.0])
    # The mass centre moves along a straight line in turning Hill axes, the body turns steadily.
    r0, v = np.array([20.0, 0.5, -0.3]), np.array([0.02, -0.01, 0.03])
    observations = []
    for k in range(4):
        t = 5.0 + 0.5 * k
        R_hill = R_hill_world(t, mean_motion_rad_s)
        R = START @ exp_rotation(OMEGA * 0.5 * k)
        state = NavigationState(r0 + 0.5 * k * v, v, com, R, OMEGA, ratios)
        T = state.T_cam_model(camera_pose(k), R_hill)
        observations.append(PoseObservation(t, camera_pose(k), pose(T, 0.9)))
    found = first_state(MotionHypothesis(tuple(observations)), com, ratios, mean_motion_rad_s)
    expected = NavigationState(r0, v, com, START, OMEGA, ratios)
    np.testing.assert_allclose(expected.local(found), 0.0, atol=1e-10)


def test_prior_keeps_what_is_known_of_the_mass_and_leaves_the_rest_to_the_data() -> None:
    com_sd, ratios_sd = np.array([0.1, 0.2, 0.3]), np.linspace(0.01, 0.05, 5)
    inertia = parameter_covariance(np.array([0.8, 1.1, 0.02, -0.03, 0.01]), ratios_sd)
    P = start_covariance(np.zeros(3), np.diag(com_sd**2), inertia)
    np.testing.assert_allclose(np.diag(P)[COM_MODEL], com_sd**2)
    np.testing.assert_array_equal(P[INERTIA_RATIOS, INERTIA_RATIOS], inertia)
    P[INERTIA_RATIOS, INERTIA_RATIOS] = np.eye(5)
    np.testing.assert_array_equal(P, np.diag(np.diag(P)))
    assert np.all(np.sqrt(np.diag(P)[OMEGA_BODY]) >= 0.5)


def test_of_alternatives_with_one_attitude_the_near_one_is_linked() -> None:
    # Two equal wings: the same attitude, the target a wing's distance away.
    aside = make_transform(np.eye(3), np.array([0.0, 4.0, 0.0]))
    start = MotionHypotheses(target_with())
    decisions = []
    for k in range(3):
        pair = [(np.eye(4), 0.9), (aside, 0.7)]
        decisions.append(feed(start, k, *(pair if k % 2 else pair[::-1])))
    assert decisions[2] is not None
    assert follows(decisions[2].motion, np.eye(4))
    steps = np.diff([s.p_world_model for s in decisions[2].motion.observations], axis=0)
    assert np.linalg.norm(steps, axis=1).max() < 0.1


def test_the_right_motion_may_begin_after_a_wrong_one_that_goes_on() -> None:
    start = MotionHypotheses(target_with())
    for k in range(3):
        assert feed(start, k, (HALF_TURN, 0.3)) is None
    decision = None
    for k in range(3, 6):
        assert decision is None
        decision = feed(start, k, (np.eye(4), 0.9), (HALF_TURN, 0.3))
    assert decision is not None
    assert follows(decision.motion, np.eye(4))


def test_what_explains_its_frame_is_linked_rather_than_what_lies_nearest() -> None:
    # As where few pixels are seen: a turn of ten degrees explains nearly as much.
    near = make_transform(exp_rotation(np.array([0.17, 0.0, 0.0])), np.zeros(3))
    start = MotionHypotheses(target_with())
    decisions = []
    for k in range(3):
        true_alone = [(np.eye(4), 0.9)]
        decisions.append(feed(start, k, *([*true_alone, (near, 0.88)] if k else true_alone)))
    decision = decisions[-1]
    assert decision is not None and follows(decision.motion, np.eye(4))


def test_odds_of_a_long_motion_are_those_of_all_its_frames() -> None:
    """Of frames of sixty pixels ten are not enough, fifteen are."""
    start = MotionHypotheses(target_with())
    begun = []
    for k in range(20):
        found = Agreement(60, 0)
        T_cam_world = camera_pose(0)
        T_cam_model = T_cam_world @ true_pose(k, 0.2)
        seen = SingleFramePose(T_cam_model, np.eye(6), found, (), (), converged=True)
        decision = start.add(0.2 * k, T_cam_world, (seen,))
        if decision is not None:
            begun.append(k)
            assert len(decision.motion.observations) == 10
    assert begun and 10 < begun[0] < 19


def observed(steps: list[float], off: dict[int, FloatArray]) -> MotionHypothesis:
    """Poses of the body at these steps; of some, moved by an error (6,)."""
    found = []
    for k, step in enumerate(steps):
        T = true_pose(0, 0.0)
        T[:3, :3] = START @ exp_rotation(0.5 * OMEGA * step)
        T[:3, 3] += np.array([0.02 * step, 0.0, 0.0])
        error = off.get(k, np.zeros(6))
        T[:3, 3] += error[:3]
        T[:3, :3] = T[:3, :3] @ exp_rotation(error[3:])
        found.append(PoseObservation(0.5 * step, np.eye(4), pose(T, 0.95)))
    return MotionHypothesis(tuple(found))


STEPS = [0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 11.0]
"""Frames were left out."""


@pytest.mark.parametrize("error", [np.r_[0.0, 0.1, 0.0, 0, 0, 0], np.r_[np.zeros(3), 0, 0.2, 0]])
def test_an_observation_off_the_way_is_left_out(error: FloatArray) -> None:
    rng = np.random.default_rng(3)
    noise = {k: 0.001 * rng.standard_normal(6) for k in range(len(STEPS))}
    motion = observed(STEPS, noise | {5: error})
    kept = motion.without_strays(3.0).observations
    assert [s.time_s for s in kept] == [0.5 * step for step in STEPS if step != STEPS[5]]
    assert len(observed(STEPS, noise).without_strays(3.0).observations) == len(STEPS)


def test_a_motion_that_sways_has_no_strays() -> None:
    """Each frame lies off the way of its neighbours, and none more than the others."""
    sway = {k: np.r_[0.1 * np.sin(1.5 * k), np.zeros(5)] for k in range(len(STEPS))}
    motion = observed(STEPS, sway)
    assert len(motion.without_strays(3.0).observations) == len(STEPS)
    few = observed(STEPS[:4], {2: np.r_[0.5, np.zeros(5)]})
    assert len(few.without_strays(3.0).observations) == 4


def shares(motion: MotionHypothesis, ratios: dict[int, float]) -> MotionHypothesis:
    """The motion with poses that explain other shares of their frames."""
    for k, ratio in ratios.items():
        motion = motion.with_pose(k, pose(motion.observations[k].T_cam_model, ratio))
    return motion


def test_fits_that_fall_short_are_looked_for_between_those_that_do_not() -> None:
    turned = {k: np.r_[np.zeros(5), 0.06] for k in (2, 3)}
    motion = shares(observed(STEPS[:6], turned), {2: 0.85, 3: 0.86, 5: 0.85})
    found = dict(motion.short_of())
    # After the last one nothing follows to tell where it should be.
    assert sorted(found) == [2, 3]
    right = observed(STEPS[:6], {})
    for k, T_cam_model in found.items():
        np.testing.assert_allclose(T_cam_model, right.observations[k].T_cam_model, atol=1e-6)


def test_of_shares_that_chance_makes_none_falls_short() -> None:
    assert shares(observed(STEPS[:6], {}), {2: 0.94, 4: 0.945}).short_of() == []


def test_a_motion_that_one_fit_left_behind_is_decided_on_once_it_was_mended() -> None:
    """Two motions, of which the wrong one explains a little less in every frame, and the right one
    much less in one: there its fit had been given up."""
    right, wrong = observed(STEPS[:4], {}), observed(STEPS[:4], {})
    half = {k: o.T_cam_model @ HALF_TURN for k, o in enumerate(wrong.observations)}
    for k, T_cam_model in half.items():
        wrong = wrong.with_pose(k, pose(T_cam_model, 0.91))
    right = shares(right, {1: 0.8})
    hypotheses = MotionHypotheses(target_with())
    decision: Decision | None = None
    for a, b in zip(right.observations, wrong.observations, strict=True):
        both = sorted([a.pose, b.pose], key=lambda found: -found.inlier_ratio)
        decision = hypotheses.add(a.time_s, a.T_cam_world, both)

    def looked(motion: MotionHypothesis) -> MotionHypothesis:
        for k, T_cam_model in motion.short_of():
            motion = motion.with_pose(k, pose(T_cam_model, 0.95))
        return motion

    decision = hypotheses.looked_again(0.0, looked)
    assert decision is not None and not decision.undecided
    last = decision.motion.observations[-1]
    assert rotation_angle(last.R_world_body.T @ right.observations[-1].R_world_body) < 1e-6
    assert decision.motion.observations[1].pose.inlier_ratio == pytest.approx(0.95)
