"""Reading a frame with a pose in mind: the interface of perception."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import partial

import numpy as np

from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, rotation_angle, transform_points
from pcnav.perception.agreement import Agreement, judged
from pcnav.perception.association import (
    MeasuredFace,
    Unused,
    measure_by_prediction,
    measure_by_size,
)
from pcnav.perception.perceive import PerceivedFrame, perceive
from pcnav.perception.pose_hypotheses import PoseHypothesis, depth_tolerance, pose_hypotheses
from pcnav.perception.predicted_view import PredictedView, ViewPredictor
from pcnav.perception.regions import RegionSearch, candidate_regions
from pcnav.perception.render_compare import Comparison, RenderComparer
from pcnav.perception.returns import window_of_returns
from pcnav.perception.sampled_views import SampledViews, sample_views
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.surroundings import SurroundingsFinder
from pcnav.perception.unseen import Unseen
from pcnav.perception.view_hypotheses import SearchReport, report_of, view_hypotheses
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth
from pcnav.target.row_motion import Exposure, Readout
from pcnav.target.satellite import Target

_INLIER_SIGMA = 3.0
"""A return further than this from the depth that a pose predicts is no inlier."""
_ENOUGH_RETURNS = 3_000
"""So many returns suffice to find a target: about those of one that spans 60 pixels."""
_RIVAL_LAG = 0.3
_WELL_EXPLAINED, _MAX_TURNED = 0.97, 8
"""What a pose leaves of a frame may tell of another attitude if it is more than this leaves; of so
many is asked."""
_SAME_ANGLE_RAD = 0.15
_SAME_SHIFT_FRACTION = 0.1
"""Poses closer than this angle and share of the diameter are one."""
_MAX_RETURNS = 60_000
"""Of a frame that holds other things, too: twice as many take twice the time."""
_ENOUGH_SPAN_PX = 50.0
_TYPICAL_DEPTH = 0.4
_MAX_STRIDE = 4
_MAX_COMPARERS = 8
"""One for each camera of a sequence and each grid; some sequences state a camera for each frame."""
_MAX_DOUBT_PX = 3.0
"""Poses that may be off by more are compared on the coarse grid."""
_UNITS_RATIO = (0.02, 5.0)
"""What is seen of a target spans between these shares of its diameter, or the units differ."""
_UNITS_RETURNS = 300
"""Fewer returns may be a speck, or the first corner of a target that comes into view."""


class Trust(IntEnum):
    """How far the segmentation of a frame may lean on a predicted pose."""

    NONE = 0
    """RANSAC finds the planes."""
    PLANES = 1
    """The prediction knows the planes, but may be off by pixels."""
    PIXELS = 2
    """It is good to a pixel, and settles which face a pixel shows where noise hides it."""


@dataclass(frozen=True)
class View:
    """One frame read as rectangles with a pose in mind."""

    perceived: PerceivedFrame
    faces: list[MeasuredFace]
    unused: list[Unused]
    inlier_ratio: float = float("nan")
    """Share of the frame that the pose in mind explains, roughly; nan if nothing was rendered."""

    @property
    def frame(self) -> Frame:
        """The frame."""
        return self.perceived.frame

    @property
    def image_labels(self) -> IntArray:
        """(height, width) segment of each pixel, -1 for none."""
        return self.perceived.image_labels


class FrameReader:
    """Reads the frames of one target in the way the settings say."""

    def __init__(
        self, target: Target, settings: PerceptionTable, noise: SensorNoise | float, seed: int
    ) -> None:
        """``noise`` that is a number is white and of that standard deviation, m.

        Raises `InputError` when rectangles are to be measured on a target that has none.
        """
        if settings.measured_by is Measurements.RECTANGLES and not target.rectangles:
            expected = 'expected a rectangular face for measurements = "rectangles", found none'
            raise InputError(target.mesh_path, "faces", expected)
        self._target, self._settings = target, settings
        self._noise, self._seed = SensorNoise.of(noise), seed
        self._predictor: ViewPredictor | None = None
        self._surroundings = SurroundingsFinder(target.diameter_m)
        self._comparers: dict[PinholeCamera, RenderComparer] = {}
        self._searched: tuple[Frame, RegionSearch] | None = None
        self._views: SampledViews | None = None
        self.expected_motion: Readout | None = None
        """See `expect_motion`."""
        self._measured: BoolArray | None = None
        self.row_readout_s = 0.0
        """Time from the exposure of the first row of a frame to that of the last."""
        self.frames_take_time = False
        """Whether a target moves while a frame is taken."""

    def expect_motion(self, motion: Readout | None) -> None:
        """How the target moves in the camera when the next frame is taken; None for not known. It
        matters where its pixels are not exposed at once."""
        self.expected_motion = motion
        for comparer in self._comparers.values():
            comparer.readout = self.expected_motion

    def half_duration(self, frame: Frame) -> float:
        """How far from its time the pixels of a frame are exposed, s."""
        return 0.5 * self.row_readout_s if frame.beams is None else frame.beams.reach_s

    @property
    def noise(self) -> SensorNoise:
        """Of the sensor, as far as it is known now; whoever learns more of it sets it."""
        return self._noise

    @noise.setter
    def noise(self, noise: SensorNoise) -> None:
        self._noise = noise
        for comparer in self._comparers.values():
            comparer.noise = noise

    def rescale(self, factor: float) -> None:
        """Look from now on for a target that is larger by a factor than it was taken for."""
        self.look_for(self._target.scaled(factor), self._measured)

    def look_for(self, target: Target, measured: BoolArray | None) -> None:
        """Look from now on for a target that has turned out to be so, and measure a pose by those
        of its triangles (n_faces,) that are ``measured``; None for all."""
        self._target, self._measured = target, measured
        self._comparers.clear()
        self._predictor = self._views = self._searched = None
        self._surroundings = SurroundingsFinder(self._target.diameter_m)

    @property
    def diameter_m(self) -> float:
        """Diameter of the target."""
        return self._target.diameter_m

    @property
    def measured_by(self) -> Measurements:
        """What frames are measured by once a pose is predicted."""
        return self._settings.measured_by

    def thinned(self, frame: Frame) -> Frame:
        """A frame on as coarse a grid as finding the target in it takes.

        A near target fills the image: its faces are found, and the poses distinguished, as well on
        every second to fourth pixel, in a fraction of the time.
        """
        seen = frame.depth_m > 0.0
        stride = int(np.sqrt(np.count_nonzero(seen) / _ENOUGH_RETURNS))
        if stride > 1:
            # Other things return, too: the target alone is no larger than its size allows.
            nearer_half = float(np.quantile(frame.depth_m[seen], _TYPICAL_DEPTH))
            span_px = self.diameter_m * max(frame.camera.fx, frame.camera.fy) / nearer_half
            least = int(np.sqrt(np.count_nonzero(seen) / _MAX_RETURNS))
            stride = min(stride, max(int(span_px / _ENOUGH_SPAN_PX), least))
        return frame.strided(min(max(stride, 1), _MAX_STRIDE))

    def look(self, frame: Frame) -> PerceivedFrame:
        """What a frame shows without any prediction."""
        catalogue = self._target.rectangles
        if not catalogue or self.is_among_others(frame):
            # Of no use, or walls and tables would be all that a search for planes finds.
            window = window_of_returns(frame)
            shape = (0, 0) if window is None else window.shape
            return PerceivedFrame(frame, window, np.full(shape, -1, dtype=np.intp), ())
        return perceive(frame, catalogue, self._settings, self._sigma_in(frame), self._seed)

    def hypotheses(self, perceived: PerceivedFrame) -> tuple[PoseHypothesis, ...]:
        """Where the target may be, judging by one frame alone."""
        frame = perceived.frame
        coarse = self.comparer(frame).coarse(frame.depth_m)
        return pose_hypotheses(perceived, self._target, coarse, self._sigma_in(frame))

    def shows_target_alone(self, frame: Frame) -> bool:
        """Whether nothing else can have returned, by the size of what did."""
        if self.measured_by is Measurements.RECTANGLES:
            return True
        regions = self.regions(frame).regions
        return not regions or regions[0].is_whole

    def is_among_others(self, frame: Frame) -> bool:
        """Whether the frame holds more than the target can fill."""
        if self.measured_by is Measurements.RECTANGLES:
            return False
        found = self.regions(frame)
        return bool(found.regions) and not found.is_small

    def regions(self, frame: Frame) -> RegionSearch:
        """The parts of a frame that may be the target; kept for the frame last asked about."""
        if self._searched is None or self._searched[0] is not frame:
            found = candidate_regions(frame, self._target, self._sigma_in(frame))
            self._searched = frame, found
        return self._searched[1]

    def view_hypotheses(self, frame: Frame) -> tuple[tuple[PoseHypothesis, ...], SearchReport]:
        """Where the target may be in any part of a frame, by the look of its whole surface."""
        found = self.regions(frame)
        if not found.regions:
            return (), report_of(found, (), self.diameter_m)
        if self._views is None:
            self._views = sample_views(self._target.mesh)
        middle = np.eye(4)
        middle[2, 3] = float(np.median(np.concatenate([r.depths for r in found.regions])))
        coarse = self.comparer(frame).coarse(frame.depth_m, middle)
        return view_hypotheses(frame, found, self._views, self._target, coarse)

    def rivals(self, frame: Frame, poses: Sequence[FloatArray]) -> list[FloatArray]:
        """Poses (4, 4) that the shape of the target makes the likeliest to be taken for the first
        of others, and that explain about as much of the frame: turns that nearly keep its
        surface; where the first leaves returns unexplained, turns as well that bring them to it."""
        best = poses[0]
        coarse = self.comparer(frame).coarse(frame.depth_m, best)
        tolerance = depth_tolerance(self._target, self._sigma_in(frame))
        explained = coarse.score(frame.depth_m, best, tolerance).inlier_ratio
        least = explained - _RIVAL_LAG
        turned = [best @ motion for motion in self._target.rival_turns]
        if explained < _WELL_EXPLAINED:
            turned += self._turned_to(frame, best)
        new = [
            T
            for T in turned
            if not any(
                self._target.shows_alike(T, pose, _SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION)
                for pose in poses
            )
        ]
        return [T for T in new if coarse.score(frame.depth_m, T, tolerance).inlier_ratio >= least]

    def _turned_to(self, frame: Frame, T_cam_model: FloatArray) -> list[FloatArray]:
        """Poses (4, 4) that turn the target so that more of the returns about it lie on it.

        What little tells attitudes of a nearly round body apart decides where none of the views
        that were sampled shows it: a ball with two boxes on it looks like a ball from everywhere.
        """
        depth_m = frame.depth_m.astype(np.float64)
        p_cam: FloatArray = np.asarray(pixel_rays(frame.camera) * depth_m[..., None], np.float64)
        p_model = transform_points(invert_transform(T_cam_model), p_cam[depth_m > 0.0])
        matcher = self._target.matcher
        about = np.linalg.norm(p_model - matcher.probes.centre, axis=1) < self.diameter_m
        motions = matcher.turned(p_model[about], _MAX_TURNED) if about.any() else []
        return [T_cam_model @ np.linalg.inv(motion) for motion in motions]

    def judged(self, frame: Frame, T_cam_model: FloatArray, sigma_m: float) -> Agreement:
        """How the target at a pose (4, 4) that is roughly right explains a frame of such noise."""
        tolerance = depth_tolerance(self._target, sigma_m)
        return self.comparer(frame).score(frame.depth_m, T_cam_model, tolerance)

    def report(self, frame: Frame, inlier_ratio: float) -> SearchReport:
        """Of a search that found a pose, which explains so much, without looking at regions."""
        found = self.regions(frame)
        best = [inlier_ratio if k == 0 else float("nan") for k in range(len(found.regions))]
        return report_of(found, best, self.diameter_m)

    def nearest_equivalent(self, T_cam_model: FloatArray, near: Sequence[FloatArray]) -> FloatArray:
        """(4, 4) of the poses that show the target alike, the one nearest in attitude to any of
        ``near`` (4, 4 each); the given one when there are none."""
        return self._target.equivalent_pose(T_cam_model, near)

    def check_units(self, perceived: PerceivedFrame) -> bool:
        """Whether enough was seen to compare sizes; `InputError` when it cannot be the target.

        A mesh in millimetres and a cloud in metres make nonsense of everything after. Too much is
        seen only where one thing much larger than the target stands alone in space: a wall or a
        table may always be there as well.
        """
        window, frame = perceived.window, perceived.frame
        if window is None or np.count_nonzero(window.has_return) < _UNITS_RETURNS:
            return False
        points = window.rays[window.has_return] * window.range_m[window.has_return, None]
        low, high = np.percentile(points, [2, 98], axis=0)
        ratio = float(np.linalg.norm(high - low)) / self._target.diameter_m
        too_much = bool(ratio > _UNITS_RATIO[1] and not any(window.touches_border))
        if too_much:
            parts = self._surroundings.of(frame.depth_m, frame.camera, self._sigma_in(frame))
            seen = 0 if parts is None else int(np.count_nonzero(parts.candidates))
            too_much = parts is not None and seen < _UNITS_RETURNS
        if ratio < _UNITS_RATIO[0] or too_much:
            raise InputError(
                self._target.mesh_path,
                "units",
                "expected a mesh in metres of about the size of what is seen: its diameter is "
                f"{self._target.diameter_m:.4g} m, the returns span {ratio:.3g} times that",
            )
        return True

    # By comparison with a rendered view.

    def comparer(self, frame: Frame) -> RenderComparer:
        """Compares frames of the camera that took this one."""
        if frame.camera not in self._comparers:
            if len(self._comparers) >= _MAX_COMPARERS:
                self._comparers.clear()
            self._comparers[frame.camera] = RenderComparer(
                *(self._target, frame.camera, self._noise),
                modalities=self._settings.modalities,
                measured=self._measured,
            )
        comparer = self._comparers[frame.camera]
        comparer.unseen = Unseen.of(frame)
        comparer.readout, comparer.row_readout_s = self.expected_motion, self.row_readout_s
        comparer.beams = frame.beams
        return comparer

    def exposure(self, frame: Frame, T_cam_model: FloatArray) -> Exposure | None:
        """Where a target that is expected to move so is when each pixel of a frame sees it, at a
        pose (4, 4); None where all see it at once."""
        return self.comparer(frame).exposure(T_cam_model)

    def is_doubted(
        self, frame: Frame, T_cam_model: FloatArray, pose_covariance: FloatArray
    ) -> bool:
        """Whether a pose may be off by pixels."""
        doubt_px = self.comparer(frame).doubt_px(T_cam_model, pose_covariance)
        return doubt_px > _MAX_DOUBT_PX

    def compare(
        self,
        frame: Frame,
        T_cam_model: FloatArray,
        pose_covariance: FloatArray,
        *,
        fine: bool = False,
    ) -> Comparison:
        """A frame against the view from a predicted pose, see `RenderComparer.compare`.

        On the coarse grid where the pose is off by pixels, unless all of them are asked for.
        """
        comparer = self.comparer(frame)
        if not fine and self.is_doubted(frame, T_cam_model, pose_covariance):
            comparer = comparer.coarse(frame.depth_m, T_cam_model)
        return comparer.compare(frame.depth_m, T_cam_model, pose_covariance)

    # By rectangles.

    def score(self, frame: Frame, T_cam_model: FloatArray) -> Agreement:
        """How the target at a pose (4, 4) explains a frame, to the noise alone."""
        rendered = self._predictor_of(frame).render(T_cam_model)
        return self._agreement(frame, rendered, _INLIER_SIGMA * self._sigma_in(frame))

    def read(self, frame: Frame, T_cam_model: FloatArray, trust: Trust) -> View:
        """Segment a frame and measure its faces against the view that a pose predicts."""
        if not self.depends_on_pose:
            perceived = self.look(frame)
            return View(perceived, *measure_by_size(perceived, T_cam_model))
        predicted = self._predictor_of(frame).predict(T_cam_model)
        surface = None if trust is Trust.NONE else predicted.surface
        if surface is not None and trust is Trust.PLANES:
            surface = surface.planes_only()
        perceived = perceive(
            *(frame, self._target.rectangles, self._settings),
            *(self._sigma_in(frame), self._seed, surface),
        )
        return self._compared(perceived, predicted)

    def read_again(self, view: View, T_cam_model: FloatArray) -> View:
        """The same segments measured against the view that a better pose predicts."""
        perceived = view.perceived
        if not self.depends_on_pose:
            return View(perceived, *measure_by_size(perceived, T_cam_model))
        return self._compared(perceived, self._predictor_of(perceived.frame).predict(T_cam_model))

    def _compared(self, perceived: PerceivedFrame, predicted: PredictedView) -> View:
        faces, unused = measure_by_prediction(perceived, predicted, self._settings.size_gate_sigma)
        frame = perceived.frame
        tolerance = depth_tolerance(self._target, self._sigma_in(frame))
        ratio = self._agreement(frame, predicted.rendered, tolerance).inlier_ratio
        return View(perceived, faces, unused, ratio)

    def _agreement(self, frame: Frame, rendered: RenderedDepth, tolerance_m: float) -> Agreement:
        unseen = Unseen.of(frame)
        if unseen is not None:
            rendered = rendered.without(unseen.beside(rendered, tolerance_m))
        find = partial(self._surroundings.of, frame.depth_m, frame.camera, self._sigma_in(frame))
        return judged(frame.depth_m, rendered, tolerance_m, find)[0]

    @property
    def depends_on_pose(self) -> bool:
        """Whether a better pose gives better rectangles: not when only sizes are compared, as the
        paper does."""
        return self._settings.mode is not PerceptionMode.PAPER

    def _predictor_of(self, frame: Frame) -> ViewPredictor:
        if self._predictor is None or self._predictor.camera != frame.camera:
            self._predictor = ViewPredictor(
                self._target, frame.camera, self._settings, self._sigma_in(frame)
            )
        self._predictor.sigma_m = self._sigma_in(frame)
        return self._predictor

    def _sigma_in(self, frame: Frame) -> float:
        return self._noise.sigma_in(frame.depth_m)

    # Poses as pixels.

    def moved_px(self, before: FloatArray, after: FloatArray, frame: Frame) -> float:
        """How far apart, in pixels, two poses (4, 4) may show a point of the target."""
        shift = float(np.linalg.norm(after[:3, 3] - before[:3, 3]))
        turn = float(rotation_angle(before[:3, :3].T @ after[:3, :3]))
        return self.pixels(shift, turn, after, frame)

    def pixels(
        self, shift_m: float, turn_rad: float, T_cam_model: FloatArray, frame: Frame
    ) -> float:
        """A shift and a turn of the target as pixels at its edge."""
        moved_m = shift_m + 0.5 * self._target.diameter_m * turn_rad
        focal = max(frame.camera.fx, frame.camera.fy)
        return moved_m * focal / float(np.linalg.norm(T_cam_model[:3, 3]))
