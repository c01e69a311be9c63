"""The examples of the documentation run as they stand."""

import ast
import importlib
import runpy
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
import pytest

import pcnav
from tests.rendered import EPOCH_S, HEIGHT, WIDTH, K, rendered_scene

SKETCHES = ("cluster", "ros2_node")
MAX_LINES = 60


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with all that the examples need."""
    folder, scene = tmp_path_factory.mktemp("examples"), rendered_scene()
    scene.mesh.export(folder / "satellite.stl")
    times_s = EPOCH_S + np.array(scene.times_s)
    np.savez(folder / "frames.npz", depth=np.array(scene.depths), time_s=times_s, K=K)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        yield folder


def run_example(repository: Path, name: str) -> None:
    with matplotlib.rc_context({"backend": "agg"}):
        runpy.run_path(str(repository / "docs" / "examples" / f"{name}.py"), run_name="__main__")


@pytest.mark.usefixtures("quick_drawings")
def test_the_examples_run_and_tell_what_they_promise(
    repository: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_example(repository, "write_recording")
    assert capsys.readouterr().out.splitlines() == ["one.npz 6", "folder 6", "tum 6"]
    run_example(repository, "numpy_loop")
    assert "locked" in capsys.readouterr().out
    assert (place / "run" / "report.html").is_file()
    run_example(repository, "read_results")
    assert "<Run run: 6 frames of depth" in capsys.readouterr().out
    run_example(repository, "plot_results")
    assert (place / "rate.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.study
def test_the_other_examples_run(
    repository: Path, place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_example(repository, "own_mesh")
    assert capsys.readouterr().out.count("<Target ") == 4
    run_example(repository, "forecast")
    told = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in told] == ["in 1 s", "in 10 s", "in 60 s"]
    scene = rendered_scene()
    target = pcnav.Target.from_mesh(scene.mesh, unit="mm")
    tracker = pcnav.Tracker(target, K, keep_frames=True)
    for depth, t in list(zip(scene.depths, scene.times_s, strict=True))[:2]:
        tracker.step(depth, t)
    tracker.save("short", report=False, recording="frames")
    run_example(repository, "recording_to_poses")
    assert capsys.readouterr().out.count("<Estimate at") == 2
    (place / "recordings" / "empty").mkdir(parents=True)
    (place / "frames").rename(place / "recordings" / "frames")
    run_example(repository, "batch")
    table = pd.read_csv("results.csv", index_col="recording")
    assert table.loc["frames", "claimed"] == 0.0
    assert "scene_camera.json" in str(table.loc["empty", "fault"])


def test_every_example_is_short_and_uses_what_there_is(repository: Path) -> None:
    """Also those that are not run: every name of pcnav in them exists."""
    files = sorted((repository / "docs" / "examples").glob("*.py"))
    assert {*SKETCHES} < {path.stem for path in files}
    tracker = pcnav.Tracker(pcnav.Target.from_mesh("cubesat6u"), K)
    known = {"tracker": tracker, "est": tracker.step(np.zeros((HEIGHT, WIDTH)), 0.0)}
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert len(text.splitlines()) <= MAX_LINES, path
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                whole = {"pcnav": pcnav, **known}.get(node.value.id)
                assert whole is None or hasattr(whole, node.attr), (path.name, node.attr)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pcnav."):
                module = importlib.import_module(str(node.module))
                assert all(hasattr(module, alias.name) for alias in node.names), path
