"""Tables over recordings that lie in files."""

import json
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.batch.cluster import Workers
from pcnav.batch.recordings import RecordingsPlan, recordings_below, recordings_plan
from pcnav.batch.run_batch import run_alone, run_batch
from pcnav.batch.store import open_store
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.estimators.interface import Estimator, Given
from pcnav.estimators.registry import ESTIMATORS
from pcnav.recordings.sequence import Frame
from pcnav.runs.estimate import Estimate, Output
from tests.batch.stored_batch import rows_of
from tests.commands import Pcnav
from tests.recordings.conftest import write_scene

DISTANCE_M = 4.0
OFF_M = 0.02


class Told(Estimator):
    """Says where the box is, by as much off as the box is far, and misses the first frame."""

    output = Output(POSE_LAYOUT, has_nis=False, notes=("inlier_ratio",))

    def __init__(self, given: Given) -> None:
        assert given.T_cam_model_first is None, "nobody is told the truth"

    def step(self, frame: Frame, /) -> Estimate:
        if frame.index == 0:
            return Estimate(frame.time_s, "acquiring")
        T = np.eye(4)
        T[:3, 3] = (OFF_M, 0.0, DISTANCE_M)
        notes: dict[str, float] = {"inlier_ratio": 0.75}
        return Estimate(frame.time_s, "locked", T_cam_target=T, notes=notes)


