"""One run of a batch of recordings: estimate from what lies in files, compare where truth does."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.axes import ESTIMATOR_AXIS, OBJECT_AXIS, RECORDING_AXIS, GridRun
from pcnav.batch.one_run import follow, without_track_messages
from pcnav.batch.process import peak_memory_mb, reset_peak_memory
from pcnav.batch.record import RunRecord
from pcnav.batch.recordings import RecordingsBasis
from pcnav.batch.run_metrics import Views, run_metrics
from pcnav.navigation import Truth
from pcnav.pipeline import inputs_of
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.runs.provenance import library_versions_with_peers


@dataclass(frozen=True)
class OneRecording:
    """What is done of every run; can be sent to another process."""

    basis: RecordingsBasis

    def __call__(self, run: GridRun) -> RunRecord:
        """The record of a run, without errors where the recording has no truth.

        No estimator is told the truth, not even one that needs a first pose. Raises `InputError`
        for a recording, a target or a truth that cannot be.
        """
        reset_peak_memory()
        basis, axes = self.basis, dict(run.case.settings)
        name = str(axes[ESTIMATOR_AXIS])
        table = basis.pipeline.recording
        if OBJECT_AXIS in axes:
            table = table.model_copy(update={"object": int(axes[OBJECT_AXIS])})
        pipeline = basis.pipeline.model_copy(update={"recording": table})
        with without_track_messages():
            place = basis.places[str(axes[RECORDING_AXIS])]
            recording = open_sequence(place, basis.mesh, pipeline.skip_bad_frames, table)
            inputs = inputs_of(recording, None, pipeline, name, basis.mesh, basis.mesh_unit)
            truth = Truth.of(recording)
            followed = follow(inputs.frames(), name, inputs.make_estimator())
        followed = replace(followed, views=views_of(recording))
        found = run_metrics(followed, truth.motion, inputs.target)
        return RunRecord(
            run=run,
            columns=found.columns,
            values=found.values | {"peak_memory_mb": peak_memory_mb()},
            failure=None,
            versions=library_versions_with_peers(),
            command=basis.command(run),
        )


def views_of(recording: Sequence) -> Views:
    """The cameras of all frames."""
    return Views(np.asarray(recording.intrinsics), recording.size.width)
