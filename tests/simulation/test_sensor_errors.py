"""What the simulated sensor does to ranges and times, by statistics and geometry."""

from typing import Any

import numpy as np
import pytest
import trimesh
from scipy import stats

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.core.errors import InputError
from pcnav.simulation.depth import Scene, stated_range_sigma
from pcnav.simulation.stamps import recorded_times
from pcnav.target.rendering import DepthRenderer

BOX = trimesh.creation.box((2.0, 2.0, 2.0))
QUIET = {"range_sigma_m": 0.0, "quantisation_m": 1e-4}
TABLES: dict[str, Any] = {
    "seed": 3,
    "scenario": {"frames": 40, "frame_rate_hz": 2.0},
    "orbit": {"r_hill_m": [6.0, 0.2, -0.1]},
    "body": {"omega_body_deg_s": [0.0, 0.0, 0.0], "attitude_rotvec_deg": [25.0, 35.0, 10.0]},
    "camera": {"width_px": 120, "height_px": 96},
    "noise": QUIET,
}


def frames(frames: int = 40, mesh: trimesh.Trimesh = BOX, **noise: Any) -> FloatArray:
    """(n, height, width) ranges of frames with these faults; 0 for no return."""
    scenario = {**TABLES["scenario"], "frames": frames}
    tables = {**TABLES, "scenario": scenario, "noise": {**QUIET, **noise}}
    scene = Scene.of(Pipeline.model_validate(tables), mesh)
    ratio = range_per_depth(scene.pipeline.camera.pinhole)
    return np.stack([frame.depth_m.astype(np.float64) * ratio for frame in scene.frames()])


CLEAN = frames(1)[0]
SEEN = CLEAN > 0.0


def test_false_returns_fill_their_share_of_all_pixels_evenly() -> None:
    found = frames(10, false_return_fraction=0.05, false_return_span_m=(1.0, 4.0))
    changed = np.abs(found - CLEAN) > 1e-3
    share = changed.mean()
    assert share == pytest.approx(0.05, abs=5.0 * np.sqrt(0.05 / changed.size))
    assert changed[:, ~SEEN].mean() == pytest.approx(changed[:, SEEN].mean(), abs=0.01)
    assert stats.kstest(found[changed], "uniform", args=(1.0, 3.0)).pvalue > 1e-3
    # Without a span they lie about the target's distance.
    default = frames(10, false_return_fraction=0.05)
    drawn = default[np.abs(default - CLEAN) > 1e-3]
    assert drawn.min() == pytest.approx(3.0, abs=0.1) and drawn.max() == pytest.approx(9.0, abs=0.1)


def test_false_returns_also_fall_on_an_empty_frame() -> None:
    away = {**TABLES, "orbit": {"r_hill_m": [-6.0, 0.0, 0.0]}}
    away["noise"] = {**QUIET, "false_return_fraction": 0.1, "false_return_span_m": (2.0, 3.0)}
    frame = next(Scene.of(Pipeline.model_validate(away), BOX).frames())
    assert (frame.depth_m > 0.0).mean() == pytest.approx(0.1, abs=0.02)


def test_noise_grows_with_range_as_stated() -> None:
    found = frames(60, range_sigma_m=0.002, range_sigma_per_m=0.001, range_sigma_per_m2=0.0005)
    sd = (found - CLEAN)[:, SEEN].std(axis=0, ddof=1)
    expected = 0.002 + 0.001 * CLEAN[SEEN] + 0.0005 * CLEAN[SEEN] ** 2
    assert np.ptp(expected) > 0.2 * expected.min()
    assert np.mean(sd / expected) == pytest.approx(1.0, abs=0.01)
    near, far = expected < np.quantile(expected, 0.2), expected > np.quantile(expected, 0.8)
    assert np.mean((sd / expected)[near]) == pytest.approx(np.mean((sd / expected)[far]), abs=0.02)


def test_what_a_recording_states_of_its_noise() -> None:
    assert stated_range_sigma(NoiseTable(range_sigma_m=0.01), 5.0) == 0.01
    growing = NoiseTable(range_sigma_m=0.01, range_sigma_per_m2=0.001)
    assert stated_range_sigma(growing, 5.0) == pytest.approx(0.035)
    stated = NoiseTable(range_sigma_m=0.01, stated_range_sigma_m=0.03)
    assert stated_range_sigma(stated, 5.0) == 0.03
    assert stated_range_sigma(NoiseTable(states_range_sigma=False), 5.0) is None


@pytest.mark.parametrize("correlation_s", [0.0, 5.0])
def test_a_frames_offset_is_one_number_with_its_deviation_and_its_time(
    correlation_s: float,
) -> None:
    found = frames(200, frame_offset_sd_m=0.05, frame_offset_correlation_s=correlation_s)
    off = (found - CLEAN)[:, SEEN]
    assert np.ptp(off, axis=1).max() < 4e-4
    mean = off.mean(axis=1)
    neighbours = np.corrcoef(mean[:-1], mean[1:])[0, 1]
    if correlation_s == 0.0:
        assert mean.std() == pytest.approx(0.05, rel=0.2)
        assert abs(neighbours) < 0.25
    else:
        # exp(-(0.5 / 5)^2 / 2) = 0.995
        assert 0.02 < mean.std() < 0.1
        assert neighbours > 0.97


