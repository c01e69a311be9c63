"""Depth images of every format and form, written by others and by hand, against known depths."""

import json
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.recordings.bop import read_bop
from pcnav.recordings.depth_form import PLAIN, DepthForm, DepthIs
from pcnav.recordings.depth_image import read_depth_image
from pcnav.recordings.depth_stack import read_depth_stack
from pcnav.recordings.depth_units import depth_in_metres

MakeScene = Callable[..., Path]
CAMERA = PinholeCamera(8, 6, 20.0, 21.0, 3.5, 2.5)


def depths_m() -> np.ndarray:
    """(6, 8) depths with two holes, exact in 16-bit units of 1 mm."""
    depth_m = np.random.default_rng(3).integers(500, 9000, (6, 8)) / 1000.0
    depth_m[0, 0] = depth_m[3, 4] = 0.0
    return np.asarray(depth_m)


def write_tiff_tifffile(path: Path, image: np.ndarray, **options: Any) -> None:
    pytest.importorskip("tifffile").imwrite(path, image, **options)


def write_opencv(path: Path, image: np.ndarray) -> None:
    assert pytest.importorskip("cv2").imwrite(str(path), image)


def write_exr(path: Path, image: np.ndarray, name: str = "Z", **header: Any) -> None:
    exr = pytest.importorskip("OpenEXR")
    kind = {"compression": exr.ZIP_COMPRESSION, "type": exr.scanlineimage}
    exr.File({**kind, **header}, {name: np.ascontiguousarray(image)}).write(str(path))


WRITERS: dict[str, tuple[str, Callable[[Path, np.ndarray], None]]] = {
    "npy": (".npy", np.save),
    "npy big-endian": (".npy", lambda path, image: np.save(path, image.astype(">f4"))),
    "npy of one channel": (".npy", lambda path, image: np.save(path, image[..., None])),
    "npy by column": (".npy", lambda path, image: np.save(path, np.asfortranarray(image))),
    "tiff of tifffile": (".tiff", write_tiff_tifffile),
    "tiff, compressed": (
        ".tif",
        lambda path, image: write_tiff_tifffile(path, image, compression="zlib", predictor=False),
    ),
    "tiff in tiles": (".tif", lambda path, image: write_tiff_tifffile(path, image, tile=(16, 16))),
    "tiff, big-endian": (
        ".tif",
        lambda path, image: write_tiff_tifffile(path, image, byteorder=">"),
    ),
    "tiff of OpenCV": (".tiff", write_opencv),
    "tiff of Pillow": (".tif", lambda path, image: Image.fromarray(image).save(path)),
    "exr Z": (".exr", write_exr),
    "exr of a layer": (".exr", lambda path, image: write_exr(path, image, "ViewLayer.Depth.Z")),
    "exr of colours": (
        ".exr",
        lambda path, image: write_exr(path, np.dstack([image] * 3), "RGB"),
    ),
}


def replace_images(
    folder: Path, suffix: str, write: Callable[[Path, np.ndarray], None], image: np.ndarray
) -> None:
    for old in sorted((folder / "depth").iterdir()):
        old.unlink()
        write(old.with_suffix(suffix), image)


