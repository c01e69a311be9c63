"""Sentences about doubts that lasted."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.dynamics.blocks import Layout
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.doubted import doubted
from pcnav.runs.doubts import Doubt, column_of, doubts_in
from pcnav.runs.run import Run

N = 50


@pytest.fixture
def run() -> Run:
    """Fifty frames without a doubt."""
    window = np.full(N, 0.97)
    window[30:] = 2.6
    ratio = np.full(N, 0.99)
    ratio[12:20] = 0.71
    return Run(
        name="run",
        folder=None,
        estimator="depth",
        pipeline=None,
        trajectory=Trajectory(np.arange(N, dtype=float), Layout(()), {}),
        status=("locked",) * N,
        nis=np.full(N, np.nan),
        nis_dof=np.zeros(N, np.intp),
        window_nis=window,
        notes={"inlier_ratio": ratio, "rim_px": np.full(N, -0.41)},
        words={"doubts": ("",) * N},
    )


def raised(run: Run, frames: range, field: str, claimed: slice = slice(None)) -> list[str]:
    fields = tuple(field if k in frames else "" for k in range(N))
    stands = np.zeros(N, np.bool_)
    stands[claimed] = True
    return doubted(replace(run, words={"doubts": fields}), stands)


def test_each_is_told_with_its_evidence(run: Run) -> None:
    (nis,) = raised(run, range(30, 40), "nis")
    assert "2.60 per degree of freedom" in nis
    assert nis.endswith("in 20% of the claimed frames, first in frame 30")
    (share,) = raised(run, range(12, 20), "explained")
    assert "71% at the least where 99% is usual" in share
    (rim,) = raised(run, range(10, 50), "rim")
    assert "0.410 px inside" in rim
    assert raised(run, range(30, 40), "nis rim") == [
        nis,
        rim.replace("80%", "20%").replace("frame 10", "frame 30"),
    ]


def test_a_moment_is_not_worth_a_sentence(run: Run) -> None:
    assert raised(run, range(30, 32), "nis") == []
    # Frames that are not claimed need no warning.
    assert raised(run, range(30, 40), "nis", slice(0, 30)) == []
    assert doubted(replace(run, words={}), np.ones(N, np.bool_)) == []


def test_what_the_estimator_said_itself_is_not_said_again(run: Run) -> None:
    assert raised(run, range(N), "tilt prior") == []


def test_names_come_back_from_their_column() -> None:
    assert doubts_in(column_of([Doubt.NIS, Doubt.RIM]) or "") == (Doubt.NIS, Doubt.RIM)
    assert column_of([]) is None
    assert doubts_in("nis of_a_later_release") == (Doubt.NIS,)
