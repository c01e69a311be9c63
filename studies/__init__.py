"""Studies: a paper rebuilt, the printed values beside ours, or the tracker against its bars.

Each folder here is one: its ``study`` module has ``RUNS``, its own number of Monte Carlo
repetitions, and ``study(runs, work)``, which makes it.
"""

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from pcnav.batch.cluster import EVERY_CORE, Workers
from pcnav.core.errors import InputError

from .folder import Study, StudySummary, study_folder, write_study
from .work import OnProgress, Work

__all__ = ["STUDIES", "StudySummary", "run_study"]

STUDIES = tuple(sorted(module.name for module in iter_modules(__path__) if module.ispkg))
"""The names users type."""


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
    cannot be used, a shipped pipeline that is missing or bad, and a folder that must not be
    replaced, `RunError` when a run fails; nothing is then left.
    """
    if name not in STUDIES:
        raise InputError(name, "study", f"expected one of: {', '.join(STUDIES)}")
    if runs is not None and runs < 2:
        raise InputError(name, "runs", f"expected at least 2, got {runs}")
    with study_folder(out, overwrite) as staging:
        # Imported when it is asked for: the processes that share one out load no other.
        module = import_module(f".{name}.study", __name__)
        study: Study = module.study(runs or module.RUNS, Work(workers, on_progress))
        write_study(staging, study)
    return study.summary(out)
