"""Cramer-Rao bounds against the whole information matrix of a problem, and by hand."""

from functools import partial

import numpy as np
import pytest

from pcnav.config.depth import FilterTable, ModalityName
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.scenario import BodyTable, OrbitTable, ScenarioTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import pixel_rays
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    STATE_SIZE,
    NavigationState,
)
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.evaluation.bound import (
    PosteriorBound,
    SceneBound,
    compared,
    informed,
    of_rays,
    pose_jacobian,
    predicted,
    prior_covariance,
)
from pcnav.evaluation.ray_information import ray_information
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import TrueMotion, true_motion
from pcnav.simulation.random_truth import satellite
from pcnav.target.rendering import DepthRenderer

MEAN_MOTION = 0.0011


@pytest.fixture(scope="module")
def motion() -> TrueMotion:
    return true_motion(
        Pipeline(
            scenario=ScenarioTable(frames=8, frame_rate_hz=2.0),
            orbit=OrbitTable(mean_motion_rad_s=MEAN_MOTION, v_hill_m_s=(0.01, -0.02, 0.005)),
            body=BodyTable(
                attitude_rotvec_deg=(20.0, -40.0, 70.0),
                omega_body_deg_s=(2.0, -1.0, 3.0),
                com_model_m=(0.1, -0.2, 0.15),
                inertia_ratios=(0.6, 0.8, -0.02, 0.06, -0.04),
            ),
        )
    )


def positive(size: int, generator: np.random.Generator, rank: int | None = None) -> FloatArray:
    root = generator.standard_normal((size, size if rank is None else rank))
    return np.asarray(root @ root.T)


def test_pose_jacobian_is_the_derivative_of_the_pose_error(motion: TrueMotion) -> None:
    state, k = motion.state(5), 5
    H = pose_jacobian(state, motion.T_cam_world[k], motion.R_hill_world[k])

    def pose(of: NavigationState) -> FloatArray:
        return of.T_cam_model(motion.T_cam_world[k], motion.R_hill_world[k])

    step = 1e-6
    for column, unit in enumerate(np.eye(STATE_SIZE)):
        ahead, behind = pose(state.retract(step * unit)), pose(state.retract(-step * unit))
        shift = (ahead[:3, 3] - behind[:3, 3]) / (2.0 * step)
        turn = log_rotation(behind[:3, :3].T @ ahead[:3, :3]) / (2.0 * step)
        slope = np.concatenate([shift, turn])
        np.testing.assert_allclose(H[:, column], slope, atol=1e-8)


def test_recursion_is_the_last_block_of_the_whole_information_matrix() -> None:
    """Linear: the joint information of all states at all times, inverted in one piece."""
    n, frames = 4, 6
    generator = np.random.default_rng(3)
    F = [np.eye(n) + 0.3 * generator.standard_normal((n, n)) for _ in range(frames - 1)]
    Q = [0.1 * positive(n, generator) for _ in range(frames - 1)]
    H = [generator.standard_normal((3, n)) for _ in range(frames)]
    # Some frames say nothing of a direction, one nothing at all.
    information = [positive(3, generator, rank) for rank in (2, 3, 1, 0, 3, 2)]
    prior = positive(n, generator)
    joint = np.zeros((n * frames, n * frames))
    joint[:n, :n] = np.linalg.inv(prior)
    for k in range(frames):
        here = slice(n * k, n * (k + 1))
        joint[here, here] += H[k].T @ information[k] @ H[k]
        if k > 0:
            before = slice(n * (k - 1), n * k)
            link = np.zeros((n, n * frames))
            link[:, here], link[:, before] = np.eye(n), -F[k - 1]
            joint += link.T @ np.linalg.inv(Q[k - 1]) @ link
    whole = np.linalg.inv(joint)[-n:, -n:]
    P = informed(prior, H[0], information[0])
    for k in range(1, frames):
        P = informed(predicted(P, F[k - 1], Q[k - 1]), H[k], information[k])
    np.testing.assert_allclose(P, whole, rtol=1e-9)


def test_bound_of_a_motion_is_the_information_gathered_along_it(motion: TrueMotion) -> None:
    """Without process noise all information can be carried back to the first frame and summed."""
    generator = np.random.default_rng(5)
    given = [1e4 * positive(6, generator, 5) for _ in range(len(motion))]
    prior = prior_covariance(satellite("boxsat").target.mass)
    model = MassCentreModel(MEAN_MOTION, 0.0, 0.0)
    bound = PosteriorBound(model, motion, prior)
    found = [bound.step(partial(lambda known, covariance: known, each)) for each in given]
    gathered, carried = np.linalg.inv(prior), np.eye(STATE_SIZE)
    for k in range(len(motion)):
        state = motion.state(k)
        if k > 0:
            before = float(motion.truth.time_s[k - 1])
            step = float(motion.truth.time_s[k]) - before
            _, transition, _ = model.propagate(motion.state(k - 1), before, step)
            carried = transition @ carried
        H = pose_jacobian(state, motion.T_cam_world[k], motion.R_hill_world[k]) @ carried
        gathered = gathered + H.T @ given[k] @ H
        if k in (0, len(given) - 1):
            expected = carried @ np.linalg.inv(gathered) @ carried.T
            scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
            np.testing.assert_allclose(found[k] / scale, expected / scale, atol=1e-5)


