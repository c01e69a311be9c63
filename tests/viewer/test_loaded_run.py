"""What the view knows of a run: of a finished one, an unfinished one, one without its frames."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from pcnav.cli.view import refuse_what_is_no_run
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import CENTRE, POSITION
from pcnav.recordings.truth import read_truth
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import RAW_COVARIANCES_FILE
from pcnav.viewer.curves import groups_of
from pcnav.viewer.layers import shot_of
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.loading import load_run
from pcnav.viewer.panels import facts_html, measurements_html
from tests.viewer.conftest import FRAMES


def test_covariances_are_those_of_the_result_folder(loaded: LoadedRun, run_folder: Path) -> None:
    P = read_run(run_folder, with_covariance=True).trajectory.covariance
    assert P is not None and len(loaded) == FRAMES
    assert np.array_equal(loaded.covariance(CENTRE, FRAMES - 1), P[-1, 6:9, 6:9])
    # The camera of this sequence is at rest in the turning frame: only the axes differ.
    spread = loaded.position_spread_cam(FRAMES - 1)
    assert np.allclose(np.linalg.eigvalsh(spread), np.linalg.eigvalsh(P[-1, :3, :3]), rtol=1e-6)
    assert loaded.trajectory.covariance is None


def test_the_ghost_is_where_the_truth_says(loaded: LoadedRun, run_folder: Path) -> None:
    truth = read_truth(run_folder.parent / "sequence")
    assert truth is not None and truth.T_cam_target is not None
    for frame in range(FRAMES):
        true = loaded.true_pose(frame)
        assert true is not None and np.allclose(true, truth.T_cam_target[frame])


def test_outlines_of_used_rectangles_lie_on_returns(loaded: LoadedRun) -> None:
    shot = shot_of(loaded, FRAMES - 1)
    assert shot is not None
    depth_m = shot.frame.depth_m[shot.frame.depth_m > 0.0]
    for record in loaded.records[shot.frame.time_s]:
        corners = record.corners_cam
        assert depth_m.min() - 0.2 < corners[:, 2].min()
        assert corners[:, 2].max() < depth_m.max() + 0.2


def test_facts_are_those_of_the_result_files(loaded: LoadedRun) -> None:
    last = FRAMES - 1
    facts = facts_html(loaded, last, None)
    assert "locked" in facts
    assert f"{np.linalg.norm(loaded.trajectory[POSITION][last]):.3f} m" in facts
    listed = measurements_html(loaded.records[float(loaded.run.time_s[last])])
    for record in loaded.records[float(loaded.run.time_s[last])]:
        assert record.rectangle in listed
        assert record.outcome in listed
    # Acquiring: nothing is known yet.
    assert "none" in facts_html(loaded, 0, None)


def test_text_of_a_run_cannot_become_markup(loaded: LoadedRun) -> None:
    from dataclasses import replace

    record = loaded.records[float(loaded.run.time_s[-1])][0]
    listed = measurements_html((replace(record, rectangle="<script>x</script>"),))
    assert "<script>" not in listed


def test_frames_of_another_run_are_matched_by_the_nearest_time(loaded: LoadedRun) -> None:
    step = float(loaded.run.time_s[1] - loaded.run.time_s[0])
    assert loaded.nearest_frame(float(loaded.run.time_s[3]) + 0.4 * step) == 3
    assert loaded.nearest_frame(float(loaded.run.time_s[-1]) + 0.6 * step) is None


def test_states_are_shown_when_the_frames_are_gone(run_folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "result"
    shutil.copytree(run_folder, copy)
    text = (copy / "pipeline.toml").read_text()
    lines = [
        "sequence = 'gone'" if line.startswith("sequence =") else line for line in text.splitlines()
    ]
    (copy / "pipeline.toml").write_text("\n".join(lines))
    loaded = load_run(copy)
    assert loaded.frames is None
    assert any("states only" in note for note in loaded.notes)
    assert load_run(copy, run_folder.parent / "sequence").frames is not None
    assert shot_of(loaded, FRAMES - 1) is None
    assert "locked" in facts_html(loaded, FRAMES - 1, None)
    # Without a truth the estimates are drawn.
    assert not groups_of(loaded)["position"]().charts[0].is_error


@pytest.mark.parametrize("cut", [0, 1, 700, 2000, 4000])
def test_a_run_that_was_killed_shows_its_whole_frames(
    run_folder: Path, tmp_path: Path, cut: int
) -> None:
    """Each table is cut somewhere, as buffers leave them."""
    part = tmp_path / ".result-1234"
    part.mkdir()
    for name in ("states.csv", "poses.tum", "measurements.csv"):
        content = (run_folder / name).read_bytes()
        (part / name).write_bytes(content[: len(content) - cut] if cut else content)
    (part / RAW_COVARIANCES_FILE).touch()
    shutil.copy(run_folder / "pipeline.toml", part)
    loaded = load_run(part)
    whole = load_run(run_folder)
    n = len(loaded)
    assert n == FRAMES if cut == 0 else n < FRAMES
    assert np.array_equal(loaded.T_cam_model, whole.T_cam_model[:n], equal_nan=True)
    assert loaded.notes == (f"unfinished: {n} frames so far in {part.name}",)


def test_a_run_that_has_only_begun_is_an_empty_one(run_folder: Path, tmp_path: Path) -> None:
    for name in ("states.csv", "measurements.csv"):
        header = (run_folder / name).read_text().splitlines(keepends=True)[0]
        (tmp_path / name).write_text(header)
    (tmp_path / "poses.tum").touch()
    (tmp_path / RAW_COVARIANCES_FILE).touch()
    shutil.copy(run_folder / "pipeline.toml", tmp_path)
    assert len(load_run(tmp_path)) == 0


def test_a_folder_that_is_no_run_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"states\.csv"):
        load_run(tmp_path)
    with pytest.raises(InputError, match=r"states\.csv"):
        refuse_what_is_no_run(tmp_path)


def test_an_unfinished_run_of_the_name_is_pointed_at(tmp_path: Path) -> None:
    (tmp_path / ".result-ab12").mkdir()
    with pytest.raises(InputError, match=r"\.result-ab12"):
        refuse_what_is_no_run(tmp_path / "result")
