"""The files that were once answered by a traceback, a hang or all of the memory."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from pcnav.batch.record import read_record
from pcnav.target.satellite import load_target
from tests.fuzz.run import GOOD, outcome_of
from tests.fuzz.subject import Subject
from tests.fuzz.subjects import SUBJECTS

pytestmark = pytest.mark.study
_STANDS_FOR = (
    (r"batch\.json", "batch compare", "batch.json"),
    (r"camera\.toml", "images", "camera.toml"),
    (r"grid_toml", "grid", "g.toml"),
    (r"mesh_sidecar", "mesh sidecar", "sat.toml"),
    (r"pipeline_simulate_images", "pipeline images", "p.toml"),
    (r"pipeline_simulate_tracks", "pipeline stereo", "p.toml"),
    (r"pipeline_run_attitudes", "pipeline attitudes", "p.toml"),
    (r"pipeline_", "pipeline depth", "p.toml"),
    (r"rig\.toml", "stereo tracks", "rig.toml"),
    (r"sequence\.toml", "sequence", "sequence.toml"),
    (r"view_covariances\.npz", "run depth", "covariances.npz"),
    (r"view_i_states\.csv", "run image_motion", "states.csv"),
    (r"view_unfinished_measurements", "unfinished run", "measurements.csv"),
    (r".*pipeline\.toml", "run depth", "pipeline.toml"),
)
"""Beginning of an example's name, the good files that it is laid among, and which it replaces."""


def _of(read: Callable[[Path], object], file: Path) -> Callable[[Path], object]:
    """The reader of one file, wherever it is asked to read."""
    return lambda _: read(file)


def test_every_example_is_read_or_refused_in_one_line(shared_data: Path, tmp_path: Path) -> None:
    examples = sorted(path for path in (shared_data / "bad_inputs").iterdir() if path.is_dir())
    subjects = {subject.name: subject for subject in SUBJECTS}
    bad = []
    for example in examples:
        (file,) = example.iterdir()
        place = tmp_path / example.name
        if example.name.startswith("parquet_"):
            subject, place = Subject("", Path.mkdir, (), _of(read_record, file)), example
        elif example.name.startswith(("mesh_glb", "mesh_obj")):
            subject, place = Subject("", Path.mkdir, (), _of(load_target, file)), example
        else:
            name, target = next(
                (name, target)
                for start, name, target in _STANDS_FOR
                if re.match(start, example.name)
            )
            subject = subjects[name]
            subject.build(place)
            shutil.copyfile(file, place / target)
        came = outcome_of(subject, place)
        if came.kind not in GOOD:
            bad.append(f"{example.name}: {came}")
    assert len(examples) >= 40 and not bad, "\n".join(bad)