def test_frames_are_asked_with_what_the_prediction_leaves_open(motion: TrueMotion) -> None:
    prior = prior_covariance(satellite("boxsat").target.mass)
    model = MassCentreModel(MEAN_MOTION, 1e-6, 1e-6)
    asked: list[FloatArray] = []

    def information(k: int, pose_covariance: FloatArray) -> FloatArray:
        asked.append(pose_covariance)
        return np.zeros((6, 6)) if k % 2 else 1e6 * np.eye(6)

    bound = PosteriorBound(model, motion, prior)
    bounds = [bound.step(partial(information, k)) for k in range(len(motion))]
    assert len(asked) == len(motion)
    sd = [np.sqrt(np.diag(covariance)) for covariance in asked]
    assert sd[0][:3] == pytest.approx(10.0, rel=0.02) and sd[0][3:] == pytest.approx(2.0)
    seen, unseen = (np.trace(bounds[k]) for k in (6, 7))
    assert unseen > seen
    # A frame of 1 mm and 1 mrad leaves no pose less certain than that.
    assert np.all(sd[-1] < 0.1)
    H = pose_jacobian(motion.state(6), motion.T_cam_world[6], motion.R_hill_world[6])
    assert np.all(np.diag(H @ bounds[6] @ H.T) < 1.0001e-6)


def test_a_turn_that_is_known_leaves_no_doubt_of_the_lever() -> None:
    """By hand: a fixed body whose origin is seen has its mass centre along with the position."""
    state = NavigationState(
        r_hill=np.array([20.0, 0.0, 0.0]),
        v_hill=np.zeros(3),
        com_model=np.array([0.0, 0.0, 0.5]),
        R_world_body=exp_rotation(np.array([0.0, 0.0, np.pi / 2])),
        omega_body=np.zeros(3),
        inertia_ratios=np.array([1.0, 1.0, 0.0, 0.0, 0.0]),
    )
    H = pose_jacobian(state, np.eye(4), np.eye(3))
    # A turn about body x moves the origin, at -0.5 z of the mass centre, along body y: world -x.
    turned = H @ np.eye(STATE_SIZE)[9]
    np.testing.assert_allclose(turned, [-0.5, 0.0, 0.0, 1.0, 0.0, 0.0], atol=1e-12)


def test_prior_is_the_target_s() -> None:
    mass = satellite("boxsat").target.mass
    prior = prior_covariance(mass)
    np.testing.assert_array_equal(prior[INERTIA_RATIOS, INERTIA_RATIOS], mass.parameter_covariance)
    np.testing.assert_array_equal(prior[COM_MODEL, COM_MODEL], mass.com_covariance_m2)


def test_bound_of_a_scene_takes_the_prior_of_its_pipeline() -> None:
    """A narrower prior leaves a tighter bound: what the tracker is told, the bound is told."""
    of = satellite("boxsat")
    stds = []
    for table in (FilterTable(), FilterTable(com_sd_m=0.01, inertia_ratio_sd=0.02)):
        scenario = of.pipeline.scenario.model_copy(update={"frames": 1})
        changed = {"filter": table, "scenario": scenario}
        scene = Scene.of(of.pipeline.model_copy(update=changed), of.target.mesh)
        P = SceneBound(scene, of.target, compared(scene, of.target)).step(next(iter(scene)))
        stds.append(np.sqrt(np.diag(P)))
    assert np.all(stds[1][COM_MODEL] < 0.0101) and np.all(stds[0][COM_MODEL] > 0.1)
    assert np.all(stds[1][INERTIA_RATIOS] < 0.05) and np.all(stds[0][INERTIA_RATIOS] > 0.1)


@pytest.fixture(scope="module")
def oblique() -> Scene:
    """One frame of boxsat by ranges alone."""
    of = satellite("boxsat")
    pipeline = of.pipeline.model_copy(
        update={
            "scenario": of.pipeline.scenario.model_copy(update={"frames": 1}),
            "perception": of.pipeline.perception.model_copy(
                update={"modalities": (ModalityName.RANGES,)}
            ),
        }
    )
    return Scene.of(pipeline, of.target.mesh)


def test_information_of_rays_is_that_of_ranges_moved_with_the_pose(oblique: Scene) -> None:
    """Numerically: rays cast at poses on both sides, where they meet the same triangle."""
    target, camera = satellite("boxsat").target, oblique.pipeline.camera.pinhole
    renderer, T = DepthRenderer(target.mesh, camera), oblique.motion.truth.poses[0]
    step, slopes, same = 1e-4, [], np.ones((camera.height, camera.width), dtype=bool)

    def ranges(error: FloatArray) -> tuple[FloatArray, IntArray]:
        view = renderer.render(
            make_transform(T[:3, :3] @ exp_rotation(error[3:]), T[:3, 3] + error[:3])
        )
        z = np.asarray(view.depth_m, dtype=np.float64)
        return z * np.linalg.norm(pixel_rays(camera), axis=-1), view.triangle

    _, triangle = ranges(np.zeros(6))
    for unit in np.eye(6):
        (ahead, a), (behind, b) = ranges(step * unit), ranges(-step * unit)
        same &= (a == triangle) & (b == triangle) & (triangle >= 0)
        slopes.append((ahead - behind) / (2.0 * step))
    jacobian = np.stack([slope[same] for slope in slopes], axis=1)
    expected = jacobian.T @ jacobian / 0.02**2
    found = ray_information(renderer.render(T), T, same, 0.02)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=2e-3)


def test_a_comparison_takes_up_most_of_what_the_rays_tell_and_never_more(oblique: Scene) -> None:
    target, frame = satellite("boxsat").target, next(iter(oblique))
    T, known = oblique.motion.truth.poses[0], 1e-8 * np.eye(6)
    rays = of_rays(oblique, target)(frame, T, known)
    taken = compared(oblique, target)(frame, T, known)
    axes = np.linalg.inv(np.linalg.cholesky(rays))
    shares = np.linalg.eigvalsh(axes @ taken @ axes.T)
    assert 0.8 < shares[-1] <= 1.0 + 1e-6
    assert shares[0] > 0.4
