"""Scans of a target that moves: the pose that one shows, and what a track of them is worth."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.estimators.depth.motion_within import motion_about
from pcnav.estimators.depth.pose_fit import fit_pose
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error
from pcnav.estimators.depth.skewed_pose import unskewed
from pcnav.estimators.depth.tracker import Tracker
from pcnav.perception.mesh_scale import ScaleBelief
from pcnav.perception.part_fit import MeshFit, PartVerdict
from pcnav.perception.reading import FrameReader
from pcnav.perception.twist_evidence import evidence_of_twist
from pcnav.runs.status import Status
from pcnav.simulation.depth import Scene
from pcnav.simulation.scans import FineMotion
from pcnav.target.row_motion import Readout
from pcnav.target.satellite import Target, load_target
from tests.estimators.depth.test_part_learning import PANEL, shown

SIGMA_M = 0.01


@pytest.fixture(scope="module")
def boxsat(repository: Path) -> Target:
    return load_target(repository / "meshes" / "boxsat.obj")


def scene_of(target: Target, frames: int, side_px: int = 96, **scan: Any) -> Scene:
    pipeline = Pipeline.model_validate(
        {
            "scenario": {"frames": frames, "frame_rate_hz": 2.0},
            "orbit": {"r_hill_m": [18.0, 0.3, -0.2], "v_hill_m_s": [0.004, 0.0, 0.003]},
            "body": {
                "attitude_rotvec_deg": [25.0, 40.0, -30.0],
                "omega_body_deg_s": [11.0, -8.0, 14.0],
                "com_model_m": [0.10, 0.12, -0.13],
                "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
            },
            "camera": {"width_px": side_px, "height_px": side_px},
            "scan": {"duration_s": 0.5, "beams": 9000} | scan,
            "noise": {"range_sigma_m": SIGMA_M},
        }
    )
    return Scene.showing(target, pipeline)


@pytest.mark.parametrize("pattern", ["raster", "rosette"])
def test_one_scan_shows_where_the_target_is_and_how_it_moves(boxsat: Target, pattern: str) -> None:
    scene = scene_of(boxsat, 2, pattern=pattern)
    frame, true = list(scene)[1], scene.truth.poses[1]
    reader = FrameReader(boxsat, scene.pipeline.perception, SIGMA_M, 0)
    reader.frames_take_time = True
    guess = moved_pose(true, np.array([0.05, -0.04, 0.03, 0.05, -0.06, 0.04]))
    still = fit_pose(
        *(frame.depth_m, guess, np.diag(np.repeat([0.2, 0.15], 3) ** 2), reader.comparer(frame))
    )
    assert still is not None
    (found,) = unskewed((still,), frame, reader)
    # As if it stood still it is degrees off, or explains little.
    skewed = pose_error(still.T_cam_model, true)
    error = pose_error(found.T_cam_model, true)
    assert np.linalg.norm(error[:3]) < 0.02 and np.linalg.norm(error[3:]) < 0.01
    assert np.linalg.norm(skewed[3:]) > 3.0 * np.linalg.norm(error[3:])
    assert found.inlier_ratio > 0.97 > 0.9 > still.inlier_ratio
    fine, _ = FineMotion.of(scene.pipeline)
    before, after = fine.about(1, np.array([-0.05, 0.05]))
    rate = pose_error(before, after) / 0.1
    assert found.motion is not None
    assert np.linalg.norm(found.motion.twist[3:] - rate[3:]) < 0.1 * np.linalg.norm(rate[3:])


def test_a_parabola_through_three_poses_is_their_motion() -> None:
    motion = Readout(
        np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.2]), np.array([0.0, 0.02, -0.01, 0.05, 0.02, 0.0])
    )
    times_s = np.array([0.0, 0.4, 1.0])
    for k in range(3):
        poses = motion.poses(np.eye(4), times_s - times_s[k])
        found = motion_about(list(zip(times_s.tolist(), poses, strict=True)), k)
        assert found is not None and found.bend is not None and motion.bend is not None
        np.testing.assert_allclose(found.twist, motion.twist, atol=1e-12)
        np.testing.assert_allclose(found.bend, motion.bend, atol=1e-12)
    assert motion_about([(0.0, np.eye(4))], 0) is None


def test_three_scans_are_a_start(boxsat: Target) -> None:
    scene = scene_of(boxsat, 4, 64, pattern="raster")
    tracker = Tracker(*(boxsat, scene.info, scene.pipeline.perception, scene.pipeline.filter, 0))
    *_, third, fourth = [tracker.step(frame) for frame in scene]
    assert third.status == fourth.status == Status.LOCKED
    for estimate, true in zip((third, fourth), scene.truth.poses[2:], strict=True):
        assert estimate.T_cam_target is not None
        error = pose_error(estimate.T_cam_target, true)
        # Where the start takes the target to stand still in each it is off by 30 mm and more.
        assert np.linalg.norm(error[:3]) < 0.005 and np.linalg.norm(error[3:]) < 0.005


def true_motion(scene: Scene, k: int) -> Readout:
    """Of the target in the camera about frame k."""
    fine, _ = FineMotion.of(scene.pipeline)
    before, here, after = fine.about(k, np.array([-0.25, 0.0, 0.25]))
    moved = np.stack([pose_error(here, before), pose_error(here, after)]) / 0.25
    return Readout(0.5 * (moved[1] - moved[0]), 2.0 * (moved[1] + moved[0]))


@pytest.mark.parametrize(
    ("pattern", "axis"),
    [("raster", 1), ("raster", 2), ("raster", 3), ("raster", 5), ("rosette", 5)],
)
def test_a_rate_that_is_off_is_taken_for_the_pose_that_the_evidence_says(
    boxsat: Target, pattern: str, axis: int
) -> None:
    scene = scene_of(boxsat, 2, pattern=pattern)
    frame, true = list(scene)[1], scene.truth.poses[1]
    reader = FrameReader(boxsat, scene.pipeline.perception, SIGMA_M, 0)
    motion, off = true_motion(scene, 1), np.zeros(6)
    off[axis] = 0.05 if axis < 3 else 0.01
    found, told, sd = [], [], np.ones(6)
    for sign in (1.0, -1.0):
        reader.expect_motion(Readout(motion.twist + sign * off, motion.bend))
        comparer = reader.comparer(frame)
        fit = fit_pose(frame.depth_m, true, np.diag(np.repeat([0.2, 0.05], 3) ** 2), comparer)
        assert fit is not None and fit.comparison is not None
        used = [face for face in fit.comparison.faces if face.name in fit.used]
        by_twist = np.sum([evidence_of_twist(fit.comparison.seen, face) for face in used], axis=0)
        found.append(pose_error(true, fit.T_cam_model))
        sd = np.sqrt(np.diag(fit.covariance))
        # Less than what was believed is what the frame shows.
        told.append(-fit.covariance @ by_twist[:6] @ (sign * off))
    # Noise moves both alike.
    moved, expected = 0.5 * (found[0] - found[1]), 0.5 * (told[0] - told[1])
    assert np.abs(expected / sd).max() > 1.0
    # The outline is counted in whole pixels, and other returns agree.
    atol = 0.3 * np.abs(expected / sd).max()
    np.testing.assert_allclose(moved / sd, expected / sd, atol=atol)


def test_a_rate_that_is_off_is_no_other_scale(boxsat: Target) -> None:
    scene = scene_of(boxsat, 9, pattern="rosette")
    off = np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    spread = np.diag(np.repeat([0.05, 0.01], 3) ** 2)

    def factor(knows_times: bool) -> float:
        reader, belief = (
            FrameReader(boxsat, scene.pipeline.perception, SIGMA_M, 0),
            ScaleBelief(0.01),
        )
        for frame, true in zip(scene, scene.truth.poses, strict=True):
            motion = true_motion(scene, frame.index)
            reader.expect_motion(Readout(motion.twist + off, motion.bend))
            seen = reader.compare(frame, true, spread).seen
            if not knows_times:
                seen = replace(seen, residuals=replace(seen.residuals, time_s=None))
            belief = belief.with_frame(seen, list(seen.ranges), 0.5 * boxsat.diameter_m)
        return belief.factor(np.zeros(6))

    assert factor(knows_times=True) == 1.0
    # It would be taken for one.
    assert abs(factor(knows_times=False) - 1.0) > 1e-3


def parts_of_scans(boxsat: Target, seen: Target, pattern: str) -> tuple[Tracker, MeshFit]:
    """A track of scans of a target, and the fit of all of its frames to boxsat's mesh."""
    scene = scene_of(seen, 14, 128, pattern=pattern)
    settings = scene.pipeline.perception, scene.pipeline.filter
    tracker, fit = Tracker(*(boxsat, scene.info, *settings, 0)), MeshFit(boxsat)
    for frame in scene:
        estimate = tracker.step(frame)
        if estimate.is_claimed:
            pose = estimate.T_cam_target
            assert pose is not None
            fit.add(frame, pose, tracker.sensor_noise, 1.0, tracker.exposure(frame, pose))
    return tracker, fit


