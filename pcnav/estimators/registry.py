"""Every estimator under test by its name: what it is called, what it is told, how it is made."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from pcnav.config.depth import Measurements, PerceptionMode
from pcnav.core._extras import small_gicp
from pcnav.estimators.names import EstimatorName
from pcnav.estimators.peers.icp import FEWER_NEIGHBOURS, Open3dIcp, SmallGicp
from pcnav.estimators.peers.interface import Estimator, FirstPose, Given
from pcnav.estimators.peers.kiss_icp_baseline import KissIcp
from pcnav.estimators.peers.tracked import SingleFrame, Tracked


@dataclass(frozen=True)
class Entry:
    """One estimator under test."""

    title: str
    make: Callable[[Given], Estimator]
    first_pose: FirstPose = FirstPose.NOTHING
    remembers: bool = True
    """Whether a pose follows from earlier ones: then a symmetric target must keep one attitude."""
    library: Callable[[str], object] | None = None
    """Imports an extra that it needs; given what for, raises `InputError` where it is missing."""


ESTIMATORS = {
    EstimatorName.PCNAV: Entry(
        "pcnav filtered", partial(Tracked, measurements=Measurements.REFINED)
    ),
    EstimatorName.PCNAV_RECTANGLES: Entry(
        "pcnav, rectangles", partial(Tracked, measurements=Measurements.RECTANGLES)
    ),
    EstimatorName.PCNAV_BOTH: Entry(
        "pcnav, both", partial(Tracked, measurements=Measurements.BOTH)
    ),
    EstimatorName.PCNAV_PAPER: Entry(
        "pcnav, the paper's means",
        partial(Tracked, measurements=Measurements.RECTANGLES, mode=PerceptionMode.PAPER),
    ),
    EstimatorName.PCNAV_SINGLE_FRAME: Entry("pcnav single frame", SingleFrame, remembers=False),
    EstimatorName.OPEN3D_ICP: Entry("Open3D point-to-plane", Open3dIcp, FirstPose.NEAR),
    EstimatorName.OPEN3D_ICP_TUKEY: Entry(
        "Open3D, Tukey weights", partial(Open3dIcp, robust=True), FirstPose.NEAR
    ),
    EstimatorName.SMALL_GICP: Entry("small_gicp", SmallGicp, FirstPose.NEAR, library=small_gicp),
    EstimatorName.SMALL_GICP_10: Entry(
        f"small_gicp, {FEWER_NEIGHBOURS} neighbours",
        partial(SmallGicp, neighbours=FEWER_NEIGHBOURS),
        FirstPose.NEAR,
        library=small_gicp,
    ),
    EstimatorName.KISS_ICP: Entry("KISS-ICP (no model)", KissIcp, FirstPose.EXACT),
}
"""All of `EstimatorName`."""
