"""Two batches side by side: what got worse beyond chance, for a machine that has to decide."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from pcnav.batch.case import ESTIMATOR_AXIS, BatchRun
from pcnav.batch.changes import Change, JudgedChange, case_change, judged, mean_change
from pcnav.batch.metrics import Metric, named_metrics
from pcnav.batch.samples import SETTLED, CellSamples, Window, collect
from pcnav.batch.statistics import quantities_of
from pcnav.batch.store import RunStore
from pcnav.core.errors import InputError

COMPARED = (
    "position_sym_rms_m",
    "attitude_sym_rms_deg",
    "rate_rms_deg_s",
    "com_rms_m",
    "locked_right_pct",
    "locked_wrong_pct",
    "never_locked_pct",
    "pose_pct",
)
"""Unless other metrics are asked for."""


@dataclass(frozen=True)
class Comparison:
    """All that two batches say of each other."""

    overall: tuple[JudgedChange, ...]
    """By estimator and metric, the mean over the cases."""
    cases: tuple[JudgedChange, ...]
    """Case by case."""
    newly_failed: tuple[BatchRun, ...]
    """Runs with a result in the old batch and none in the new one."""
    repaired: int
    """Runs that failed in the old batch and have a result in the new one."""
    only_old: int
    only_new: int
    """Cases that the other batch does not have."""
    same_grid: bool
    """Whether both batches were made from the same grid, satellites and settings included."""

    @property
    def regressions(self) -> tuple[JudgedChange, ...]:
        """What got worse beyond the confidence."""
        return tuple(c for c in (*self.overall, *self.cases) if c.verdict == "worse")

    @property
    def is_regression(self) -> bool:
        """Whether anything got worse; a run that fails now and did not before always counts."""
        return bool(self.regressions or self.newly_failed)


def compare(
    old: RunStore,
    new: RunStore,
    metrics: Sequence[str] | None = None,
    window: Window = SETTLED,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Comparison:
    """Compare the cases that two batches share, one case at a time in memory.

    Runs with the same index and seed are paired. Raises `InputError` for an unknown metric and for
    batches without a case in common.
    """
    wanted = named_metrics(COMPARED if metrics is None else metrics)
    olds, news = _by_case(old), _by_case(new)
    shared = [case for case in olds if case in news]
    if not shared:
        expected = f"expected a case that {old.folder} has, too; found none"
        raise InputError(new.folder, "cases", expected)
    changes: list[list[Change]] = []
    failed: list[BatchRun] = []
    repaired = 0
    for k, case in enumerate(shared):
        on_progress(k, len(shared))
        samples = [
            collect((store.record(run.key) for run in runs), quantities_of(wanted), window)
            for store, runs in ((old, olds[case]), (new, news[case]))
        ]
        changes.append(_changes(case, wanted, *samples))
        failed += _now_failing(*samples)
        repaired += len(_now_failing(*reversed(samples)))
    overall = _overall([olds[case][0] for case in shared], changes, wanted)
    verdicts = judged([*overall, *(change for of_case in changes for change in of_case)])
    return Comparison(
        overall=verdicts[: len(overall)],
        cases=verdicts[len(overall) :],
        newly_failed=tuple(failed),
        repaired=repaired,
        only_old=len(olds) - len(shared),
        only_new=len(news) - len(shared),
        same_grid=old.grid_toml == new.grid_toml,
    )


def _by_case(store: RunStore) -> dict[str, list[BatchRun]]:
    """The finished runs of a batch by the name of their case."""
    found: dict[str, list[BatchRun]] = {}
    for header in store.headers():
        found.setdefault(header.run.case.name, []).append(header.run)
    return found


def _changes(
    case: str, metrics: Sequence[Metric], old: CellSamples, new: CellSamples
) -> list[Change]:
    pairs = _pairs(old.runs, new.runs)
    # One pair tells nothing of its spread: all runs then tell more, unpaired.
    paired = len(pairs) > 1
    if paired:
        old = _chosen(old, [first for first, _ in pairs])
        new = _chosen(new, [second for _, second in pairs])
    found = (case_change(case, metric, old, new, paired) for metric in metrics)
    return [change for change in found if change is not None]


def _pairs(old: Sequence[BatchRun], new: Sequence[BatchRun]) -> list[tuple[int, int]]:
    """Places of the runs that met the same truth and noise."""
    place = {(run.index, run.seed): k for k, run in enumerate(new)}
    return [
        (k, place[run.index, run.seed])
        for k, run in enumerate(old)
        if (run.index, run.seed) in place
    ]


def _chosen(samples: CellSamples, places: Sequence[int]) -> CellSamples:
    return CellSamples(
        runs=tuple(samples.runs[k] for k in places),
        failed=samples.failed,
        samples={name: tuple(each[k] for k in places) for name, each in samples.samples.items()},
    )


def _now_failing(old: CellSamples, new: CellSamples) -> list[BatchRun]:
    """Runs that have a result in the first and failed in the second."""
    well = {(run.index, run.seed) for run in old.runs}
    return [run for run in new.failed if (run.index, run.seed) in well]


def _overall(
    firsts: Sequence[BatchRun], changes: Sequence[Sequence[Change]], metrics: Sequence[Metric]
) -> list[Change]:
    """Means over the cases of each estimator; ``firsts`` has a run of each case."""
    groups: dict[str, list[Change]] = {}
    for run, of_case in zip(firsts, changes, strict=True):
        groups.setdefault(_estimator(run), []).extend(of_case)
    found = []
    for estimator, of_estimator in groups.items():
        for metric in metrics:
            same = [change for change in of_estimator if change.metric is metric]
            if len(same) > 1:
                found.append(mean_change(f"{estimator}: mean of {len(same)} cases", same))
    return found


def _estimator(run: BatchRun) -> str:
    axes = dict(run.case.axes)
    return f"{ESTIMATOR_AXIS}={axes[ESTIMATOR_AXIS]}" if ESTIMATOR_AXIS in axes else "all"
