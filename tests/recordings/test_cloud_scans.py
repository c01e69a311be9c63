"""Clouds of a LiDAR in any file are the same scans: rays, ranges and times of their points."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pcnav.config.recording import RecordingTable
from pcnav.core.errors import InputError
from pcnav.recordings.cloud import times_of_scan
from pcnav.recordings.converting import convert
from pcnav.recordings.opening import open_sequence

N, LASTS_S = 900, 0.2


def seen(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) of a wavy wall, x forward, y left, z up, and when each was seen, s."""
    rng = np.random.default_rng(k)
    y, z = rng.uniform(-2.0, 2.0, (2, N))
    x = 9.0 + 0.3 * np.sin(y) + 0.1 * k
    return np.column_stack([x, y, z]), np.sort(rng.uniform(0.0, LASTS_S, N))


def pcd(path: Path, points: np.ndarray, time_s: np.ndarray) -> None:
    form = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4")]
    rows = np.zeros(N, dtype=form)
    for axis, column in zip("xyz", points.T, strict=True):
        rows[axis] = column
    rows["t"] = np.rint(1e9 * time_s)
    header = (
        "VERSION .7\nFIELDS x y z intensity t\nSIZE 4 4 4 4 4\nTYPE F F F F U\nCOUNT 1 1 1 1 1\n"
        f"WIDTH {N}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {N}\nDATA binary\n"
    )
    path.write_bytes(header.encode() + rows.tobytes())


def ply(path: Path, points: np.ndarray, time_s: np.ndarray, order: str) -> None:
    numbers = np.column_stack([points, 1e6 * time_s])
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    header = (
        f"ply\nformat {name} 1.0\ncomment of a test\nelement vertex {N}\nproperty float x\n"
        "property float y\nproperty float z\nproperty double time\nelement face 0\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    if not order:
        text = "\n".join(" ".join(map(repr, row)) for row in numbers.tolist())
        path.write_bytes(header.encode() + text.encode())
        return
    form = [(axis, f"{order}f4") for axis in "xyz"] + [("time", f"{order}f8")]
    rows = np.zeros(N, dtype=form)
    for axis, column in zip(("x", "y", "z", "time"), numbers.T, strict=True):
        rows[axis] = column
    path.write_bytes(header.encode() + rows.tobytes())


WRITERS: dict[str, tuple[str, Callable[[Path, np.ndarray, np.ndarray], object]]] = {
    "pcd": (".pcd", pcd),
    "ply text": (".ply", lambda path, points, t: ply(path, points, t, "")),
    "ply little": (".ply", lambda path, points, t: ply(path, points, t, "<")),
    "ply big": (".ply", lambda path, points, t: ply(path, points, t, ">")),
    "npz": (".npz", lambda path, points, t: np.savez(path, points=points, timestamp=t + 1.7e9)),
    "npy": (".npy", lambda path, points, t: np.save(path, np.column_stack([points, 0.0 * t]))),
    "bin": (
        ".bin",
        lambda path, points, t: path.write_bytes(
            np.column_stack([points, 0.0 * t]).astype("<f4").tobytes()
        ),
    ),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_a_folder_of_clouds_of_a_lidar(kind: str, tmp_path: Path) -> None:
    suffix, write = WRITERS[kind]
    for k in range(3):
        write(tmp_path / f"{10.0 + 0.2 * k:.1f}{suffix}", *seen(k))
    found = open_sequence(tmp_path)
    assert found.times_s == pytest.approx([0.0, 0.2, 0.4]) or found.times_s[0] == 10.0
    for k in range(3):
        points, time_s = seen(k)
        beams = found.frame(k).beams
        assert beams is not None and len(beams.rays) == N
        p_cam = np.column_stack([-points[:, 1], -points[:, 2], points[:, 0]])
        np.testing.assert_allclose(beams.rays * beams.depth_m[:, None], p_cam, atol=2e-5)
        # KITTI's files, and arrays without a name, tell no times.
        timed = kind not in ("npy", "bin")
        expected = time_s - time_s[0] if timed else np.zeros(N)
        np.testing.assert_allclose(beams.time_s, expected, atol=2e-6)
        frame = found.frame(k)
        assert frame.unseen is not None
        np.testing.assert_array_equal(frame.unseen, beams.shown < 0)
        # One or two beams a pixel where the wall is.
        filled = np.count_nonzero(beams.is_seen)
        assert 1.2 < N / filled < 2.5
    assert (found.info.scan_s > 0.19) == timed


def test_axes_are_as_stated(tmp_path: Path) -> None:
    points, _ = seen(0)
    np.save(tmp_path / "0.npy", points - [0.0, 0.0, 3.0])
    (tmp_path / "sequence.toml").write_text('[sensor]\naxes = "camera"\n')
    with pytest.raises(InputError, match='axes = "camera"'):
        open_sequence(tmp_path)
    p_cam = np.column_stack([-points[:, 1], -points[:, 2], points[:, 0]])
    np.save(tmp_path / "0.npy", 1000.0 * p_cam)
    beams = open_sequence(tmp_path, table=RecordingTable(unit_m=0.001)).frame(0).beams
    assert beams is not None
    np.testing.assert_allclose(beams.rays * beams.depth_m[:, None], p_cam, atol=1e-9)


def test_scans_are_converted_to_our_own_format_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "clouds").mkdir()
    for k in range(2):
        np.savez(tmp_path / f"clouds/{k}.npz", points=seen(k)[0], t=seen(k)[1])
    read = open_sequence(tmp_path / "clouds", table=RecordingTable(frame_rate_hz=5.0))
    convert(read, tmp_path / "ours")
    again = open_sequence(tmp_path / "ours")
    assert again.info.scan_s == pytest.approx(read.info.scan_s, rel=0.02)
    for a, b in zip(read, again, strict=True):
        assert a.beams is not None and b.beams is not None
        np.testing.assert_allclose(b.beams.rays, a.beams.rays, rtol=1e-12)
        np.testing.assert_allclose(b.beams.depth_m, a.beams.depth_m, rtol=1e-6)
        np.testing.assert_array_equal(b.beams.time_s, a.beams.time_s)
        assert a.camera == b.camera


@pytest.mark.parametrize("unit_s", [1.0, 1e-3, 1e-6, 1e-9])
def test_the_unit_of_times_is_told_by_how_long_a_scan_lasts(unit_s: float) -> None:
    for lasts_s in (0.005, 0.1, 3.0):
        stamps = 12_345.0 + np.linspace(0.0, lasts_s / unit_s, 50)
        found, _ = times_of_scan(stamps)
        np.testing.assert_allclose(found, np.linspace(0.0, lasts_s, 50), atol=1e-6)
    with pytest.raises(ValueError, match="expected times of a scan"):
        times_of_scan(np.array([0.0, 1e-13]))


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bin", b"123", "reflectance of each point"),
        ("a.ply", b"ply\nformat ascii 1.0\nend_header\n", "expected 1 to"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
            b"property float z\nend_header\n1 2 3\n",
            "ends early",
        ),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
            b"property float z\nend_header\n1 2 none\n",
            "expected numbers",
        ),
        ("a.pcd", b"VERSION .7\nFIELDS x y z\nDATA binary\n", "expected FIELDS, SIZE, TYPE"),
    ],
)
def test_damaged_clouds_are_one_line(name: str, content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=words):
        open_sequence(tmp_path / name)