def edit_entries(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    file = folder / "scene_camera.json"
    content = json.loads(file.read_text())
    for entry in content.values():
        change(entry)
    file.write_text(json.dumps(content))


@pytest.mark.parametrize("kind", WRITERS)
def test_floats_are_metres_unless_a_scale_says_otherwise(
    tmp_path: Path, make_scene: MakeScene, kind: str
) -> None:
    suffix, write = WRITERS[kind]
    metres = depths_m().astype(np.float32)
    folder = make_scene(tmp_path / "metres")
    replace_images(folder, suffix, write, metres)
    edit_entries(folder, lambda entry: entry.pop("depth_scale"))
    for frame in read_bop(folder):
        assert frame.depth_m.dtype == np.float32
        np.testing.assert_array_equal(frame.depth_m, metres)
    edit_entries(folder, lambda entry: entry.update(depth_scale=1000.0))
    np.testing.assert_array_equal(read_bop(folder).frame(1).depth_m, metres)
    edit_entries(folder, lambda entry: entry.update(depth_scale=10.0))
    np.testing.assert_allclose(read_bop(folder).frame(1).depth_m, 0.01 * metres, rtol=1e-6)


@pytest.mark.parametrize("kind", ["npy", "tiff of tifffile", "tiff of Pillow", "tiff of OpenCV"])
@pytest.mark.parametrize("dtype", [np.uint16, np.int32])
def test_integers_need_a_scale(
    tmp_path: Path, make_scene: MakeScene, kind: str, dtype: type
) -> None:
    suffix, write = WRITERS[kind]
    if kind == "tiff of OpenCV" and dtype is not np.uint16:
        pytest.skip("OpenCV writes no such image")
    folder = make_scene(tmp_path / "units")
    replace_images(folder, suffix, write, np.rint(depths_m() * 1000.0).astype(dtype))
    edit_entries(folder, lambda entry: entry.update(depth_scale=1.0))
    np.testing.assert_allclose(read_bop(folder).frame(2).depth_m, depths_m(), rtol=1e-6)
    edit_entries(folder, lambda entry: entry.pop("depth_scale"))
    with pytest.raises(InputError, match="depth_scale: expected the mm of one unit"):
        read_bop(folder).frame(0)


def test_half_precision_and_the_window_of_an_exr(tmp_path: Path) -> None:
    metres = depths_m()
    write_exr(tmp_path / "half.exr", metres.astype(np.float16), "V")
    read = read_depth_image(tmp_path / "half.exr")
    np.testing.assert_allclose(read, metres, rtol=1e-3)
    corners = [(np.array([0, 0]), np.array([11, 9])), (np.array([2, 3]), np.array([9, 8]))]
    names = ("displayWindow", "dataWindow")
    windows: dict[str, Any] = {
        name: tuple(np.asarray(c, dtype=np.int32) for c in corner)
        for name, corner in zip(names, corners, strict=True)
    }
    write_exr(tmp_path / "part.exr", metres.astype(np.float32), **windows)
    whole = read_depth_image(tmp_path / "part.exr")
    assert whole.shape == (10, 12)
    np.testing.assert_array_equal(whole[3:9, 2:10], metres.astype(np.float32))
    assert np.count_nonzero(whole) == np.count_nonzero(metres)


def test_an_exr_without_a_channel_of_depth(tmp_path: Path) -> None:
    colours = np.random.default_rng(0).random((6, 8, 3)).astype(np.float32)
    write_exr(tmp_path / "colours.exr", colours, "RGB")
    with pytest.raises(InputError, match=r"channels: expected one channel.*got B, G, R"):
        read_depth_image(tmp_path / "colours.exr")


@pytest.mark.parametrize("suffix", [".npy", ".tiff", ".exr"])
def test_damage_is_told_in_one_line(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"image{suffix}"
    kind = {".npy": "npy", ".tiff": "tiff of Pillow", ".exr": "exr Z"}[suffix]
    WRITERS[kind][1](path, depths_m().astype(np.float32))
    data = path.read_bytes()
    for length in (0, 5, 40, len(data) // 2, len(data) - 20):
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match="expected an undamaged") as caught:
            read_depth_image(path)
        assert caught.value.file == path
        assert "\n" not in str(caught.value)
    path.unlink()
    with pytest.raises(InputError, match="expected a depth image"):
        read_depth_image(path)


def test_arrays_that_are_no_depth_image(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((4, 5, 3)))
    with pytest.raises(InputError, match="one plane of depth, got an array of 4 x 5 x 3"):
        read_depth_image(path)
    np.save(path, np.zeros((4, 5), dtype=complex))
    with pytest.raises(InputError, match="integers or floats, got complex128"):
        read_depth_image(path)
    np.save(path, np.array([[{}]], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="undamaged NPY"):
        read_depth_image(path)
    # A header that promises more than the file holds must not be believed.
    header = {"descr": "<f8", "fortran_order": False, "shape": (10**6, 10**6)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with pytest.raises(InputError, match="it ends early"):
        read_depth_image(path)
    Image.new("RGB", (5, 4)).save(tmp_path / "colour.tif")
    with pytest.raises(InputError, match="got pixels of the kind RGB"):
        read_depth_image(tmp_path / "colour.tif")
    with pytest.raises(InputError, match=r"expected a depth image \(\.png"):
        read_depth_image(tmp_path / "depth.jpg")


def test_two_images_of_one_frame_are_refused(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "two")
    np.save(folder / "depth" / "000001.npy", depths_m())
    with pytest.raises(InputError, match=r"expected one depth image.*000001\.png and 000001\.npy"):
        read_bop(folder)


def test_holes_of_floats() -> None:
    stored = np.full((6, 8), 2.0, dtype=np.float32)
    stored[0, :7] = [0.0, np.nan, np.inf, -np.inf, -1.0, 1e10, -0.0]
    stored[1, 0] = 7.5
    depth_m = depth_in_metres(stored, 1.0, DepthForm(invalid_units=7.5), CAMERA)
    np.testing.assert_array_equal(depth_m[0], [0, 0, 0, 0, 0, 0, 0, 2])
    assert depth_m[1, 0] == 0.0
    assert np.count_nonzero(depth_m) == 40
    assert stored[0, 4] == -1.0


def test_full_scale_is_a_hole_unless_a_surface_is_there() -> None:
    rng = np.random.default_rng(5)
    stored = np.full((40, 40), 900, dtype=np.uint16)
    stored[:10] = 65535
    assert np.count_nonzero(depth_in_metres(stored, 0.001, PLAIN, CAMERA)) == 1200
    # A noisy wall about full scale: what is clipped is no more than what lies just below.
    wall = np.clip(np.rint(rng.normal(65515.0, 20.0, (40, 40))), 0, 65535).astype(np.uint16)
    at_full_scale = int(np.count_nonzero(wall == 65535))
    assert at_full_scale > 100
    assert np.count_nonzero(depth_in_metres(wall, 0.001, PLAIN, CAMERA)) == 1600
    # And of one beyond it nearly everything is clipped.
    beyond = np.clip(np.rint(rng.normal(65600.0, 30.0, (40, 40))), 0, 65535).astype(np.uint16)
    kept = np.count_nonzero(depth_in_metres(beyond, 0.001, PLAIN, CAMERA))
    assert kept == np.count_nonzero(beyond < 65535) < 100


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_range_images_against_ray_distances(dtype: type) -> None:
    """A box and a sphere: distances along rays of trimesh against the z of its hits."""
    camera = PinholeCamera(64, 48, 40.0, 42.0, 30.7, 22.9)
    scene = trimesh.util.concatenate(
        [
            trimesh.creation.box(
                (1.5, 1.0, 0.8), trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0, 0, 0))
            ),
            trimesh.creation.icosphere(2, 0.4).apply_translation((1.0, 0.6, 0.3)),
        ]
    )
    assert isinstance(scene, trimesh.Trimesh)
    scene.apply_translation((0.2, -0.1, 2.5))
    v, u = np.mgrid[:48, :64]
    rays = np.stack([(u - 30.7) / 40.0, (v - 22.9) / 42.0, np.ones(u.shape)], axis=-1).reshape(
        -1, 3
    )
    hits, index, _ = scene.ray.intersects_location(np.zeros_like(rays), rays, multiple_hits=False)
    distance, z = np.zeros(len(rays)), np.zeros(len(rays))
    distance[index], z[index] = np.linalg.norm(hits, axis=1), hits[:, 2]
    assert len(index) > 500
    step_m = 1.0 if dtype is np.float32 else 1e-4
    stored = distance / step_m
    stored = (stored if dtype is np.float32 else np.rint(stored)).astype(dtype).reshape(48, 64)
    form = DepthForm(depth_is=DepthIs.RANGE)
    depth_m = depth_in_metres(stored, step_m, form, camera)
    assert depth_m.dtype == np.float32
    tolerance = 5e-7 if dtype is np.float32 else 0.51 * step_m
    np.testing.assert_allclose(depth_m.ravel(), z, atol=tolerance)
    # Taken for z it would be off by centimetres.
    assert np.abs(depth_in_metres(stored, step_m, PLAIN, camera).ravel() - z).max() > 0.1


def test_a_missing_library_is_told_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(InputError, match=r"expected the extra `formats` to be installed.*a\.exr"):
        read_depth_image(tmp_path / "a.exr")


@pytest.mark.parametrize("pages", [False, True])
def test_a_decoder_that_stumbles_is_one_line(tmp_path: Path, pages: bool) -> None:
    """A TIFF without its width: Pillow raises an error of types."""
    write_tiff_tifffile(tmp_path / "a.tif", np.full((6, 8), 1000, dtype=np.uint16))
    data = (tmp_path / "a.tif").read_bytes()
    width = struct.pack("<HHI", 256, 4, 1)
    assert data.count(width) == 1
    (tmp_path / "a.tif").write_bytes(data.replace(width, struct.pack("<HHI", 32768, 4, 1)))
    (tmp_path / "depth_camera.toml").write_text("fx = 20\nfy = 20\ncx = 3.5\ncy = 2.5\n")
    with pytest.raises(InputError, match=r"a\.tif: file: expected an undamaged TIFF \("):
        read_depth_stack(tmp_path / "a.tif") if pages else read_depth_image(tmp_path / "a.tif")
