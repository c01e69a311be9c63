"""What the last frames say of a track, counted by hand."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2

from pcnav.estimators.depth.evidence import Evidence
from pcnav.filtering.error_state import UpdateResult
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.status import Status


def update(nis: float, dof: int = 6) -> UpdateResult:
    return UpdateResult((True,), (nis,), (dof,), nis, dof, 1, True)


def doubtful(evidence: Evidence) -> bool:
    return evidence.is_doubtful


NOTHING_USED = UpdateResult((False,), (1e9,), (3,), float("nan"), 0, 0, True)


def test_statuses_are_the_words_of_the_result_files() -> None:
    assert [str(status) for status in Status] == [
        "acquiring",
        "locked",
        "ambiguous",
        "coasting",
        "lost",
    ]


def test_a_new_track_has_no_evidence_against_it() -> None:
    evidence = Evidence()
    assert np.isnan(evidence.window_nis)
    assert not doubtful(evidence)


def test_a_filter_that_explains_much_less_than_its_start_is_doubtful_at_once() -> None:
    for start, doubted in ((float("nan"), False), (0.99, True), (0.86, False)):
        evidence = Evidence(start)
        evidence.add(0.82, update(6.0))
        assert doubtful(evidence) is doubted


def test_window_nis_is_of_the_last_frames_by_their_degrees_of_freedom() -> None:
    evidence = Evidence()
    evidence.add(1.0, update(12.0, 6))
    assert evidence.window_nis == pytest.approx(2.0)
    evidence.add(1.0, update(3.0, 2))
    assert evidence.window_nis == pytest.approx(15.0 / 8.0)
    evidence.add(1.0, NOTHING_USED)
    assert evidence.window_nis == pytest.approx(15.0 / 8.0)
    for k in range(NIS_WINDOW_FRAMES):
        evidence.add(1.0, update(float(k), 5))
    expected = sum(range(NIS_WINDOW_FRAMES)) / (5.0 * NIS_WINDOW_FRAMES)
    assert evidence.window_nis == pytest.approx(expected)


def test_frames_that_are_explained_poorly_make_a_track_doubtful() -> None:
    evidence = Evidence()
    for _ in range(4):
        evidence.add(0.1, update(6.0))
        assert not doubtful(evidence)  # too few frames to say
    evidence.add(0.1, update(6.0))
    assert doubtful(evidence)
    for _ in range(5):
        evidence.add(0.95, update(6.0))
    assert not doubtful(evidence)
    # 4 x 0.95 and 0.71: 0.902 on average; 0.68: 0.896.
    evidence.add(0.71, update(6.0))
    assert not doubtful(evidence)
    for share in (0.95, 0.95, 0.95, 0.95, 0.68):
        evidence.add(share, update(6.0))
    assert doubtful(evidence)


@pytest.mark.parametrize(("probability", "expected"), [(1e-5, False), (1e-7, True)])
def test_innovations_that_are_no_chance_make_a_track_doubtful(
    probability: float, expected: bool
) -> None:
    dof = 6 * NIS_WINDOW_FRAMES
    nis = brentq(lambda x: chi2.sf(x, dof) / probability - 1.0, dof, 3.0 * dof)
    evidence = Evidence()
    for _ in range(NIS_WINDOW_FRAMES):
        evidence.add(1.0, update(nis / NIS_WINDOW_FRAMES))
    assert doubtful(evidence) is expected


def test_one_bad_frame_is_forgotten() -> None:
    evidence = Evidence()
    for _ in range(6):
        evidence.add(1.0, update(6.0))
    evidence.add(1.0, update(200.0))
    assert doubtful(evidence)
    for _ in range(NIS_WINDOW_FRAMES):
        evidence.add(1.0, update(6.0))
    assert not doubtful(evidence)
