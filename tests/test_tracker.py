"""The program interface, on frames that another ray caster renders of a mesh of its own."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pcnav
from pcnav.core.arrays import FloatArray
from pcnav.viewer.loading import load_run
from tests.rendered import EPOCH_S, HEIGHT, WIDTH, K, Scene, rendered_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return rendered_scene()


@pytest.fixture(scope="module")
def target(scene: Scene) -> pcnav.Target:
    return pcnav.Target.from_mesh(scene.mesh, unit="mm", name="mine")


@pytest.fixture(scope="module")
def followed(scene: Scene, target: pcnav.Target) -> tuple[pcnav.Tracker, list[pcnav.Estimate]]:
    """A tracker that has seen all frames, and what it answered."""
    tracker = pcnav.Tracker(target, K, keep_frames=True, name="rendered")
    pairs = zip(scene.depths, scene.times_s, strict=True)
    return tracker, [tracker.step(depth, EPOCH_S + t) for depth, t in pairs]


def turn_between(a: FloatArray, b: FloatArray) -> FloatArray:
    return Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).as_rotvec()


def test_the_pose_is_the_one_rendered_within_its_covariance(
    scene: Scene, followed: tuple[pcnav.Tracker, list[pcnav.Estimate]]
) -> None:
    found = followed[1]
    assert [est.time_s for est in found] == [EPOCH_S + t for t in scene.times_s]
    assert [est.is_claimed for est in found] == [False, False, True, True, True, True]
    for est, true in list(zip(found, scene.poses, strict=True))[2:]:
        assert est.pose is not None
        assert est.pose_covariance is not None
        error = np.r_[true[:3, 3] - est.pose[:3, 3], turn_between(est.pose, true)]
        assert np.linalg.norm(error[:3]) < 0.003
        # Of six degrees of freedom: one in 10,000 is larger.
        assert error @ np.linalg.solve(est.pose_covariance, error) < 28.0
    last = found[-1]
    assert last.status == pcnav.Status.LOCKED
    assert last.rate is not None
    assert last.rate_covariance is not None
    assert last.rate == pytest.approx(np.radians([3.0, -4.0, 2.0]), abs=0.005)
    assert last.inertia is not None
    assert last.inertia == pytest.approx(last.inertia.T)
    shapes = [last.position_covariance, last.velocity_covariance, last.attitude_covariance]
    shapes += [last.mass_centre_covariance, last.inertia_covariance]
    assert [None if P is None else len(P) for P in shapes] == [3, 3, 3, 3, 5]
    assert found[0].pose is None
    assert found[0].rate is None
    assert found[0].rate_covariance is None


def test_the_covariance_of_the_pose_is_that_of_poses_drawn_from_the_state(
    followed: tuple[pcnav.Tracker, list[pcnav.Estimate]],
) -> None:
    """``T_cam_model`` of states drawn from their joint covariance, camera and world being one."""
    est = followed[1][-1]
    assert est.covariance is not None
    assert est.position is not None
    assert est.mass_centre is not None
    assert est.attitude is not None
    assert est.pose is not None
    assert est.pose_covariance is not None
    order = [0, 1, 2, 6, 7, 8, 9, 10, 11]
    # So small that it is linear: a turn by the mass centre's deviation is not.
    scale = 1e-6
    P = scale * est.covariance[np.ix_(order, order)]
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(9), P, 40_000)
    R = est.attitude @ Rotation.from_rotvec(drawn[:, 6:]).as_matrix()
    centre = est.mass_centre + drawn[:, 3:6]
    origin = est.position + drawn[:, :3] - np.einsum("nij,nj->ni", R, centre)
    turns = Rotation.from_matrix(est.pose[:3, :3].T @ R).as_rotvec()
    sampled = np.cov(np.hstack([origin - est.pose[:3, 3], turns]).T) / scale
    sd = np.sqrt(np.diag(est.pose_covariance))
    assert sampled / np.outer(sd, sd) == pytest.approx(
        est.pose_covariance / np.outer(sd, sd), abs=0.03
    )


def test_what_is_saved_is_what_a_run_on_the_same_frames_writes(
    followed: tuple[pcnav.Tracker, list[pcnav.Estimate]], tmp_path: Path
) -> None:
    tracker, found = followed
    out, sequence = tmp_path / "run", tmp_path / "frames"
    summary = tracker.save(out, report=False, recording=sequence)
    assert summary.diagnosis.found
    with pytest.raises(pcnav.InputError, match="--overwrite"):
        tracker.save(str(out))
    again = pcnav.run(str(sequence), tmp_path / "again", report=False).folder
    for name in ("states.csv", "poses.tum", "measurements.csv", "knowledge.csv"):
        assert (out / name).read_bytes() == (again / name).read_bytes(), name
    run = pcnav.read_run(str(out))
    assert run.pipeline is not None
    assert run.pipeline.time_zero_s == EPOCH_S
    assert run.trajectory.poses[-1] == pytest.approx(found[-1].pose, abs=1e-12)
    assert repr(run) == "<Run run: 6 frames of depth (2 acquiring, 4 locked)>"
    assert repr(run.trajectory).startswith("<Trajectory of r_hill, v_hill, ")
    # Moved together, both are still found, and the mesh that was no file with them.
    (tmp_path / "elsewhere").mkdir()
    moved = (tmp_path / "elsewhere" / "run", tmp_path / "elsewhere" / "frames")
    for old, new in zip((out, sequence), moved, strict=True):
        old.rename(new)
    shown = load_run(moved[0])
    assert shown.frames is not None
    assert shown.target is not None
    assert shown.target.diameter_m == pytest.approx(tracker.target.diameter_m, abs=1e-12)
    assert repr(pcnav.open_recording(str(moved[1]))) == (
        "<Sequence rendered: 6 depth frames of 160 x 120, 0 to 1 s>"
    )


def test_what_is_stated_of_the_camera_is_in_the_deviations(
    scene: Scene, target: pcnav.Target, followed: tuple[pcnav.Tracker, list[pcnav.Estimate]]
) -> None:
    tracker = pcnav.Tracker(target, K, calibration=pcnav.Calibration(centre_sd_px=1.0))
    pairs = list(zip(scene.depths, scene.times_s, strict=True))[:3]
    told = [tracker.step(depth, t) for depth, t in pairs][-1].pose_covariance
    unsaid = followed[1][2].pose_covariance
    assert told is not None and unsaid is not None
    # By one pixel across: the distance over the focal length.
    by_pixel = scene.poses[2][2, 3] / K[0, 0]
    assert np.sqrt(told[0, 0]) == pytest.approx(by_pixel, rel=0.1)
    assert np.sqrt(unsaid[0, 0]) == pytest.approx(0.25 * by_pixel, rel=0.2)


def test_a_prediction_is_what_a_frame_without_returns_is_answered(
    scene: Scene, target: pcnav.Target
) -> None:
    tracker = pcnav.Tracker(target, K, depth_unit="mm")
    assert tracker.predict(3.0).status == "acquiring"
    for depth, t in zip(scene.depths[:4], scene.times_s, strict=False):
        tracker.step(np.rint(1e3 * np.nan_to_num(depth, posinf=0.0)).astype(np.int32), t)
    assert tracker.last is not None
    assert tracker.predict(tracker.last.time_s) is tracker.last
    ahead = tracker.predict(2.0)
    assert (ahead.status, ahead.time_s) == ("coasting", 2.0)
    # Nothing was changed by it.
    coasted = tracker.step(np.zeros((HEIGHT, WIDTH)), 2.0)
    assert ahead.pose is not None
    assert ahead.pose == pytest.approx(coasted.pose, abs=1e-12)
    assert ahead.covariance == pytest.approx(coasted.covariance, rel=1e-9)
    tracker.reset()
    assert len(tracker) == 0
    assert tracker.step(np.zeros((HEIGHT, WIDTH)), 0.0).status == "acquiring"


GOOD = np.full((HEIGHT, WIDTH), 6.0)


@pytest.mark.parametrize(
    ("depth", "t", "words"),
    [
        (GOOD[:, :100], 1.0, "frame 1: depth: expected 120 rows of 160"),
        (GOOD[None], 1.0, "one image of rows and columns"),
        (GOOD.astype(np.uint16), 1.0, 'depth_unit="mm"'),
        (GOOD > 0.0, 1.0, "expected numbers, got bool"),
        ([[1.0, 2.0], [3.0]], 1.0, "array of numbers"),
        (GOOD, 0.5, "frame 1: t: expected a time after the 0.5 s of frame 0, got 0.5 s"),
        (GOOD, 0.4, "got 0.4 s"),
        (GOOD, np.nan, "finite time"),
        (GOOD, np.datetime64("2026-01-01"), "seconds as a number"),
    ],
)
def test_a_frame_that_cannot_be_is_refused_in_one_line_and_forgotten(
    target: pcnav.Target, depth: object, t: float, words: str
) -> None:
    tracker = pcnav.Tracker(target, K)
    tracker.step(np.zeros((HEIGHT, WIDTH)), 0.5)
    with pytest.raises(pcnav.InputError) as refused:
        tracker.step(depth, t)  # type: ignore[arg-type]
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(tracker) == 1
    with pytest.raises(pcnav.InputError, match="in every frame or in none"):
        tracker.step(GOOD, 1.0, np.eye(4))
    assert tracker.step(np.zeros((HEIGHT, WIDTH)), 0.6).time_s == 0.6


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"camera": K.T}, "is it transposed?"),
        ({"camera": np.eye(4)}, "got an array of shape (4, 4)"),
        ({"camera": "cam0"}, "expected a camera matrix"),
        ({"target": "satellite.stl"}, "expected one of Target.from_mesh, got str"),
        ({"camera": -K}, "focal lengths above 0"),
        ({"depth_unit": "metre"}, "expected one of mm, cm, in, ft, m"),
        ({"depth_unit": -1.0}, "metres above 0"),
        ({"depth_is": "distance"}, "expected z or range"),
        ({"estimator": "hu2024"}, "which take depth frames, got hu2024"),
        ({"range_sigma_m": 0.0}, "range_sigma_m"),
        ({"initial_pose": np.eye(3)}, "initial_pose: expected a rigid transform"),
        ({"initial_pose": np.eye(4), "initial_pose_sd": (-1.0, 1.0)}, "position_sd_m"),
    ],
)
def test_a_tracker_that_cannot_be_is_refused_in_one_line(
    target: pcnav.Target, options: dict, words: str
) -> None:
    with pytest.raises(pcnav.InputError) as refused:
        pcnav.Tracker(**{"target": target, "camera": K, **options})
    assert words in str(refused.value)


def test_meshes_of_any_make_are_one_target(scene: Scene, target: pcnav.Target) -> None:
    arrays = (np.asarray(scene.mesh.vertices), np.asarray(scene.mesh.faces))
    same = pcnav.Target.from_mesh(arrays, unit="mm")
    assert np.array_equal(same.mesh.triangles, target.mesh.triangles)
    shipped = pcnav.Target.from_mesh("boxsat")
    assert repr(shipped).startswith("<Target boxsat: ")
    for bad, words in (
        ((arrays[0], arrays[0]), "which are indices"),
        (arrays[0], "got ndarray"),
        ("no.stl", "found none"),
    ):
        with pytest.raises(pcnav.InputError, match=words):
            pcnav.Target.from_mesh(bad)  # type: ignore[arg-type]
    with pytest.raises(pcnav.InputError, match="expected one of mm"):
        pcnav.Target.from_mesh(scene.mesh, unit="km")


def test_units_that_were_forgotten_are_asked_for(
    scene: Scene, target: pcnav.Target, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("WARNING", logger="pcnav")
    kilometres = pcnav.Target.from_mesh(scene.mesh)
    assert "is the mesh in millimetres" in caplog.text
    for wrong, scale in ((kilometres, 1.0), (target, 1e3)):
        with pytest.raises(pcnav.InputError, match=r"Tracker\(depth_unit=...\)"):
            pcnav.Tracker(wrong, K).step(scale * scene.depths[0], 0.0)


def test_a_mask_leaves_nothing_else_and_ranges_become_depths(
    scene: Scene, target: pcnav.Target
) -> None:
    """A wall that fills the image is masked away; ranges are those of the same depths."""
    tracker = pcnav.Tracker(target, K, depth_is="range", invalid_depth=7.0, keep_frames=True)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)])
    seen = np.isfinite(scene.depths[0]) & (scene.depths[0] > 0.0)
    ranges = np.where(seen, scene.depths[0], 8.0) * np.linalg.norm(rays, axis=0)
    ranges[np.nonzero(seen)[0][0], np.nonzero(seen)[1][0]] = 7.0
    tracker.step(np.ma.masked_array(ranges, mask=~seen & (u < 80)), 0.0, mask=seen)
    (frame,) = tracker.frames
    kept = frame.depth_m > 0.0
    assert np.count_nonzero(seen & ~kept) == 1
    assert np.array_equal(kept, kept & seen)
    assert frame.depth_m[kept] == pytest.approx(scene.depths[0][kept], abs=1e-6)


def test_a_track_that_found_nothing_is_saved_with_all_that_was_told(
    target: pcnav.Target, tmp_path: Path
) -> None:
    tracker = pcnav.Tracker(
        target, K, mean_motion_rad_s=1e-3, range_sigma_m=0.01, estimator="open3d_icp"
    )
    with pytest.raises(pcnav.InputError, match="at least one frame"):
        tracker.save(tmp_path / "run")
    tracker.step(np.zeros((HEIGHT, WIDTH)), 0.0, np.eye(4))
    with pytest.raises(pcnav.InputError, match="keep_frames"):
        tracker.save(tmp_path / "run", recording=tmp_path / "frames")
    with pytest.raises(pcnav.InputError, match="open3d_icp tells poses alone"):
        tracker.predict(1.0)
    summary = tracker.save(tmp_path / "run", report=False)
    assert summary.warnings
    as_run = pcnav.read_run(tmp_path / "run").pipeline
    assert as_run is not None
    assert as_run.orbit.mean_motion_rad_s == 1e-3
    assert as_run.perception.range_sigma_m == 0.01
    assert as_run.estimator.kind == "open3d_icp"
    assert {path.name for path in tmp_path.iterdir()} == {"run"}
