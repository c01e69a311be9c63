"""What reports are made from: made-up runs of every kind."""

from collections.abc import Callable

import pytest

from pcnav.dynamics.blocks import CENTRE
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.evaluation.answer.telling import About, answer_of
from pcnav.evaluation.metrics import evaluate
from pcnav.report.content import ReportContent
from tests.made_runs import POINTS, made_run

Contents = Callable[..., ReportContent]


@pytest.fixture(scope="session")
def make_content(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """Makes the content of a run of a kind and of so many frames; see `made_run`."""

    def make(
        kind: str, frames: int, *, inflation: float = 1.0, with_truth: bool = True
    ) -> ReportContent:
        made, folder = made_run(kind, frames, inflation), tmp_path_factory.mktemp("content")
        run = made.stored(folder / "run")
        truth, points = (made.truth, POINTS) if with_truth else (None, None)
        metrics = evaluate(run, truth, true_points=points)
        about = About(
            target="bus <b>bold</b>" if CENTRE in run.trajectory else None, orbit=KeplerOrbit(0.0)
        )
        return ReportContent(
            title="run <one> & two",
            command='pcnav run "a b" --target x.toml',
            run=run,
            answer=answer_of(run, metrics, about),
            metrics=metrics,
            configuration={"seed": 7, "noise": {"range_sigma_m": 0.02, "extra": None}, "v": (1, 2)},
            versions={"numpy": "9.9.<9>"},
        )

    return make
