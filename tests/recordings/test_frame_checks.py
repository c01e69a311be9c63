"""What a frame has to be: the same words for frames of files and frames made by a program."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform
from pcnav.recordings.bop import read_bop
from pcnav.recordings.frame_guard import FrameGuard
from pcnav.recordings.sequence import Frame, SequenceInfo

CAMERA = PinholeCamera(8, 6, 20.0, 21.0, 3.5, 2.5)


def frame(**changes: Any) -> Frame:
    depth_m = np.full((6, 8), 2.0, dtype=np.float32)
    given: dict[str, Any] = {
        **{"index": 4, "time_s": 0.5, "depth_m": depth_m, "camera": CAMERA},
        **{"T_cam_world": np.eye(4)},
    }
    return Frame(**{**given, **changes})


def test_what_is_no_depth_becomes_a_hole_and_the_array_given_stays() -> None:
    depth_m = np.full((6, 8), 2.0)
    depth_m[0, :5] = [np.nan, np.inf, -np.inf, -3.0, 0.0]
    kept = depth_m.copy()
    made = frame(depth_m=depth_m)
    assert made.depth_m.dtype == np.float32
    np.testing.assert_array_equal(made.depth_m[0], [0, 0, 0, 0, 0, 2, 2, 2])
    assert np.count_nonzero(made.depth_m) == 43
    np.testing.assert_array_equal(depth_m, kept)
    plain = np.full((6, 8), 2.0, dtype=np.float32)
    assert frame(depth_m=plain).depth_m is plain


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("depth_m", np.ones((8, 6), np.float32), r"6 rows of 8, .* got an array of shape \(8, 6\)"),
        ("depth_m", np.ones(48, np.float32), r"got an array of shape \(48,\)"),
        ("depth_m", np.ones((6, 8), np.uint16), "floats in metres, got uint16"),
        ("depth_m", [[1.0] * 8] * 6, "floats in metres, got list"),
        ("time_s", float("nan"), "a finite time, got nan"),
        ("time_s", float("inf"), "a finite time, got inf"),
        ("camera", replace(CAMERA, fx=0.0), "focal lengths above 0"),
        ("camera", replace(CAMERA, cx=float("nan")), "finite intrinsics"),
        ("T_cam_world", np.eye(3), r"a rigid transform \(4, 4\), got \(3, 3\)"),
        ("T_cam_world", np.diag([1.0, 1.0, -1.0, 1.0]), "determinant 1"),
        ("T_cam_world", np.diag([2.0, 2.0, 2.0, 1.0]), "orthonormal to 0.0001"),
        ("T_cam_world", np.full((4, 4), np.nan), "not finite"),
        ("T_cam_world", np.ones((4, 4)), "last row 0 0 0 1"),
        ("unseen", np.zeros((6, 8)), "truth values, got float64"),
        ("unseen", np.zeros((6, 7), bool), "6 rows of 8"),
    ],
)
def test_faults_name_frame_and_field(field: str, value: object, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        frame(**{field: value})
    assert str(caught.value).startswith(f"frame 4: {field}: expected ")
    assert "\n" not in str(caught.value)


def test_a_rotation_off_by_rounding_is_made_orthonormal() -> None:
    R = Rotation.from_rotvec([0.3, -0.5, 1.1]).as_matrix()
    T = make_transform(np.round(R, 5), np.array([1.0, 2.0, 3.0]))
    made = frame(T_cam_world=T).T_cam_world
    np.testing.assert_allclose(made[:3, :3] @ made[:3, :3].T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(made, make_transform(R, np.array([1.0, 2.0, 3.0])), atol=2e-5)
    exact = make_transform(R, np.zeros(3))
    assert frame(T_cam_world=exact).T_cam_world is exact


def test_frames_must_follow_one_another_in_time() -> None:
    guard = FrameGuard(1.0)
    guard.check(frame(index=0, time_s=0.0))
    guard.check(frame(index=1, time_s=0.5))
    for time_s in (0.5, 0.1):
        with pytest.raises(InputError, match=r"frame 2: time_s: expected a time after the 0.5 s"):
            guard.check(frame(index=2, time_s=time_s))
    # The frame that was refused has left no trace.
    guard.check(frame(index=3, time_s=0.6))


def test_millimetres_are_suspected_once(caplog: pytest.LogCaptureFixture) -> None:
    camera = PinholeCamera(64, 48, 600.0, 600.0, 31.5, 23.5)
    depth_m = np.full((48, 64), 612.0, dtype=np.float32)
    suspect = frame(camera=camera, depth_m=depth_m)
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        guard = FrameGuard(0.147)
        guard.doubt_units(replace(suspect, depth_m=np.zeros_like(depth_m), time_s=0.0))
        assert not caplog.records
        guard.doubt_units(replace(suspect, time_s=1.0))
        guard.doubt_units(replace(suspect, time_s=2.0))
        assert len(caplog.records) == 1
        message = caplog.records[0].getMessage()
        assert message.startswith("frame 4: depth_m: expected metres: the target, 0.147 m across")
        assert "612" in message
        caplog.clear()
        # The same in metres, and a target of satellite size as far away, are believed.
        FrameGuard(0.147).doubt_units(replace(suspect, depth_m=depth_m / 1000.0))
        FrameGuard(5.0).doubt_units(suspect)
        assert not caplog.records


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *[("range_sigma_m", bad) for bad in (0.0, -0.1, float("nan"), float("inf"))],
        *[("mean_motion_rad_s", bad) for bad in (-1.0, float("nan"))],
        *[("camera_position_sd_m", -1.0), ("camera_attitude_sd_rad", -1.0)],
        ("row_readout_s", float("inf")),
    ],
)
def test_faults_of_the_recording(field: str, value: float) -> None:
    given: dict[str, Any] = {"mean_motion_rad_s": 0.0, "range_sigma_m": None, field: value}
    with pytest.raises(InputError, match=f"recording mine: {field}: expected a finite number"):
        SequenceInfo("mine", target_mesh=None, **given)


def test_the_check_costs_nothing_that_matters() -> None:
    camera = PinholeCamera.from_field_of_view(256, 256, 0.4)
    depth_m = np.random.default_rng(0).uniform(1.0, 2.0, (256, 256)).astype(np.float32)

    def seconds() -> float:
        began = time.process_time()
        for _ in range(100):
            Frame(0, 0.0, depth_m, camera, np.eye(4))
        return (time.process_time() - began) / 100

    assert min(seconds() for _ in range(10)) < 1e-4


def test_frames_of_files_pass_the_same_checks(
    tmp_path: Path, make_scene: Callable[..., Path]
) -> None:
    folder = make_scene(tmp_path / "s")
    image = np.full((6, 8), 2.0, dtype=np.float32)
    image[2, 2] = np.nan
    for old in sorted((folder / "depth").iterdir()):
        old.unlink()
        np.save(old.with_suffix(".npy"), image)
    read = read_bop(folder).frame(1)
    assert read.depth_m[2, 2] == 0.0
    assert np.count_nonzero(read.depth_m) == 47
