"""Format recognition and the tsdf-fusion reader."""

import logging
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform, nearest_orthogonal, rotation_fault
from pcnav.recordings.opening import open_recording, open_sequence
from pcnav.recordings.recording import RecordingKind
from pcnav.recordings.sequence import Sequence

ROTATION = exp_rotation(np.array([0.3, -0.2, 0.9]))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two frames, numbered 3 and 12, with poses rounded to three digits."""
    folder = tmp_path / "recording"
    folder.mkdir()
    np.savetxt(folder / "camera-intrinsics.txt", np.array([[50, 0, 3.5], [0, 51, 2.5], [0, 0, 1]]))
    for number in (12, 3):
        image = np.full((6, 8), 1000 + number, np.uint16)
        image[0, :2] = 0, 65535
        Image.fromarray(image).save(folder / f"frame-{number:06d}.depth.png")
        T = make_transform(ROTATION.round(3), np.array([0.1, 0.2, number]))
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", T)
    return folder


def test_recording_values(recording: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        sequence = open_sequence(recording)
    assert len(caplog.records) == 1
    assert "nearest rotation" in caplog.records[0].getMessage()
    frames = list(sequence)
    assert [frame.time_s for frame in frames] == [0.0, 1.0]
    assert frames[1].depth_m[3, 3] == pytest.approx(1.012)
    assert frames[0].depth_m[3, 3] == pytest.approx(1.003)
    assert frames[0].depth_m[0, :3].tolist() == pytest.approx([0.0, 0.0, 1.003])
    assert (frames[0].camera.fx, frames[0].camera.fy) == (50.0, 51.0)
    T = frames[1].T_cam_world
    assert rotation_fault(T[:3, :3], 1e-14) is None
    np.testing.assert_allclose(T[:3, :3].T, ROTATION, atol=2e-3)
    # The pose is camera to world: the camera's place in the world is its translation.
    np.testing.assert_allclose(-T[:3, :3].T @ T[:3, 3], [0.1, 0.2, 12.0], atol=1e-12)


def test_nearest_orthogonal_is_a_minimum() -> None:
    rng = np.random.default_rng(5)
    matrix = ROTATION + 0.01 * rng.standard_normal((3, 3))
    nearest = nearest_orthogonal(matrix)
    best = np.linalg.norm(nearest - matrix)
    for axis in np.eye(3):
        for angle in (-1e-3, 1e-3):
            assert np.linalg.norm(nearest @ exp_rotation(angle * axis) - matrix) > best


def test_recording_faults(recording: Path) -> None:
    pose = recording / "frame-000003.pose.txt"
    text = pose.read_text()
    for content, field, words in (
        ("1 2 3\n", "matrix", "4 rows of 4"),
        (text.replace("0.000000000000000000e+00", "nan", 1), "matrix", "finite"),
        ("a b c d\n" * 4, "matrix", "4 rows of 4"),
        ("2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "matrix", "rigid"),
        ("-1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "matrix", "rigid"),
        (None, "file", "4 rows of 4"),
    ):
        pose.unlink()
        if content is not None:
            pose.write_text(content)
        with pytest.raises(InputError) as caught:
            open_sequence(recording)
        assert caught.value.file == pose
        assert caught.value.field == field
        assert words in caught.value.expected
        pose.write_text(text)
    np.savetxt(
        recording / "camera-intrinsics.txt", np.array([[0, 0, 3.5], [0, 51, 2.5], [0, 0, 1]])
    )
    with pytest.raises(InputError, match="focal"):
        open_sequence(recording)


def test_formats_are_recognised(tmp_path: Path, scene: Path) -> None:
    assert open_sequence(scene).images == scene / "depth"
    (scene / "scene_camera.json").unlink()
    with pytest.raises(InputError, match=r"scene_camera\.json: file: expected a readable file"):
        open_sequence(scene)
    empty = tmp_path / "empty"
    empty.mkdir()
    for path in (empty, tmp_path / "absent"):
        with pytest.raises(InputError, match=r"scene_camera\.json .* or camera-intrinsics\.txt"):
            open_sequence(path)


def test_real_recording(
    shared_data: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kinect = shared_data / "kinect"
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        sequence = open_sequence(kinect)
    assert len(sequence) == 30
    assert "off by up to 1.2e-04" in caplog.records[0].getMessage()
    first = sequence.frame(0)
    assert first.depth_m.shape == (480, 640)
    valid = first.depth_m[first.depth_m > 0.0]
    assert 0.8 < np.median(valid) < 4.0
    # A truncated copy is told.
    shutil.copytree(kinect, tmp_path / "cut")
    image = tmp_path / "cut" / "frame-000004.depth.png"
    image.write_bytes((kinect / image.name).read_bytes()[:50_000])
    with pytest.raises(InputError, match="ends early"):
        open_sequence(tmp_path / "cut").frame(4)


def test_kinds_are_told(tmp_path: Path, scene: Path) -> None:
    (scene / "attitudes.csv").write_text("time_s,q_x,q_y,q_z,q_w\n0,0,0,0,1\n1,,,,\n")
    attitudes = open_recording(scene)
    assert attitudes.kind is RecordingKind.ATTITUDES
    assert [frame.R_world_body is None for frame in attitudes] == [False, True]
    depth = open_recording(scene, kinds=[RecordingKind.DEPTH])
    assert isinstance(depth, Sequence) and depth.kind is RecordingKind.DEPTH
    assert (depth.path, len(list(depth))) == (scene, len(depth))
    with pytest.raises(InputError, match=r"expected tracks\.csv \(stereo tracks\) in it"):
        open_recording(scene, kinds=[RecordingKind.STEREO_TRACKS])
    with pytest.raises(InputError, match="target_mesh: expected none"):
        open_recording(scene, tmp_path / "some.stl")
