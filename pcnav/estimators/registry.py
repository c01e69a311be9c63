"""Every estimator by its key: what a run, a table of runs and a view know of it beforehand."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from pcnav.config.depth import Measurements, PerceptionMode
from pcnav.config.pipeline_file import EstimatorKind
from pcnav.core._extras import kiss_icp, small_gicp
from pcnav.estimators.interface import (
    AxesPolicy,
    Estimator,
    EstimatorEntry,
    FirstPose,
    Given,
)
from pcnav.recordings.recording import RecordingKind

if TYPE_CHECKING:
    from pcnav.estimators.depth.tracker import Tracker

FEWER_NEIGHBOURS = 10
"""Points that a covariance of small_gicp is estimated from, half of its default: smaller position
errors in most cases and larger ones of attitude."""


def _tracker(
    given: Given,
    measurements: Measurements | None = None,
    mode: PerceptionMode = PerceptionMode.AREA_WEIGHTED,
) -> "Tracker":
    """The tracker, as the pipeline says or in one of its modes."""
    from pcnav.estimators.depth.tracker import Tracker

    perception = given.pipeline.perception
    if measurements is not None:
        perception = perception.model_copy(update={"measurements": measurements, "mode": mode})
    pipeline = given.pipeline
    return Tracker(given.target, given.about, perception, pipeline.filter, pipeline.seed)


def _single_frame(given: Given) -> Estimator:
    from pcnav.estimators.peers.single_frame import SingleFrame

    return SingleFrame(given)


def _open3d_icp(given: Given, robust: bool = False) -> Estimator:
    from pcnav.estimators.peers.icp import Open3dIcp

    return Open3dIcp(given, robust=robust)


def _small_gicp(given: Given, neighbours: int | None = None) -> Estimator:
    from pcnav.estimators.peers.icp import NEIGHBOURS, SmallGicp

    return SmallGicp(given, neighbours=neighbours or NEIGHBOURS)


def _kiss_icp(given: Given) -> Estimator:
    kiss_icp("the estimator kiss_icp")
    from pcnav.estimators.peers.kiss_icp import KissIcp

    return KissIcp(given)


def _principal_axes(given: Given) -> Estimator:
    from pcnav.estimators.principal_axes.estimator import PrincipalAxesEstimator

    tracks, pipeline = given.about, given.pipeline
    return PrincipalAxesEstimator(tracks.rig, tracks.orbit, pipeline.principal_axes, pipeline.seed)


def _inertia_bank(given: Given) -> Estimator:
    from pcnav.estimators.inertia_bank.estimator import InertiaBankEstimator

    tracks, pipeline = given.about, given.pipeline
    return InertiaBankEstimator(tracks.rig, tracks.orbit, pipeline.inertia_bank, pipeline.seed)


def _image_motion(given: Given) -> Estimator:
    from pcnav.estimators.image_motion.estimator import ImageMotionEstimator

    return ImageMotionEstimator(given)


def _attitude_inertia(given: Given) -> Estimator:
    from pcnav.estimators.attitude_inertia.answers import ChainedAttitudes, RecordedAttitudes

    if given.about.kind is RecordingKind.IMAGES:
        return ChainedAttitudes(given)
    return RecordedAttitudes(given.pipeline.attitude_inertia)


def _on_depth(
    title: str,
    make: Callable[[Given], Estimator],
    first_pose: FirstPose = FirstPose.NOTHING,
    library: Callable[[str], object] | None = None,
) -> EstimatorEntry:
    axes = AxesPolicy.SYMMETRY
    kinds = (RecordingKind.DEPTH,)
    return EstimatorEntry(title, kinds, axes, make, first_pose=first_pose, library=library)


def _mode(
    title: str,
    measurements: Measurements,
    mode: PerceptionMode = PerceptionMode.AREA_WEIGHTED,
) -> EstimatorEntry:
    return _on_depth(title, partial(_tracker, measurements=measurements, mode=mode))


_STEREO = (RecordingKind.STEREO_TRACKS,)
_FEWER = f"small_gicp, {FEWER_NEIGHBOURS} neighbours"

ESTIMATORS: Mapping[str, EstimatorEntry] = {
    EstimatorKind.DEPTH: _on_depth("pcnav", _tracker),
    "pcnav": _mode("pcnav filtered", Measurements.REFINED),
    "pcnav_rectangles": _mode("pcnav, rectangles", Measurements.RECTANGLES),
    "pcnav_both": _mode("pcnav, both", Measurements.BOTH),
    "pcnav_paper": _mode("pcnav, the paper's means", Measurements.RECTANGLES, PerceptionMode.PAPER),
    "pcnav_single_frame": EstimatorEntry(
        *("pcnav single frame", (RecordingKind.DEPTH,), AxesPolicy.SYMMETRY_OF_FRAME),
        _single_frame,
    ),
    "open3d_icp": _on_depth("Open3D point-to-plane", _open3d_icp, FirstPose.NEAR),
    "open3d_icp_tukey": _on_depth(
        "Open3D, Tukey weights", partial(_open3d_icp, robust=True), FirstPose.NEAR
    ),
    "small_gicp": _on_depth("small_gicp", _small_gicp, FirstPose.NEAR, small_gicp),
    "small_gicp_10": _on_depth(
        _FEWER, partial(_small_gicp, neighbours=FEWER_NEIGHBOURS), FirstPose.NEAR, small_gicp
    ),
    "kiss_icp": _on_depth("KISS-ICP (no model)", _kiss_icp, FirstPose.EXACT, kiss_icp),
    EstimatorKind.PRINCIPAL_AXES: EstimatorEntry(
        *("principal axes of tracked points (Hu 2024)", _STEREO, AxesPolicy.PRINCIPAL),
        _principal_axes,
    ),
    EstimatorKind.INERTIA_BANK: EstimatorEntry(
        *("bank of inertia hypotheses (Segal 2011)", _STEREO, AxesPolicy.SAME),
        _inertia_bank,
    ),
    EstimatorKind.IMAGE_MOTION: EstimatorEntry(
        *("attitudes of one camera's images (Appl. Sci. 2022)", (RecordingKind.IMAGES,)),
        *(AxesPolicy.PER_SEGMENT, _image_motion),
    ),
    EstimatorKind.ATTITUDE_INERTIA: EstimatorEntry(
        "inertia from attitudes (Deng 2024)",
        (RecordingKind.ATTITUDES, RecordingKind.IMAGES),
        *(AxesPolicy.SAME, _attitude_inertia),
        judged_over_trace=True,
    ),
}
"""By the name that pipelines, `pcnav run --estimator` and grids of `pcnav table` give them."""


def make_estimator(key: str, given: Given) -> Estimator:
    """An estimator for a recording.

    One that cannot start without a pose gets the one that the recording states; where none is
    stated, the first that pcnav itself acquires.
    """
    entry = ESTIMATORS[key]
    if entry.first_pose is not FirstPose.NOTHING and given.T_cam_model_first is None:
        stated = given.about.first_pose
        given = given if stated is None else replace(given, T_cam_model_first=stated.T_cam_model)
    if entry.first_pose is FirstPose.NOTHING or given.T_cam_model_first is not None:
        return entry.make(given)
    from pcnav.estimators.peers.acquired import Acquired

    return Acquired(entry, given, _tracker(given))
