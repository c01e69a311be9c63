"""Simulated scans: every return lies on the target where it was when it was seen."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.recordings.opening import open_sequence
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import true_motion
from pcnav.target.satellite import Target, load_target

RATE_HZ, FINE = 2.0, 250


@pytest.fixture(scope="module")
def boxsat(repository: Path) -> Target:
    return load_target(repository / "meshes" / "boxsat.obj")


def pipeline(scan: dict[str, Any], frames: int = 2, **noise: Any) -> Pipeline:
    return Pipeline.model_validate(
        {
            "scenario": {"frames": frames, "frame_rate_hz": RATE_HZ},
            "orbit": {"r_hill_m": [18.0, 0.5, 0.2], "v_hill_m_s": [0.02, -0.05, 0.03]},
            "body": {
                "attitude_rotvec_deg": [10.0, 60.0, -30.0],
                "omega_body_deg_s": [8.0, -9.0, 16.0],
                "com_model_m": [0.1, 0.12, -0.13],
                "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
            },
            "camera": {"width_px": 48, "height_px": 48},
            "scan": {"duration_s": 0.4, "beams": 3000, "rings": 32} | scan,
            "noise": {"range_sigma_m": 0.0, "quantisation_m": 1e-4} | noise,
        }
    )


def distance(target: Target, points: np.ndarray) -> np.ndarray:
    """(n,) of points from the nearest of the target's triangles."""
    triangles = np.asarray(target.mesh.triangles)
    n, m = len(points), len(triangles)
    nearest = trimesh.triangles.closest_point(
        np.tile(triangles, (n, 1, 1)), np.repeat(points, m, axis=0)
    )
    return np.linalg.norm(nearest - np.repeat(points, m, axis=0), axis=1).reshape(n, m).min(axis=1)


@pytest.mark.parametrize("pattern", ["raster", "rings", "rosette"])
def test_returns_lie_on_the_surface_at_their_own_times(boxsat: Target, pattern: str) -> None:
    scanned = pipeline({"pattern": pattern})
    frame = list(Scene.showing(boxsat, scanned))[1]
    beams = frame.beams
    assert beams is not None
    scenario = scanned.scenario.model_copy(update={"frames": 2 * FINE, "frame_rate_hz": 2.0 * FINE})
    fine = true_motion(scanned.model_copy(update={"scenario": scenario})).truth
    times_s = frame.time_s + beams.time_s
    seen = np.flatnonzero((beams.depth_m > 0.0) & (times_s < fine.time_s[-1]))
    assert len(seen) > 150
    seen = seen[:: len(seen) // 60]
    # The motion in steps of 2 ms: a rim moves by 1 mm in half of one.
    step = np.rint(times_s[seen] * 2.0 * FINE).astype(int)
    points = beams.rays[seen] * beams.depth_m[seen, None]
    p_model = np.stack(
        [
            transform_points(invert_transform(fine.poses[k]), point[None])[0]
            for k, point in zip(step, points, strict=True)
        ]
    )
    off = distance(boxsat, p_model)
    assert np.quantile(off, 0.98) < 1.5e-3
    at_once = transform_points(invert_transform(fine.poses[FINE]), points)
    if pattern != "rings":
        # A turning sensor sees the target within some milliseconds.
        assert np.quantile(distance(boxsat, at_once), 0.9) > 0.02


def test_a_scan_beyond_what_16_bits_of_a_millimetre_hold_comes_back_from_disk(
    boxsat: Target, tmp_path: Path
) -> None:
    far = pipeline({"pattern": "rosette"}, range_sigma_m=0.01)
    far = far.model_copy(
        update={
            "orbit": far.orbit.model_copy(update={"r_hill_m": (140.0, 0.0, 0.0)}),
            "camera": far.camera.model_copy(update={"horizontal_fov_deg": 4.0}),
        }
    )
    scene = Scene.showing(boxsat, far)
    scene.write(tmp_path / "far")
    read = open_sequence(tmp_path / "far")
    assert read.info.scan_s == pytest.approx(0.4, rel=1e-3)
    for made, again in zip(scene, read, strict=True):
        assert made.depth_m.max() > 130.0
        np.testing.assert_array_equal(again.depth_m, made.depth_m)
        assert made.beams is not None and again.beams is not None
        np.testing.assert_array_equal(again.beams.depth_m, made.beams.depth_m)
        np.testing.assert_array_equal(again.beams.time_s, made.beams.time_s)
        assert again.camera == made.camera


def test_without_times_a_recording_states_none(boxsat: Target) -> None:
    scene = Scene.showing(boxsat, pipeline({"pattern": "raster", "states_times": False}))
    stated = Scene.showing(boxsat, pipeline({"pattern": "raster"}))
    assert scene.info.scan_s == 0.0 and stated.info.scan_s == 0.4
    a, b = next(iter(scene)), next(iter(stated))
    np.testing.assert_array_equal(a.depth_m, b.depth_m)
    assert a.beams is not None and not a.beams.time_s.any()


def test_wide_beams_return_beside_edges_from_the_nearer_surface_or_between_both(
    boxsat: Target,
) -> None:
    narrow, first, mixed = (
        next(iter(Scene.showing(boxsat, pipeline({"pattern": "flash"} | scan, **noise))))
        for scan, noise in (
            ({}, {}),
            ({"divergence_mrad": 9.0}, {"footprint": "any"}),
            ({"divergence_mrad": 9.0}, {"footprint": "any", "footprint_mixes": True}),
        )
    )
    grown = (first.depth_m > 0.0) & (narrow.depth_m == 0.0)
    assert grown.sum() > 30
    assert not ((first.depth_m == 0.0) & (narrow.depth_m > 0.0)).any()
    both = (narrow.depth_m > 0.0) & (first.depth_m > 0.0)
    same = np.abs(first.depth_m - narrow.depth_m)[both] < 2e-4
    assert 0.5 < same.mean() < 1.0
    farther = (mixed.depth_m - first.depth_m)[both]
    assert (farther > 0.05).sum() > 5 and farther.min() > -0.05


def test_a_scan_is_no_longer_than_the_time_between_frames(boxsat: Target) -> None:
    with pytest.raises(InputError, match=r"scan\.duration_s"):
        next(iter(Scene.showing(boxsat, pipeline({"pattern": "raster", "duration_s": 0.6}))))


def test_a_damaged_table_of_beams_is_one_line(boxsat: Target, tmp_path: Path) -> None:
    Scene.showing(boxsat, pipeline({"pattern": "rosette"}, frames=1)).write(tmp_path / "a")
    file = tmp_path / "a" / "scan.npz"
    with np.load(file) as found:
        good = dict(found)
    bad = {
        "rays": good["rays"][:, :2],
        "time_s": good["time_s"][:9],
        "camera": np.array([1e6, 1e6, 1.0, 1.0, 0.0, 0.0]),
    }
    for name, value in bad.items():
        np.savez(file, **(good | {name: value}))
        with pytest.raises(InputError, match=name):
            open_sequence(tmp_path / "a")
    np.savez(file, **good)
    ranges = tmp_path / "a" / "depth" / "000000.npy"
    np.save(ranges, np.load(ranges)[:-1])
    with pytest.raises(InputError, match="one a beam"):
        open_sequence(tmp_path / "a").frame(0)
