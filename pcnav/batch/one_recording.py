"""One run of a batch of recordings: estimate from what lies in files, compare where truth does."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.axes import ESTIMATOR_AXIS, OBJECT_AXIS, RECORDING_AXIS, GridRun
from pcnav.batch.record import RunRecord
from pcnav.batch.recorded_run import follow, recorded
from pcnav.batch.recordings import RecordingsBasis
from pcnav.batch.run_metrics import RunMetrics, Views, run_metrics
from pcnav.core.arrays import BoolArray
from pcnav.navigation import Truth
from pcnav.pipeline import inputs_of
from pcnav.recordings.bop_scene import OBJECT_ID
from pcnav.recordings.bop_targets import targets_of
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.runs.export.bop_csv import image_number


@dataclass(frozen=True)
class OneRecording:
    """What is done of every run; can be sent to another process."""

    basis: RecordingsBasis

    def __call__(self, run: GridRun) -> RunRecord:
        """The record of a run, without errors where the recording has no truth.

        No estimator is told the truth, not even one that needs a first pose. Raises `InputError`
        for a recording, a target or a truth that cannot be.
        """
        return recorded(run, self.basis.command(run), lambda: self._measured(run))

    def _measured(self, run: GridRun) -> RunMetrics:
        basis, axes = self.basis, dict(run.case.settings)
        name = str(axes[ESTIMATOR_AXIS])
        table = basis.pipeline.recording
        if OBJECT_AXIS in axes:
            table = table.model_copy(update={"object": int(axes[OBJECT_AXIS])})
        pipeline = basis.pipeline.model_copy(update={"recording": table})
        place = basis.places[str(axes[RECORDING_AXIS])]
        recording = open_sequence(place, basis.mesh, pipeline.skip_bad_frames, table)
        inputs = inputs_of(recording, None, pipeline, name, basis.mesh, basis.mesh_unit)
        truth = Truth.of(recording)
        followed = follow(inputs.frames(), name, inputs.make_estimator())
        followed = replace(followed, views=views_of(recording))
        return run_metrics(followed, truth.motion, inputs.target)


def views_of(recording: Sequence) -> Views:
    """The cameras of all frames, and which of them a BOP data set asks for."""
    cameras = np.asarray(recording.intrinsics), recording.size.width
    return Views(*cameras, _asked(recording))


def _asked(recording: Sequence) -> BoolArray | None:
    targets = targets_of(recording.path)
    if targets is None:
        return None
    target = OBJECT_ID if recording.object_id is None else recording.object_id
    asked = targets.images.get(target, frozenset())
    return np.array([image_number(file) in asked for file in recording.files])
