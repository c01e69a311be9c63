"""What became of features is read back as it was written, of a run that goes on, too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.dynamics.blocks import ATTITUDE_LAYOUT
from pcnav.runs.estimate import Estimate, FeatureUse, Output
from pcnav.runs.feature_outcomes import (
    GATED,
    TRACKED,
    FeatureOutcomes,
    is_rejected,
    read_feature_outcomes,
)
from pcnav.runs.records import ACCEPTED
from pcnav.runs.result_files import FEATURE_OUTCOMES_FILE
from pcnav.runs.writer import RunWriter
from tests.runs.made_estimates import made, write

OUTPUT = Output(ATTITUDE_LAYOUT, has_nis=False, has_feature_outcomes=True)
OUTCOMES = FeatureOutcomes(
    *(np.array([7, 3, 12]), (ACCEPTED, GATED, TRACKED), np.array([1.0 / 3.0, 41.5, np.nan]), 9.0)
)


def estimates() -> list[Estimate]:
    """The second frame saw nothing, the third had no gate."""
    empty = FeatureOutcomes(np.zeros(0, dtype=np.intp), (), np.zeros(0))
    outcomes = [OUTCOMES, empty, replace(OUTCOMES, gate=np.nan), OUTCOMES]
    return [
        replace(each, features=FeatureUse(outcomes=told))
        for each, told in zip(made(OUTPUT), outcomes, strict=False)
    ]


def test_outcomes_are_read_back(tmp_path: Path) -> None:
    frames = estimates()
    write(tmp_path / "run", frames, output=OUTPUT)
    found = read_feature_outcomes(tmp_path / "run")
    assert list(found) == [frames[k].time_s for k in (0, 2, 3)]
    for k, gate in ((0, 9.0), (2, np.nan)):
        read = found[frames[k].time_s]
        np.testing.assert_array_equal(read.feature, OUTCOMES.feature)
        np.testing.assert_array_equal(read.squared_distance, OUTCOMES.squared_distance)
        assert read.outcome == OUTCOMES.outcome
        np.testing.assert_equal(read.gate, gate)
    assert OUTCOMES.of(3) == (GATED, 41.5)
    with pytest.raises(KeyError):
        OUTCOMES.of(4)
    assert [is_rejected(word) for word in OUTCOMES.outcome] == [False, True, False]


def test_a_run_that_goes_on_is_read_up_to_its_last_whole_row(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "run", OUTPUT) as writer:
        for each in estimates():
            writer.add(each)
        writer.flush()
        path = writer.staging / FEATURE_OUTCOMES_FILE
        path.write_text(path.read_text()[:-4])
        found = read_feature_outcomes(writer.staging)
    assert [len(each.feature) for each in found.values()] == [3, 3, 2]


def test_a_run_without_features_has_none(tmp_path: Path) -> None:
    write(tmp_path / "run", made())
    assert read_feature_outcomes(tmp_path / "run") == {}
