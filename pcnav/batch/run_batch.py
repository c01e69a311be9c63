"""A grid, or a batch of recordings, as a list of verbs: check, run what is missing, tabulate."""

from pathlib import Path

from pcnav.batch.cluster import Workers
from pcnav.batch.grid import GridPlan
from pcnav.batch.metrics import SETTLED, EvaluationWindow
from pcnav.batch.one_recording import OneRecording
from pcnav.batch.one_run import OneRun
from pcnav.batch.record import RunRecord
from pcnav.batch.recordings import RecordingsPlan
from pcnav.batch.standard_tables import STANDARD, Wanted, asked_layout
from pcnav.batch.store import OnBatchProgress, new_store, run_stored
from pcnav.batch.tables import run_table
from pcnav.batch.tabulate import INDEX_FILE, TABLES_FOLDER, TableSummary, tabulate
from pcnav.core.errors import InputError
from pcnav.files.new_folder import refuse_unless_replaceable

Plan = GridPlan | RecordingsPlan


def run_batch(
    plan: Plan,
    out: Path,
    workers: Workers,
    wanted: Wanted = STANDARD,
    window: EvaluationWindow = SETTLED,
    on_progress: OnBatchProgress = lambda done, total, failed: None,
) -> TableSummary:
    """Run all of a grid that ``out`` has no record of yet, and write its tables.

    Raises `InputError` for a table that cannot be made, for what a case needs and does not find,
    for a folder of something else and for a cluster that cannot be used, all before the first
    run; ``OSError`` when a record cannot be written.
    """
    # What the table is asked for is looked at first: half an hour later is late to hear of a typo.
    asked_layout(wanted, run_table(plan.runs))
    plan.check()
    # So is what stands where they will go.
    refuse_unless_replaceable(out / TABLES_FOLDER, True, INDEX_FILE)
    is_new = not out.exists()
    store = new_store(out, plan.to_toml(), plan.runs)
    try:
        run_stored(_function_of(plan), plan.runs, store, workers, plan.basis.command, on_progress)
    except InputError:
        # Workers that cannot be used leave nothing behind; finished runs are never thrown away.
        if is_new:
            store.discard_unused()
        raise
    return tabulate(store, wanted=wanted, window=window)


def run_alone(plan: Plan, case: str, index: int, out: Path) -> RunRecord:
    """One run of a grid by itself, in this process; its record goes to ``out``, too.

    A record that is there already is read, not made again. Raises as `run_batch` does, and
    `InputError` for a case or an index that the grid does not have.
    """
    run = plan.run_named(case, index)
    plan.check()
    store = new_store(out, plan.to_toml(), plan.runs)
    run_stored(_function_of(plan), [run], store, Workers(jobs=1), plan.basis.command)
    return store.record(run.key)


def _function_of(plan: Plan) -> OneRun | OneRecording:
    if isinstance(plan, GridPlan):
        return OneRun(plan.basis)
    return OneRecording(plan.basis)
