"""Every frame anew: what pcnav finds without prediction or memory."""

from pcnav.config.depth import Measurements, PerceptionMode
from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.single_frame import single_frame_pose
from pcnav.estimators.interface import Given
from pcnav.estimators.peers.baseline import Baseline
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame


class SingleFrame(Baseline):
    """The best pose of each frame by itself."""

    def __init__(self, given: Given) -> None:
        modes = {"measurements": Measurements.REFINED, "mode": PerceptionMode.AREA_WEIGHTED}
        perception = given.pipeline.perception.model_copy(update=modes)
        seed = given.pipeline.seed
        self._reader = FrameReader(given.target, perception, given.range_sigma_m, seed)

    def pose(self, frame: Frame) -> FloatArray | None:
        """None where no pose explains the frame."""
        found = single_frame_pose(frame, self._reader)
        return None if found is None else found.T_cam_model
