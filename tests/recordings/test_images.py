"""Folders of images, videos and monocular recordings: read, checked, refused in one line."""

import logging
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation
from pcnav.recordings.attitudes import write_camera_attitudes
from pcnav.recordings.images import is_image_sequence, open_images
from pcnav.recordings.monocular_tracks import (
    CameraFacts,
    is_monocular_recording,
    read_monocular_tracks,
    write_camera_file,
    write_monocular_tracks,
)
from pcnav.recordings.tracks import MonocularTracks, TrackFrame

CAMERA = PinholeCamera(64, 48, 100.0, 101.0, 31.0, 24.0)
FACTS = CameraFacts.of(CAMERA, 0.2)


def folder_of(path: Path, count: int = 4, rate_hz: float | None = 2.0) -> Path:
    """A folder of flat images, each brighter than the one before."""
    path.mkdir(exist_ok=True)
    for k in range(count):
        grey = np.full((48, 64), 20 * k, dtype=np.uint8)
        Image.fromarray(grey).save(path / f"{k:03d}.png")
    write_camera_file(path / "camera.toml", FACTS.model_copy(update={"frame_rate_hz": rate_hz}))
    return path


def test_images_in_the_order_of_their_names(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "seq")
    assert is_image_sequence(folder) and not is_monocular_recording(folder)
    images = open_images(folder)
    assert images.camera == CAMERA and images.name == "seq"
    read = list(images)
    assert [time_s for time_s, _, _ in read] == [0.0, 0.5, 1.0, 1.5]
    assert [int(image[0, 0]) for _, _, image in read] == [0, 20, 40, 60]
    assert all(np.array_equal(R, np.eye(3)) for _, R, _ in read)


def test_times_and_attitudes_of_the_folder_come_first(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "seq")
    (folder / "times.csv").write_text("time_s\n0\n1\n3\n4\n")
    R = exp_rotation(np.outer([0.0, 4.0], [0.0, 0.1, 0.0]))
    write_camera_attitudes(folder, np.array([0.0, 4.0]), R)
    images = open_images(folder)
    assert images.times_s.tolist() == [0.0, 1.0, 3.0, 4.0]
    assert images.R_cam_world[2] == pytest.approx(exp_rotation(np.array([0.0, 0.3, 0.0])))


def test_colour_and_16_bit_images_are_made_grey(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "seq", 2)
    Image.fromarray(np.full((48, 64, 3), 100, np.uint8)).save(folder / "000.png")
    Image.fromarray(np.full((48, 64), 100 * 257, np.uint16)).save(folder / "001.png")
    assert [int(image[0, 0]) for _, _, image in open_images(folder)] == [100, 100]


def test_without_any_time_images_are_a_second_apart_and_it_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = folder_of(tmp_path / "seq", rate_hz=None)
    with caplog.at_level(logging.WARNING, "pcnav"):
        assert open_images(folder).times_s.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert "1 s apart" in caplog.text


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: (f / "times.csv").write_text("time_s\n0\n1\n"), "one for each of 4 images"),
        (lambda f: (f / "times.csv").write_text("time_s\n0\n1\n1\n2\n"), "increase"),
        (lambda f: (f / "camera.toml").write_text("[camera]\n"), "missing"),
        (lambda f: (f / "camera.toml").unlink(), "camera.toml"),
        (lambda f: [p.unlink() for p in f.glob("*.png")], "expected PNG or JPEG"),
    ],
)
def test_bad_folders_are_refused(tmp_path: Path, spoil, message: str) -> None:
    folder = folder_of(tmp_path / "seq")
    spoil(folder)
    with pytest.raises(InputError, match=message):
        open_images(folder)


def test_bad_pictures_are_refused_by_name(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "seq")
    Image.fromarray(np.zeros((10, 10), np.uint8)).save(folder / "002.png")
    with pytest.raises(InputError, match=r"002\.png: image size: expected 64 x 48"):
        list(open_images(folder))
    (folder / "002.png").write_bytes(b"no image")
    with pytest.raises(InputError, match=r"002\.png"):
        list(open_images(folder))


