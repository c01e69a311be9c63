"""pcnav itself: the tracker in the modes of its perception, and every frame on its own."""

from pcnav.config.depth import Measurements, PerceptionMode
from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.single_frame import single_frame_pose
from pcnav.estimators.depth.tracker import Tracker
from pcnav.estimators.peers.interface import Answer, Baseline, Estimator, Given
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame


class Tracked(Estimator):
    """The tracker as `pcnav run` uses it, measuring in one of its ways."""

    def __init__(
        self,
        given: Given,
        measurements: Measurements,
        mode: PerceptionMode = PerceptionMode.AREA_WEIGHTED,
    ) -> None:
        perception = given.perception.model_copy(
            update={"measurements": measurements, "mode": mode}
        )
        self._tracker = Tracker(given.target, given.info, perception, given.filtering, given.seed)

    def step(self, frame: Frame) -> Answer:
        estimate, _ = self._tracker.step(frame)
        return Answer(estimate.status, estimate.T_cam_model, estimate)


class SingleFrame(Baseline):
    """Every frame anew, without prediction or memory."""

    def __init__(self, given: Given) -> None:
        perception = given.perception.model_copy(
            update={"measurements": Measurements.REFINED, "mode": PerceptionMode.AREA_WEIGHTED}
        )
        self._reader = FrameReader(given.target, perception, given.range_sigma_m, given.seed)

    def pose(self, frame: Frame) -> FloatArray | None:
        """None where no pose explains the frame."""
        found = single_frame_pose(frame, self._reader)
        return None if found is None else found.T_cam_model
