"""A first pose as people state it: on a command line, in files, and beside a recording."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.config.pipeline_file import read_pipeline
from pcnav.core.errors import InputError
from pcnav.recordings.first_pose import parsed_first_pose, prior_of
from pcnav.recordings.sequence import FirstPosePrior, SequenceInfo
from pcnav.recordings.sequence_file import read_sequence_file, write_sequence_file

POSITION = [-0.2, 0.1, 3.0]
TURN = Rotation.from_rotvec([0.3, -0.8, 0.4])
NUMBERS = [*POSITION, *TURN.as_quat().tolist()]


def _pose() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = TURN.as_matrix(), POSITION
    return T


def _texts(folder: Path) -> list[str]:
    """The same pose in every form that is read."""
    numbers = " ".join(map(repr, NUMBERS))
    keys = {"position_cam_m": POSITION, "quaternion_cam_model_xyzw": NUMBERS[3:]}
    R = TURN.as_matrix().ravel().tolist()
    bop = {"cam_R_m2c": R, "cam_t_m2c": [1e3 * each for each in POSITION], "obj_id": 5}
    files = {
        "pose.tum": f"# time tx ty tz qx qy qz qw\n12.5 {numbers}\n",
        "seven.txt": f"{numbers}\n",
        "keys.json": json.dumps(keys),
        "scene_gt.json": json.dumps({"7": [bop]}),
    }
    for name, content in files.items():
        (folder / name).write_text(content, encoding="utf-8")
    return [numbers, numbers.replace(" ", ","), *(str(folder / name) for name in files)]


def test_every_form_gives_the_same_pose(tmp_path: Path) -> None:
    for text in _texts(tmp_path):
        prior = prior_of(parsed_first_pose(text))
        assert prior is not None, text
        np.testing.assert_allclose(prior.T_cam_model, _pose(), atol=1e-12, err_msg=text)
        assert prior.position_sd_m == pytest.approx(0.02 * np.linalg.norm(POSITION))
        assert prior.attitude_sd_rad == pytest.approx(np.deg2rad(5.0))


def test_a_stated_spread_replaces_that_of_a_file(tmp_path: Path) -> None:
    keys = {"position_cam_m": POSITION, "quaternion_cam_model_xyzw": NUMBERS[3:]}
    file = tmp_path / "pose.json"
    file.write_text(json.dumps({**keys, "position_sd_m": 0.5, "attitude_sd_deg": 2.0}))
    stated = prior_of(parsed_first_pose(str(file)))
    told = prior_of(parsed_first_pose(str(file), (0.01, 10.0)))
    assert stated is not None and told is not None
    assert (stated.position_sd_m, told.position_sd_m) == (0.5, 0.01)
    assert np.rad2deg(stated.attitude_sd_rad) == pytest.approx(2.0)
    assert np.rad2deg(told.attitude_sd_rad) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("text", "field", "expected"),
    [
        ("1 2 3", "pose", "got 3"),
        ("0 0 1 0 0 0 2", "quaternion_cam_model_xyzw", "length 2"),
        ("0 0 nan 0 0 0 1", "position_cam_m.2", "finite"),
        ("nowhere.tum", "file", "tx ty tz qx qy qz qw"),
    ],
)
def test_a_wrong_pose_is_named(text: str, field: str, expected: str) -> None:
    with pytest.raises(InputError) as error:
        parsed_first_pose(text)
    assert error.value.field == field
    assert expected in error.value.expected


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("", "one pose, got 0 lines"),
        ("0 0 0 1 0 0 0 1\n1 0 0 1 0 0 0 1\n", "one pose, got 2 lines"),
        ("{", "valid JSON"),
        ("[1, 2]", "keys of a first pose"),
        ("{}", "expected at least one pose"),
        ('{"position_cam_m": [0, 0, 1]}', "or neither"),
        ('{"attitude_sd_deg": 1.0}', "expected a pose that they are of"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, content: str, expected: str) -> None:
    file = tmp_path / "pose.txt"
    file.write_text(content, encoding="utf-8")
    with pytest.raises(InputError, match=expected) as error:
        parsed_first_pose(str(file))
    assert error.value.file == file


def test_sequence_toml_states_it_beside_what_is_known_of_the_mass(tmp_path: Path) -> None:
    file = tmp_path / "sequence.toml"
    prior = FirstPosePrior(_pose(), 0.03, 0.1)
    write_sequence_file(file, SequenceInfo("a", 0.0, 0.01, None, first_pose=prior))
    text = file.read_text(encoding="utf-8")
    file.write_text(f"{text}com_model_m = [0.0, 0.0, 0.1]\n", encoding="utf-8")
    info, form = read_sequence_file(file)
    assert info.first_pose is not None and info.initial is not None
    np.testing.assert_allclose(info.first_pose.T_cam_model, prior.T_cam_model, atol=1e-12)
    assert info.first_pose.position_sd_m == 0.03
    assert info.first_pose.attitude_sd_rad == pytest.approx(0.1)
    assert info.initial.com_model_m == (0.0, 0.0, 0.1)
    write_sequence_file(file, info, form)
    again, _ = read_sequence_file(file)
    assert again.initial is not None and again.first_pose is not None
    assert again.initial.com_model_m == info.initial.com_model_m
    again_pose, pose = again.first_pose.T_cam_model, info.first_pose.T_cam_model
    np.testing.assert_allclose(again_pose, pose, atol=1e-12)


def test_a_pipeline_file_states_it(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text(
        f"[initial_pose]\nposition_cam_m = {POSITION}\n"
        f"quaternion_cam_model_xyzw = {NUMBERS[3:]}\nposition_sd_m = 0.1\n"
    )
    prior = prior_of(read_pipeline(file).initial_pose)
    assert prior is not None
    np.testing.assert_allclose(prior.T_cam_model, _pose(), atol=1e-12)