def test_a_video(tmp_path: Path) -> None:
    cv2 = pytest.importorskip("cv2", reason="the extra `images` is not installed")
    path = tmp_path / "shots.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this build of OpenCV writes no Motion JPEG")
    for k in range(5):
        writer.write(np.full((48, 64, 3), 40 * k, dtype=np.uint8))
    writer.release()
    write_camera_file(path.with_suffix(".toml"), FACTS)
    assert is_image_sequence(path)
    read = list(open_images(path))
    assert [time_s for time_s, _, _ in read] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])
    assert [float(image.mean()) for _, _, image in read] == pytest.approx(
        [0.0, 40.0, 80.0, 120.0, 160.0], abs=3.0
    )
    path.write_bytes(b"no video")
    with pytest.raises(InputError, match="video"):
        open_images(path)


def test_a_video_without_a_camera_is_told_that_it_is_no_depth(tmp_path: Path) -> None:
    path = tmp_path / "flight.mp4"
    path.write_bytes(b"no video")
    with pytest.raises(InputError, match=r"expected flight\.toml or camera\.toml.*holds no depth"):
        open_images(path)


def test_distortion_is_taken_out(tmp_path: Path) -> None:
    pytest.importorskip("cv2", reason="the extra `images` is not installed")
    folder = folder_of(tmp_path / "seq", 1)
    image = np.zeros((48, 64), np.uint8)
    image[20:30, 50:56] = 200
    Image.fromarray(image).save(folder / "000.png")
    barrel = {"distortion": (-0.5, 0.0, 0.0, 0.0, 0.0), "frame_rate_hz": 1.0}
    facts = FACTS.model_copy(update=barrel)
    write_camera_file(folder / "camera.toml", facts)
    ((_, _, straight),) = open_images(folder)
    column = np.average(np.arange(64), weights=straight.sum(axis=0).astype(float))
    # A barrel draws points inwards: x (1 + k1 x^2) = 0.215 undone moves it out by 0.5 px.
    assert column > 52.5 + 0.3


def recording() -> MonocularTracks:
    rng = np.random.default_rng(0)
    counts = (9, 0, 12)
    return MonocularTracks(
        "rec",
        CAMERA,
        0.15,
        tuple(
            TrackFrame(
                0.5 * k,
                exp_rotation(np.array([0.0, 0.1 * k, 0.0])),
                rng.permutation(40)[:n],
                rng.uniform(0.0, 48.0, (n, 2)),
            )
            for k, n in enumerate(counts)
        ),
    )


def test_a_recording_comes_back_as_it_was(tmp_path: Path) -> None:
    tracks = recording()
    write_monocular_tracks(tmp_path / "rec", tracks)
    assert is_monocular_recording(tmp_path / "rec")
    assert not is_image_sequence(tmp_path / "rec")
    for path in (tmp_path / "rec", tmp_path / "rec" / "tracks.csv"):
        again = read_monocular_tracks(path)
        assert (again.name, again.camera, again.pixel_sigma_px) == ("rec", CAMERA, 0.15)
        for frame, other in zip(tracks.frames, again.frames, strict=True):
            assert other.time_s == frame.time_s
            assert np.array_equal(other.features, frame.features)
            assert np.array_equal(other.pixels, frame.pixels)
            assert other.R_cam_world == pytest.approx(frame.R_cam_world, abs=1e-14)
    with pytest.raises(InputError, match="overwrite"):
        write_monocular_tracks(tmp_path / "rec", tracks)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("0.2,1,2.0,3.0", "times in order"),
        ("1.0,1.5,2.0,3.0", "whole number"),
        ("1.0,1,nan,3.0", "finite"),
        ("1.0,1,2.0,3.0\n1.0,1,2.0,3.0", "each feature once"),
        ("1.0,1,2.0,3.0\n1.0,,,", "no other row at a time"),
    ],
)
def test_bad_rows_are_refused_with_their_line(tmp_path: Path, row: str, message: str) -> None:
    write_monocular_tracks(tmp_path / "rec", recording())
    with (tmp_path / "rec" / "tracks.csv").open("a") as file:
        # The last time of the recording is 1.0 s.
        file.write(row.replace("1.0,", "1.5,", 2 if "\n" in row else 1) + "\n")
    with pytest.raises(InputError, match=message) as caught:
        read_monocular_tracks(tmp_path / "rec")
    assert "line" in str(caught.value)
