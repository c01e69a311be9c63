"""The commented pipeline file."""

import re
import tomllib
from pathlib import Path

import pytest

from pcnav.config.commented import commented_toml
from pcnav.config.pipeline_file import EstimatorTable, Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline, shipped_pipeline_names
from pcnav.files.toml_file import tables_of


@pytest.mark.parametrize("name", [None, "peer", *shipped_pipeline_names()])
def test_it_is_read_back_as_the_pipeline_it_is_of(name: str | None, tmp_path: Path) -> None:
    pipeline = Pipeline()
    if name == "peer":
        pipeline = Pipeline(estimator=EstimatorTable.model_validate({"kind": "kiss_icp", "x": 1}))
    elif name is not None:
        path = shipped_pipeline(name)
        assert path is not None
        pipeline = read_pipeline(path)
    (tmp_path / "all.toml").write_text(commented_toml(pipeline), encoding="utf-8")
    assert read_pipeline(tmp_path / "all.toml") == pipeline


def test_every_key_is_in_it_and_those_that_are_explained_are_explained() -> None:
    text = commented_toml(Pipeline())
    for table, model in tables_of(Pipeline).items():
        part = text.partition(f"[{table}]\n")[2].partition("\n\n")[0]
        for key in model.model_fields:
            assert re.search(rf"^(# )?{key} =", part, re.MULTILINE), (table, key)
    assert max(map(len, text.splitlines())) < 400
    near = text.partition("# min_range_m =  # 0.0 or more")[0].splitlines()[-1]
    assert near == "# Near gate, along the ray."
    assert 'motion = "auto"  # "auto" | "torque_free" | "kinematic"' in text
    assert "None" not in text
    # Alone, a table is what stands of it in the whole.
    alone = commented_toml(Pipeline(), "region")
    assert alone.rstrip("\n") in text
    assert tomllib.loads(alone) == {"region": {}}
