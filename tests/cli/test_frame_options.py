"""What the options for depth frames make of a pipeline."""

from pathlib import Path

import pytest

from pcnav.cli.frame_options import with_frame_options
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.region import RegionTable
from pcnav.core.errors import InputError


def test_without_options_a_pipeline_stays() -> None:
    assert with_frame_options(None, Path("pipeline")) is None
    pipeline = Pipeline(seed=3)
    assert with_frame_options(pipeline, Path("p.toml")) == pipeline


def test_options_replace_single_settings_of_the_file() -> None:
    stated = RegionTable(min_range_m=0.1, max_range_m=2.0, masks="visib")
    pipeline = Pipeline(region=stated, seed=3)
    made = with_frame_options(
        *(pipeline, Path("p.toml")), max_range=1.5, box=(1, 2, 3, 4), skip_bad_frames=True
    )
    assert made is not None
    expected = stated.model_copy(update={"max_range_m": 1.5, "box_px": (1, 2, 3, 4)})
    assert made.region == expected
    assert made.skip_bad_frames
    assert made.seed == 3
    alone = with_frame_options(None, Path("pipeline"), masks="m", background=Path("b.npy"))
    assert alone is not None
    assert alone.region == RegionTable(masks="m", background="b.npy")
    assert not alone.skip_bad_frames


def test_files_of_a_pipeline_lie_beside_it_and_those_of_options_here() -> None:
    pipeline = Pipeline(region=RegionTable(masks="m", background="b.npy"))
    made = with_frame_options(pipeline, Path("there/p.toml"), masks="here")
    assert made is not None
    assert (made.region.masks, made.region.background) == ("here", str(Path("there/b.npy")))


def test_options_that_contradict_each_other_are_one_line() -> None:
    with pytest.raises(InputError, match="max_range_m: expected more than min_range_m"):
        with_frame_options(None, Path("pipeline"), min_range=2.0, max_range=1.0)