@pytest.fixture(autouse=True)
def told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ESTIMATORS, "depth", replace(ESTIMATORS["depth"], make=Told))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two recordings, one of them with truth but in its last frame, one that is broken, a result
    and other files."""
    recordings = tmp_path / "recordings"
    write_scene(recordings / "with truth", (0, 1, 2, 3))
    pose = {
        "cam_R_m2c": np.eye(3).ravel().tolist(),
        "cam_t_m2c": [0.0, 0.0, 1e3 * DISTANCE_M],
        "obj_id": 1,
    }
    truth = {str(k): [pose] for k in range(3)}
    (recordings / "with truth" / "scene_gt.json").write_text(json.dumps(truth))
    write_scene(recordings / "without")
    shutil.copytree(recordings / "without", recordings / "broken")
    (recordings / "broken" / "scene_camera.json").write_text("{")
    shutil.copytree(recordings / "without", recordings / "result")
    (recordings / "result" / "states.csv").touch()
    (recordings / "notes.txt").touch()
    trimesh.creation.box(extents=(1.0, 2.0, 0.6)).export(tmp_path / "box.stl")
    return recordings


def planned(folder: Path) -> RecordingsPlan:
    return recordings_plan(folder, ["depth"], Pipeline(), mesh=folder.parent / "box.stl")


def test_recordings_are_found_and_results_are_none(folder: Path) -> None:
    found = [path.name for path in recordings_below(folder)]
    assert found == ["broken", "with truth", "without"]
    assert recordings_below(folder / "without") == (folder / "without",)
    scenes = folder.parent / "bop"
    for name in ("test/000001", "test/000002", "train/000001"):
        write_scene(scenes / name)
    (scenes / "models").mkdir()
    trimesh.creation.box().export(scenes / "models" / "obj_000001.ply")
    below = [path.relative_to(scenes).as_posix() for path in recordings_below(scenes)]
    assert below == ["test/000001", "test/000002", "train/000001"]
    plan = recordings_plan(scenes / "test", ["depth"], Pipeline(), objects=[2, 7])
    assert [case.name for case in plan.cases][:2] == [
        "recording=000001 object=2 estimator=depth",
        "recording=000001 object=7 estimator=depth",
    ]
    with pytest.raises(InputError, match="recordings of depth frames"):
        recordings_plan(scenes / "models", ["depth"], Pipeline())
    with pytest.raises(InputError, match="take depth frames"):
        recordings_plan(scenes, ["inertia_bank"], Pipeline())


def test_tables_have_what_needs_no_truth_and_errors_where_there_is_one(
    folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "batch"
    summary = run_batch(planned(folder), out, Workers(jobs=1))
    assert (summary.runs, len(summary.failures)) == (3, 1)
    assert all("scene_camera.json" in str(each.failure) for each in summary.failures)
    found = rows_of((out / "tables" / "found.csv").read_text())
    one = {row["recording"]: row for row in found}["without"]
    assert float(one["status_locked_pct"]) == pytest.approx(200.0 / 3.0)
    assert float(one["explained_median_pct"]) == 75.0
    assert float(one["time_to_lock_s"]) == 0.5
    errors = rows_of((out / "tables" / "errors.csv").read_text())
    assert [row["recording"] for row in errors] == ["with_truth"]
    assert float(errors[0]["position_sym_median_m"]) == pytest.approx(OFF_M)
    # Of three frames with a truth, two; the last one is right or wrong to nobody.
    assert float(errors[0]["locked_right_pct"]) == pytest.approx(200.0 / 3.0)
    assert float(errors[0]["locked_wrong_pct"]) == 0.0
    bop = rows_of((out / "tables" / "bop.csv").read_text())
    assert float(bop[0]["mssd_median_m"]) == pytest.approx(OFF_M)
    nearest_m = DISTANCE_M - 0.3
    assert float(bop[0]["mspd_median_px"]) == pytest.approx(20.0 * OFF_M / nearest_m)
    assert float(bop[0]["recall_mssd_pct"]) == 100.0
    pooled = rows_of((out / "tables" / "found_pooled.csv").read_text())
    # Recordings are drawn again, so that a mean of two that differ has an interval.
    low, high = (float(pooled[0][f"status_locked_pct_{end}"]) for end in ("low", "high"))
    assert low < float(pooled[0]["status_locked_pct"]) < high


def targets_file(root: Path, *rows: tuple[int, int, int]) -> Path:
    """Of scenes, images and objects, as BOP writes it."""
    keys = ("scene_id", "im_id", "obj_id")
    entries = [dict(zip(keys, row, strict=True)) | {"inst_count": 1} for row in rows]
    path = root / "test_targets_bop19.json"
    path.write_text(json.dumps(entries))
    return path


def test_a_targets_file_says_which_objects_and_images_are_asked_for(tmp_path: Path) -> None:
    scenes = tmp_path / "cubes"
    for name in ("test/000001", "test/000007", "train/000001"):
        write_scene(scenes / name)
    pose = {"cam_R_m2c": np.eye(3).ravel().tolist(), "cam_t_m2c": [0.0, 0.0, 1e3 * DISTANCE_M]}
    truth = {str(k): [pose | {"obj_id": 2}, pose | {"obj_id": 9}] for k in range(3)}
    (scenes / "test" / "000007" / "scene_gt.json").write_text(json.dumps(truth))
    targets_file(scenes, (7, 0, 9), (7, 2, 9), (7, 1, 2), (1, 0, 4))
    trimesh.creation.box(extents=(1.0, 2.0, 0.6)).export(tmp_path / "box.stl")
    plan = recordings_plan(scenes, ["depth"], Pipeline(), mesh=tmp_path / "box.stl")
    assert [case.name for case in plan.cases] == [
        "recording=test/000001 object=4 estimator=depth",
        "recording=test/000007 object=2 estimator=depth",
        "recording=test/000007 object=9 estimator=depth",
        # The file is about the test split alone.
        "recording=train/000001 estimator=depth",
    ]
    chosen = recordings_plan(scenes, ["depth"], Pipeline(), objects=[2])
    assert all("object=2" in case.name for case in chosen.cases)
    record = run_alone(plan, "recording=test/000007 object=9", 0, tmp_path / "out")
    # Of the frames with a truth, the recalls are over those that are asked for.
    assert np.isnan(record.columns["recall_mssd"]).tolist() == [False, True, False]
    assert np.isfinite(np.asarray(record.columns["mssd_m"])).any()


@pytest.mark.parametrize(
    "text", ["{}", '[{"scene_id": 1}]', "[", '[{"scene_id": -1, "im_id": 1, "obj_id": 1}]']
)
def test_a_targets_file_that_is_none_is_refused(tmp_path: Path, text: str) -> None:
    write_scene(tmp_path / "cubes" / "test" / "000001")
    (tmp_path / "cubes" / "test_targets_bop19.json").write_text(text)
    with pytest.raises(InputError, match=r"bop19\.json: .*expected a list of targets"):
        recordings_plan(tmp_path / "cubes", ["depth"], Pipeline())


def test_a_batch_goes_on_where_it_ended_and_only_with_the_same_recordings(
    folder: Path, tmp_path: Path
) -> None:
    out, plan = tmp_path / "batch", planned(folder)
    record = run_alone(plan, "recording=without", 0, out)
    assert record.failure is None and record.frames == 3
    place = open_store(out).path(record.run.key)
    before = place.stat().st_mtime_ns
    again = run_alone(plan, "recording=without", 0, out)
    assert again.frames == 3 and place.stat().st_mtime_ns == before
    assert len(open_store(out).missing) == 2
    with (folder / "without" / "depth" / "000001.png").open("ab") as file:
        file.write(b"more")
    with pytest.raises(InputError, match="runs of another"):
        run_alone(planned(folder), "recording=without", 0, out)


def test_the_command_runs_recordings_and_repeats_one(
    folder: Path, tmp_path: Path, pcnav: Pcnav
) -> None:
    target = ("--target", tmp_path / "box.stl")
    command = ("table", folder, *target, "-o", tmp_path / "out")
    answer = pcnav(*command, "--case", "recording=with_truth")
    assert answer.code == 0, answer.err
    assert "frames with a pose" in answer.out
    store = open_store(tmp_path / "out")
    assert len(store.missing) == 2
    words = shlex.split(store.record(store.keys[1]).command)
    assert words[words.index("--case") + 1] == "recording=with_truth estimator=depth"
    assert words[words.index("--target") + 1] == str(tmp_path / "box.stl")
    refused = pcnav("table", folder, "-o", tmp_path / "x", "--object", "one")
    assert refused.code == 2 and "--object" in refused.err
    refused = pcnav("table", "accuracy", "-o", tmp_path / "x", *target)
    assert refused.code == 2 and "--target: expected none" in refused.err