@pytest.mark.study
@pytest.mark.parametrize("pattern", ["raster", "rosette"])
def test_parts_that_are_as_in_the_mesh_stay_so_in_scans(boxsat: Target, pattern: str) -> None:
    tracker, fit = parts_of_scans(boxsat, boxsat, pattern)
    assert tracker.changed_parts == ()
    verdicts = {part.verdict for part in fit.parts()}
    assert verdicts <= {PartVerdict.FITS, PartVerdict.HARDLY_SEEN}


@pytest.mark.study
def test_a_part_that_differs_is_found_in_scans(boxsat: Target, tmp_path: Path) -> None:
    # A raster, whose outline the panel contradicts, takes long to start with.
    shown(boxsat, 10.0).export(tmp_path / "turned.obj")
    tracker, fit = parts_of_scans(boxsat, load_target(tmp_path / "turned.obj"), "rosette")
    assert tracker.changed_parts == (PANEL,)
    (turned,) = [part for part in fit.parts() if part.verdict is PartVerdict.TURNED]
    assert turned.name == PANEL and abs(turned.turn_deg - 10.0) < 1.0


@pytest.mark.study
def test_a_track_of_scans_is_as_good_as_of_returns_seen_at_once(boxsat: Target) -> None:
    def squared(**scan: Any) -> tuple[float, float]:
        scene = scene_of(boxsat, 16, pattern="raster", **scan)
        tracker = Tracker(
            *(boxsat, scene.info, scene.pipeline.perception, scene.pipeline.filter, 0)
        )
        errors = []
        for frame, true in zip(scene, scene.truth.poses, strict=True):
            pose = tracker.step(frame).T_cam_target
            if frame.index >= 6:
                assert pose is not None
                errors.append(pose_error(pose, true))
        rms = np.sqrt(np.mean(np.square(errors), axis=0))
        return float(np.linalg.norm(rms[:3])), float(np.linalg.norm(rms[3:]))

    scanned, at_once = squared(), squared(duration_s=0.0)
    # Two runs of ten frames: their own scatter is a third.
    assert scanned[0] < 1.8 * at_once[0] and scanned[1] < 1.8 * at_once[1]
