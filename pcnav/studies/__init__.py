"""Studies: each rebuilds a paper's tables and figures and sets the printed values beside ours."""

from collections.abc import Callable
from pathlib import Path

from pcnav.errors import InputError
from pcnav.studies.folder import Study, StudySummary, study_folder, write_study
from pcnav.studies.progress import OnProgress
from pcnav.studies.yu2019.study import study_yu2019

__all__ = ["StudySummary", "run_study"]

STUDIES: dict[str, Callable[[int | None, OnProgress], Study]] = {"yu2019": study_yu2019}
"""From the name users type to the function that rebuilds the paper."""


def run_study(
    name: str,
    out: Path,
    *,
    runs: int | None = None,
    overwrite: bool = False,
    on_progress: OnProgress = lambda done, total: None,
) -> StudySummary:
    """Rebuild a paper and write its folder: tables, figures, pipelines and a page.

    ``runs`` replaces the study's own number of Monte Carlo repetitions. Raises `InputError` for an
    unknown name, fewer than two runs, and a folder that must not be replaced; nothing is then left.
    """
    if name not in STUDIES:
        raise InputError(name, "study", f"expected one of: {', '.join(sorted(STUDIES))}")
    if runs is not None and runs < 2:
        raise InputError(name, "runs", f"expected at least 2, got {runs}")
    with study_folder(out, overwrite) as staging:
        study = STUDIES[name](runs, on_progress)
        write_study(staging, study)
    return study.summary(out)
