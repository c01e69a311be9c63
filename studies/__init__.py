"""Studies: a paper rebuilt, the printed values beside ours, or the tracker against its bars."""

from collections.abc import Callable
from pathlib import Path

from pcnav.batch.cluster import EVERY_CORE, Workers
from pcnav.core.errors import InputError

from .folder import Study, StudySummary, study_folder, write_study
from .progress import OnProgress

__all__ = ["StudySummary", "run_study"]


# A study is imported when it is asked for: the processes that share one out load no other.
def _tracking(runs: int | None, on_progress: OnProgress, workers: Workers) -> Study:
    from .tracking.study import study_tracking

    return study_tracking(runs, on_progress, workers)


def _yu2019(runs: int | None, on_progress: OnProgress, workers: Workers) -> Study:
    from .yu2019.study import study_yu2019

    return study_yu2019(runs, on_progress, workers)


def _segal2011(runs: int | None, on_progress: OnProgress, workers: Workers) -> Study:
    from .segal2011.study import study_segal2011

    return study_segal2011(runs, on_progress, workers)


def _applsci2022(runs: int | None, on_progress: OnProgress, workers: Workers) -> Study:
    from .applsci2022.study import study_applsci2022

    return study_applsci2022(runs, on_progress, workers)


def _deng2024(runs: int | None, on_progress: OnProgress, workers: Workers) -> Study:
    from .deng2024.study import study_deng2024

    return study_deng2024(runs, on_progress, workers)


def _hu2024(runs: int | None, on_progress: OnProgress, workers: Workers) -> Study:
    from .hu2024.study import study_hu2024

    return study_hu2024(runs, on_progress, workers)


STUDIES: dict[str, Callable[[int | None, OnProgress, Workers], Study]] = {
    "applsci2022": _applsci2022,
    "deng2024": _deng2024,
    "hu2024": _hu2024,
    "segal2011": _segal2011,
    "tracking": _tracking,
    "yu2019": _yu2019,
}
"""From the name users type to the function that makes the study."""


def run_study(
    name: str,
    out: Path,
    *,
    runs: int | None = None,
    workers: Workers = EVERY_CORE,
    overwrite: bool = False,
    on_progress: OnProgress = lambda done, total: None,
) -> StudySummary:
    """Make a study and write its folder: tables, figures, pipelines and a page.

    ``runs`` replaces the study's own number of Monte Carlo repetitions; ``workers`` is what they
    are spread over. Raises `InputError` for an unknown name, fewer than two runs, workers that
    cannot be used, and a folder that must not be replaced; nothing is then left.
    """
    if name not in STUDIES:
        raise InputError(name, "study", f"expected one of: {', '.join(sorted(STUDIES))}")
    if runs is not None and runs < 2:
        raise InputError(name, "runs", f"expected at least 2, got {runs}")
    with study_folder(out, overwrite) as staging:
        study = STUDIES[name](runs, on_progress, workers)
        write_study(staging, study)
    return study.summary(out)
