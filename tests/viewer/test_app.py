"""The web view: what it says of a run, and whom it lets in."""

import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pcnav.config import Pipeline
from pcnav.errors import InputError
from pcnav.evaluation.overlay import rectangle_corners
from pcnav.pipeline import run
from pcnav.simulation.recording import simulate
from pcnav.target import load_target
from pcnav.viewer.app import RunData, frame_facts, load_run, serve

FRAMES = 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Path:
    """A result folder beside the sequence it was made from."""
    base = tmp_path_factory.mktemp("viewer")
    pipeline = Pipeline.model_validate(
        {
            "scenario": {"frames": FRAMES},
            "orbit": {"r_hill_m": (20.0, 0.0, 0.0)},
            "camera": {"horizontal_fov_deg": 32.0},
            "body": {
                "omega_body_deg_s": (1.0, -1.0, 2.0),
                "attitude_rotvec_deg": (25.0, 40.0, -30.0),
            },
        }
    )
    simulate(pipeline, load_target(repository / "meshes" / "boxsat.obj"), base / "sequence")
    run(base / "sequence", base / "result", pipeline)
    return base / "result"


@pytest.fixture(scope="module")
def data(folder: Path) -> RunData:
    return load_run(folder)


@pytest.fixture
def address(data: RunData) -> Iterator[str]:
    server = serve(data, "127.0.0.1", 8731)
    yield f"http://127.0.0.1:{server.get_port()}"
    server.stop()


def test_facts_are_those_of_the_result_files(data: RunData) -> None:
    last = FRAMES - 1
    facts = frame_facts(data, last)
    assert "locked" in facts
    distance = np.linalg.norm(data.track.T_cam_model[last, :3, 3])
    assert f"range {distance:.3f} m" in facts
    for record in data.records[float(data.track.time_s[last])]:
        assert record.rectangle in facts
    assert "range" not in frame_facts(data, 0)  # acquiring: nothing is known yet


def test_the_frames_are_those_of_the_sequence(data: RunData) -> None:
    assert data.sequence is not None
    assert len(data.sequence) == len(data.track) == FRAMES


def test_outlines_of_used_rectangles_lie_on_returns(data: RunData) -> None:
    assert data.sequence is not None
    frame = data.sequence.frame(FRAMES - 1)
    seen = frame.depth_m[frame.depth_m > 0.0]
    for record in data.records[frame.time_s]:
        corners = rectangle_corners(record)
        assert seen.min() - 0.2 < corners[:, 2].min() < corners[:, 2].max() < seen.max() + 0.2


def test_page_is_served_on_loopback(address: str) -> None:
    with urllib.request.urlopen(address, timeout=10) as answer:
        assert answer.status == 200
        assert b"<html" in answer.read().lower()


def test_nobody_can_open_a_public_tunnel(data: RunData) -> None:
    server = serve(data, "127.0.0.1", 8741)
    try:
        assert server.request_share_url() is None
    finally:
        server.stop()


def test_states_are_shown_when_the_frames_are_gone(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "result"
    copy.mkdir()
    for file in folder.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    text = (copy / "pipeline.toml").read_text()
    lines = [
        "sequence = 'gone'" if line.startswith("sequence =") else line for line in text.splitlines()
    ]
    (copy / "pipeline.toml").write_text("\n".join(lines))
    data = load_run(copy)
    assert data.sequence is None
    assert "locked" in frame_facts(data, FRAMES - 1)


def test_a_folder_that_is_no_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"states\.csv"):
        load_run(tmp_path)
