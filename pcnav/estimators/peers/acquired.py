"""A peer that starts from the pose that pcnav acquires: no run may be told the truth."""

from dataclasses import replace

from pcnav.estimators.interface import Estimator, EstimatorEntry, Given
from pcnav.estimators.peers.baseline import Baseline
from pcnav.perception.view_hypotheses import SearchReport
from pcnav.recordings.sequence import Frame
from pcnav.runs.estimate import Estimate
from pcnav.runs.status import Status


class Acquired(Estimator):
    """The peer, from the first frame on in which the tracker has an estimate."""

    output = Baseline.output

    def __init__(self, entry: EstimatorEntry, given: Given, tracker: Estimator) -> None:
        """``tracker`` is asked until it has an estimate.

        Raises `InputError` where the peer's library is missing.
        """
        self._entry, self._given, self._tracker = entry, given, tracker
        self._peer: Estimator | None = None
        if entry.library is not None:
            entry.library(f"the estimator {given.pipeline.estimator.kind}")

    @property
    def search_report(self) -> SearchReport | None:
        """Where the tracker looked for the target."""
        return self._tracker.search_report

    def step(self, frame: Frame, /) -> Estimate:
        """Acquiring until the tracker has a pose; with it the peer takes in the same frame."""
        if self._peer is None:
            pose = self._tracker.step(frame).T_cam_target
            if pose is None:
                return Estimate(frame.time_s, str(Status.ACQUIRING))
            self._peer = self._entry.make(replace(self._given, T_cam_model_first=pose))
        return self._peer.step(frame)
