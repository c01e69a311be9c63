"""Scenes of BOP data sets: several objects, models in millimetres, masks, numbers with gaps."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from pcnav.config.length_unit import LengthUnit
from pcnav.config.recording import RecordingTable
from pcnav.config.region import RegionTable
from pcnav.core.errors import InputError
from pcnav.recordings.bop_models import stated_symmetries
from pcnav.recordings.intake import Intake
from pcnav.recordings.opening import open_recording, open_sequence
from pcnav.recordings.truth import truth_of
from pcnav.target.satellite import target_mesh_of

NUMBERS = (3, 17, 40)
IDENTITY = np.eye(3).ravel().tolist()


@pytest.fixture
def data_set(tmp_path: Path) -> Path:
    return write_data_set(tmp_path / "cubes")


def write_data_set(root: Path) -> Path:
    """Two scenes; in the second objects 2 and 9, in another order in frame 17."""
    for name in ("000001", "000007"):
        (root / "test" / name / "depth").mkdir(parents=True)
        (root / "test" / name / "mask_visib").mkdir()
        camera = {"cam_K": [20.0, 0.0, 3.5, 0.0, 21.0, 2.5, 0.0, 0.0, 1.0], "depth_scale": 0.1}
        cameras = {str(number): camera for number in NUMBERS}
        (root / "test" / name / "scene_camera.json").write_text(json.dumps(cameras))
        for number in NUMBERS:
            image = np.full((6, 8), 10_000 + number, dtype=np.uint16)
            Image.fromarray(image).save(root / "test" / name / "depth" / f"{number:06d}.png")
    scene, poses = root / "test" / "000007", {}
    for number in NUMBERS:
        order = (9, 2) if number == 17 else (2, 9)
        poses[str(number)] = [
            {"cam_R_m2c": IDENTITY, "cam_t_m2c": [0.0, 0.0, 100.0 * i + number], "obj_id": i}
            for i in order
        ]
        for place, i in enumerate(order):
            mask = np.zeros((6, 8), dtype=np.uint8)
            mask[:, i - 2] = 255
            Image.fromarray(mask).save(scene / "mask_visib" / f"{number:06d}_{place:06d}.png")
    (scene / "scene_gt.json").write_text(json.dumps(poses))
    (root / "models").mkdir()
    for i in (2, 9):
        trimesh.creation.box((10.0 * i, 50.0, 80.0)).export(root / "models" / f"obj_{i:06d}.ply")
    info = {
        "2": {"symmetries_discrete": [[-1, 0, 0, 20, 0, -1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]]},
        "9": {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]},
    }
    (root / "models" / "models_info.json").write_text(json.dumps(info))
    return root


def test_the_object_asked_for_is_the_target(
    data_set: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, logger="pcnav"):
        found = open_sequence(data_set / "test" / "000007", table=RecordingTable(object=9))
    assert "obj_000009.ply of the data set, in millimetres" in caplog.text
    mesh = found.info.target_mesh
    assert mesh is not None
    assert found.info.mesh_unit is LengthUnit.MILLIMETRE
    assert np.allclose(target_mesh_of(mesh, found.info.mesh_unit).extents, [0.09, 0.05, 0.08])
    assert [Path(name).stem for name in found.files] == ["000003", "000017", "000040"]
    truth = truth_of(found)
    assert truth is not None
    assert np.allclose(truth.poses[:, 2, 3], [0.903, 0.917, 0.94])
    frames = list(Intake(found, RegionTable(masks="visib"), skip_bad_frames=False))
    for frame in frames:
        assert np.flatnonzero(frame.depth_m.any(axis=0)).tolist() == [7]


def test_without_an_object_there_is_no_truth_but_a_recording(
    data_set: Path, caplog: pytest.LogCaptureFixture
) -> None:
    found = open_sequence(data_set / "test" / "000007")
    assert found.info.target_mesh is None
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        assert truth_of(found) is None
    assert "several objects: no truth; --object says which" in caplog.text
    other = open_sequence(data_set / "test" / "000007", table=RecordingTable(object=5))
    with pytest.raises(InputError, match=r"--object: expected one of the objects 2, 9, got 5"):
        truth_of(other)


def test_a_data_set_is_asked_which_of_its_scenes(data_set: Path) -> None:
    for path, first in ((data_set, "test/000001"), (data_set / "test", "000001")):
        with pytest.raises(InputError, match="expected one scene of the data set") as refused:
            open_recording(path)
        assert f"{path / first}; it has 2" in str(refused.value)


def test_the_data_set_states_symmetries_in_millimetres(data_set: Path) -> None:
    two = stated_symmetries(data_set / "models" / "obj_000002.ply")
    assert two is not None
    motions, axes = two
    assert axes == 0
    assert np.allclose(motions[1] @ [0.01, 0.0, 0.5, 1.0], [0.01, 0.0, 0.5, 1.0])
    nine = stated_symmetries(data_set / "models" / "obj_000009.ply")
    assert nine is not None
    assert (len(nine[0]), nine[1]) == (1, 1)
    path = data_set / "models" / "models_info.json"
    path.write_text('{"2": {"symmetries_discrete": [[1, 2]]}}')
    with pytest.raises(InputError, match=r"models_info.json: 000002: expected what BOP says"):
        stated_symmetries(data_set / "models" / "obj_000002.ply")
