"""Organised clouds in PCD files, as Open3D and others write them, are depth images."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.recording import RecordingTable
from pcnav.core.errors import InputError
from pcnav.recordings.opening import open_sequence

CAMERA = (90.0, 91.0, 24.5, 19.5)


def points() -> np.ndarray:
    """(40, 50, 3) of a tilted plane with a hole."""
    v, u = np.mgrid[:40, :50]
    z = 2.0 + 0.01 * u
    z[5:9, 5:9] = np.nan
    fx, fy, cx, cy = CAMERA
    return np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=-1).astype(np.float32)


def write_pcd(path: Path, cloud: np.ndarray, data: str = "binary", height: int = 40) -> Path:
    """With a field before and padding behind x, y, z."""
    n = cloud.shape[0] * cloud.shape[1]
    form = [("i", "<u2"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("p", "<u1", (3,))]
    rows = np.zeros(n, dtype=form)
    for k, axis in enumerate("xyz"):
        rows[axis] = cloud.reshape(-1, 3)[:, k]
    header = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS i x y z _\nSIZE 2 4 4 4 1\nTYPE U F F F U\n"
        f"COUNT 1 1 1 1 3\nWIDTH {n // height}\nHEIGHT {height}\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {n}\nDATA {data}\n"
    ).encode()
    text = "\n".join(f"7 {x!r} {y!r} {z!r} 0 0 0" for x, y, z in cloud.reshape(-1, 3).tolist())
    path.write_bytes(header + (text.encode() if data == "ascii" else rows.tobytes()))
    return path


@pytest.mark.parametrize("data", ["binary", "ascii"])
def test_a_folder_of_clouds(data: str, tmp_path: Path) -> None:
    cloud = points()
    for name in ("10.25", "10.5", "11.0"):
        write_pcd(tmp_path / f"{name}.pcd", cloud, data)
    found = open_sequence(tmp_path)
    assert found.times_s.tolist() == [10.25, 10.5, 11.0]
    assert np.allclose(found.intrinsics, [CAMERA] * 3, atol=1e-3)
    frame = found.frame(1)
    assert np.array_equal(frame.depth_m, np.nan_to_num(cloud[..., 2]))
    told = open_sequence(tmp_path / "10.5.pcd", table=RecordingTable(camera_px=CAMERA))
    assert (told.camera(0).fx, len(told)) == (90.0, 1)


def test_what_is_not_read_is_said(tmp_path: Path) -> None:
    trimesh.PointCloud(points().reshape(-1, 3)[60:69]).export(tmp_path / "a.ply")
    cases = (
        (write_pcd(tmp_path / "zip.pcd", points(), "binary_compressed"), "not read yet, got bin"),
        (tmp_path / "a.ply", "at least 100 points"),
    )
    cut = tmp_path / "cut.pcd"
    cut.write_bytes(write_pcd(tmp_path / "b.pcd", points()).read_bytes()[:-9])
    none = tmp_path / "none.pcd"
    none.write_bytes(b"VERSION .7\nFIELDS x y z\nDATA binary\n")
    for path, words in (*cases, (cut, "ends early"), (none, "expected FIELDS, SIZE, TYPE")):
        with pytest.raises(InputError) as refused:
            open_sequence(path)
        assert words in str(refused.value), refused.value
        assert str(path) in str(refused.value)
    flat = write_pcd(tmp_path / "flat.pcd", points(), height=1)
    with pytest.raises(InputError, match="rows and columns of the camera"):
        open_sequence(flat, table=RecordingTable(camera_px=CAMERA))


def test_a_cloud_in_one_row_is_a_scan(tmp_path: Path) -> None:
    cloud = points()
    frame = open_sequence(write_pcd(tmp_path / "flat.pcd", cloud, height=1)).frame(0)
    assert frame.beams is not None
    expected = cloud[np.isfinite(cloud).all(axis=-1)]
    found = frame.beams.rays * frame.beams.depth_m[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-6)