def test_a_face_has_an_offset_of_its_own_in_every_frame() -> None:
    off = frames(150, face_offset_sd_m=0.03) - CLEAN
    camera, pose = _camera_and_pose()
    triangle = DepthRenderer(BOX, camera).render(pose).triangle
    normals = np.round(BOX.face_normals)[triangle]
    three = []
    for normal in np.unique(normals[SEEN], axis=0):
        face = off[:, SEEN & (normals == normal).all(axis=-1)]
        assert face.shape[1] > 50 and np.ptp(face, axis=1).max() < 4e-4
        three.append(face.mean(axis=1))
    assert len(three) >= 2
    np.testing.assert_allclose(np.std(three, axis=1), 0.03, rtol=0.25)
    assert abs(np.corrcoef(three)[0, 1]) < 0.35


def _camera_and_pose() -> tuple[PinholeCamera, FloatArray]:
    scene = Scene.of(Pipeline.model_validate(TABLES), BOX)
    return scene.pipeline.camera.pinhole, scene.truth.poses[0]


def test_a_face_is_tilted_about_its_middle() -> None:
    off = (frames(60, face_tilt_sd_deg=2.0) - CLEAN)[:, SEEN]
    assert np.abs(off.mean(axis=1)).max() < 1e-3
    # Half a face of 2 m at 2 degrees.
    assert 0.003 < off.std() < 0.05


def test_surfaces_seen_at_a_slant_do_not_return() -> None:
    kept = frames(1, hole_incidence_deg=60.0)[0]
    # A box's faces are flat: the incidence of a face varies by the field of view alone.
    lost = SEEN & (kept == 0.0)
    assert 50 < lost.sum() < 0.9 * SEEN.sum()
    np.testing.assert_allclose(kept[SEEN & ~lost], CLEAN[SEEN & ~lost])


def test_dark_patches_are_fixed_to_the_target() -> None:
    dark = frames(2, dark_fraction=0.2, dark_patch_m=0.4)
    lost = SEEN & (dark == 0.0)
    np.testing.assert_array_equal(lost[0], lost[1])
    assert 0.08 < lost[0].sum() / SEEN.sum() < 0.35
    # Patches, not single pixels: most neighbours of a lost pixel are lost.
    pairs = lost[0][:, :-1] & SEEN[:, 1:]
    assert (lost[0][:, 1:] & pairs).sum() > 0.75 * pairs.sum()


def test_light_by_way_of_another_face_lengthens_ranges_in_a_corner_only() -> None:
    long = frames(1, multipath_fraction=0.3)[0]
    np.testing.assert_allclose(long[SEEN], CLEAN[SEEN], atol=2e-4)
    # Three of the box's plates, seen from inside of it.
    corner = trimesh.creation.box((2.0, 2.0, 2.0))
    corner.update_faces(np.isin(np.round(corner.face_normals @ [1, 2, 3]), [2.0, 3.0]))
    corner.invert()
    clean = frames(1, corner)[0]
    off = frames(1, corner, multipath_fraction=0.3)[0] - clean
    seen = clean > 0.0
    assert off[seen].max() > 0.02
    assert off[seen].min() > -2e-4


def test_stamps_jitter_about_the_true_times_and_keep_their_order() -> None:
    times = np.arange(5000) / 10.0
    off = recorded_times(times, NoiseTable(stamp_jitter_s=0.01), 1) - times
    assert off.std() == pytest.approx(0.01, rel=0.05)
    assert stats.kstest(off / 0.01, "norm").pvalue > 1e-3
    wild = recorded_times(times, NoiseTable(stamp_jitter_s=1.0), 1)
    assert (np.diff(wild) > 0.0).all()
    coarse = recorded_times(times, NoiseTable(stamp_step_s=0.04), 1)
    np.testing.assert_allclose(coarse / 0.04, np.rint(coarse / 0.04))
    assert np.abs(coarse - times).max() == pytest.approx(0.02)
    with pytest.raises(InputError, match="stamp_step_s"):
        recorded_times(times, NoiseTable(stamp_step_s=0.3), 1)


def test_the_truth_of_a_frame_is_that_of_its_true_time() -> None:
    spinning = {**TABLES, "body": {"omega_body_deg_s": [0.0, 0.0, 12.0]}}
    plain = Scene.of(Pipeline.model_validate(spinning), BOX)
    jittered = {**spinning, "noise": {**QUIET, "stamp_jitter_s": 0.05}}
    scene = Scene.of(Pipeline.model_validate(jittered), BOX)
    np.testing.assert_array_equal(scene.truth.poses, plain.truth.poses)
    assert 0.01 < np.abs(scene.truth.time_s - plain.truth.time_s).max() < 0.25
    assert [frame.time_s for frame in scene.frames()] == scene.truth.time_s.tolist()


def test_nothing_returns_from_beyond_the_sensors_reach() -> None:
    limit = float(np.median(CLEAN[SEEN]))
    found = frames(1, max_range_m=limit)[0]
    assert found.max() <= limit
    np.testing.assert_array_equal(found > 0.0, SEEN & (limit >= CLEAN))
