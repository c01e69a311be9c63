"""Frames that a program makes itself and gives to an estimator one by one."""

from pathlib import Path

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.estimators.interface import Given
from pcnav.estimators.registry import make_estimator
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.runs.status import Status
from pcnav.target.satellite import load_target

CAMERA = PinholeCamera.from_field_of_view(32, 24, 0.5)


def empty(index: int, time_s: float) -> Frame:
    depth_m = np.full((24, 32), np.nan, dtype=np.float32)
    return Frame(index, time_s, depth_m, CAMERA, np.eye(4))


def test_a_time_that_does_not_increase_is_refused_in_one_line(repository: Path) -> None:
    target = load_target(repository / "meshes" / "cubesat6u.obj")
    info = SequenceInfo("mine", 0.0, None, None)
    estimator = make_estimator("depth", Given(Pipeline(), info, target))
    assert estimator.step(empty(0, 0.0)).status == Status.ACQUIRING
    with pytest.raises(InputError, match=r"^frame 1: time_s: expected a time after the 0\.0 s"):
        estimator.step(empty(1, 0.0))
    assert estimator.step(empty(2, 0.1)).status == Status.ACQUIRING
