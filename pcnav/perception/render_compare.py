"""Render and compare: how far a frame lies from the view that a predicted pose gives.

The model is ray-cast once at the prediction. The range residuals of the pixels inside its surfaces
tell how each face is displaced along the line of sight and tilted; the outline (`contour`) tells
how it is displaced across. Both are linear in the error of the pose, with noise that is known:
white along the rays, and the pixel grid's at the outline. Cut and hidden parts bias nothing, since
the prediction is cut alike. No planes are searched for and no pixel is given to a face by what it
measures, so the measurement does not lean on the prediction.
"""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pcnav.config.depth import MODALITIES_BY_DEFAULT, ModalityName
from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.beams import Beams
from pcnav.core.camera import PinholeCamera
from pcnav.perception.agreement import Agreement, judged
from pcnav.perception.contour import contour_reach
from pcnav.perception.face_evidence import FaceEvidence, face_evidence, pooled_faces, range_fits
from pcnav.perception.mesh_edges import mesh_edges
from pcnav.perception.modality import SeenFrame
from pcnav.perception.outline_frame import outline_frame
from pcnav.perception.pose_doubt import GATE_SIGMA, PoseDoubt
from pcnav.perception.predicted_view import rectangle_of_triangle
from pcnav.perception.scans import exposure_of_scan, outline_of_scan, strided_beams
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.surface_pixels import FEW_PIXELS, SurfacePixels, surface_pixels
from pcnav.perception.surroundings import Surroundings, SurroundingsFinder
from pcnav.perception.unseen import Unseen
from pcnav.target.parts import has_several_bodies
from pcnav.target.rendering import DepthRenderer, RenderedDepth
from pcnav.target.row_motion import Exposure, Readout, row_times
from pcnav.target.satellite import Target

_LOOSE_FRACTION = 0.01
"""However uncertain a pose is, its view explains what lies within this share of the diameter, and
the noise, of it."""
_FACET_SHARE = 0.5
"""What of the deviations of the facets that are seen together, which mostly cancel, is common."""
_COARSEST_STRIDE = 4
_MIN_COARSE_PIXELS = 300
"""A coarse grid keeps about so many pixels on the target."""


@dataclass(frozen=True)
class Comparison:
    """A frame compared with the view from a pose."""

    T_cam_model: FloatArray
    """(4, 4) the pose."""
    rendered: RenderedDepth
    faces: tuple[FaceEvidence, ...]
    agreement: Agreement
    """Of frame and view, to the noise and the doubt about the pose."""
    labels: IntArray
    """(height, width) index into ``faces`` of the pixels that were used, -1 for none."""
    seen: SeenFrame
    """What they were measured in."""
    motion: Readout | None = None
    """Of the target while the frame was taken, as it was taken to move."""

    def places(self, used: Sequence[bool]) -> frozenset[int]:
        """In the catalogue, of those of its faces that were used, see `FaceEvidence.place`."""
        return frozenset(f.place for f, ok in zip(self.faces, used, strict=True) if ok)


def never(_: Agreement) -> bool:
    """No agreement is too little."""
    return False


class RenderComparer:
    """Compares frames of one camera with one target; what never changes is built once."""

    def __init__(
        self,
        target: Target,
        camera: PinholeCamera,
        noise: SensorNoise | float,
        stride: int = 1,
        modalities: Sequence[ModalityName] = MODALITIES_BY_DEFAULT,
        measured: BoolArray | None = None,
    ) -> None:
        """``stride`` compares on every so many pixels of the frames of ``camera`` only, by
        ``modalities``; ``noise`` that is a number is white and of that deviation, m. Triangles
        (n_faces,) that are not ``measured`` are seen, but say nothing of the pose."""
        self.camera, self._modalities = camera, tuple(modalities)
        self._target, self._stride, self._measured = target, stride, measured
        self._noise, self._coarser = SensorNoise.of(noise), dict[int, RenderComparer]()
        self._renderer = DepthRenderer(target.mesh, camera.strided(stride))
        self._edges = mesh_edges(target.mesh)
        self._face_of_triangle = rectangle_of_triangle(target)
        self._diameter_m = target.diameter_m
        self.readout: Readout | None = None
        """How the target moves while a frame is taken; None while that is unknown or nothing."""
        self.row_readout_s = 0.0
        """From the exposure of the first row of an image to that of its last."""
        self._surroundings = SurroundingsFinder(target.diameter_m)
        self._unseen: Unseen | None = None
        self.beams: Beams | None = None
        """Of the scan compared next; None of an image."""

    def coarse(
        self, depth_m: DepthImage, T_cam_model: FloatArray | None = None
    ) -> "RenderComparer":
        """On every second to fourth pixel: for poses off by more than a comparison is linear over.

        There they are off by a quarter as many pixels, and it takes a sixteenth of the time. A
        target that covers few pixels in the frame (height, width) keeps more of them: at most all
        that returned, and no more than its size allows at a pose (4, 4) where one is given.
        """
        covered = float(np.count_nonzero(depth_m))
        if T_cam_model is not None:
            covered = min(covered, np.pi / 4.0 * self._span_px(T_cam_model) ** 2)
        stride = int(np.sqrt(covered / _MIN_COARSE_PIXELS))
        return self._at_stride(min(max(stride, 1), _COARSEST_STRIDE))

    def _at_stride(self, stride: int) -> "RenderComparer":
        if stride == self._stride:
            return self
        if stride not in self._coarser:
            self._coarser[stride] = RenderComparer(
                *(self._target, self.camera, self._noise, stride, self._modalities),
                self._measured,
            )
            self._coarser[stride]._surroundings = self._surroundings
            self._coarser[stride].unseen = self._unseen
        self._coarser[stride].readout = self.readout
        self._coarser[stride].row_readout_s = self.row_readout_s
        self._coarser[stride].beams = self.beams
        return self._coarser[stride]

    def _span_px(self, T_cam_model: FloatArray) -> float:
        """Pixels that the target's diameter spans at a pose (4, 4)."""
        focal = max(self.camera.fx, self.camera.fy)
        return self._diameter_m * focal / float(np.linalg.norm(T_cam_model[:3, 3]))

    @property
    def noise(self) -> SensorNoise:
        """Of the sensor; whoever learns more of it sets it."""
        return self._noise

    @noise.setter
    def noise(self, noise: SensorNoise) -> None:
        self._noise = noise
        for comparer in self._coarser.values():
            comparer.noise = noise

    @property
    def unseen(self) -> Unseen | None:
        """What is not known of the frames compared next."""
        return self._unseen

    @unseen.setter
    def unseen(self, unseen: Unseen | None) -> None:
        self._unseen = unseen
        for comparer in self._coarser.values():
            comparer.unseen = unseen

    def exposure(self, T_cam_model: FloatArray) -> Exposure | None:
        """When the pixels see a target at a pose (4, 4); None where all do at the frame's time."""
        beams, readout = self._beams_here(), self.readout
        if beams is not None:
            return exposure_of_scan(beams, self.camera.strided(self._stride), T_cam_model, readout)
        if readout is None or self.row_readout_s == 0.0:
            return None
        times_s = row_times(self.row_readout_s, self.camera.height)[:: self._stride]
        width = -(-self.camera.width // self._stride)
        return Exposure.by_rows(readout.poses(T_cam_model, times_s), width, times_s)

    def _beams_here(self) -> Beams | None:
        """Those of the scan on the grid compared on."""
        return None if self.beams is None else strided_beams(self.beams, self._stride)

    def _times_of(self, pixels: SurfacePixels, rendered: RenderedDepth) -> FloatArray | None:
        """(n,) when pixels, or beams in them, see, from the time of the frame on."""
        beams = self._beams_here()
        if beams is not None and pixels.beam is not None:
            return np.asarray(beams.time_s[pixels.beam])
        if self.row_readout_s == 0.0:
            return None
        rows = (pixels.pixels[0] + rendered.window[0].start) * self._stride
        return np.asarray(row_times(self.row_readout_s, self.camera.height)[rows])

    def _unseen_beside(self, rendered: RenderedDepth, tolerance_m: float) -> BoolArray | None:
        """(height, width) of the grid compared on."""
        if self._unseen is None:
            return None
        return self._unseen.strided(self._stride).beside(rendered, tolerance_m)

    def with_noise(self, noise: SensorNoise | float) -> "RenderComparer":
        """The same for frames of other noise."""
        other = copy(self)
        other._noise = SensorNoise.of(noise)
        other._coarser = {
            stride: comparer.with_noise(noise) for stride, comparer in self._coarser.items()
        }
        return other

    @property
    def lever_m(self) -> float:
        """Half the target's diameter: what a rotation moves its rim by."""
        return 0.5 * self._diameter_m

    def score(self, depth_m: DepthImage, T_cam_model: FloatArray, tolerance_m: float) -> Agreement:
        """How well the target at a pose (4, 4) explains a frame, by depths this close."""
        rendered = self._renderer.render(T_cam_model, self.exposure(T_cam_model))
        rendered = rendered.without(self._unseen_beside(rendered, tolerance_m))
        return self._judged(depth_m, rendered, tolerance_m)[0]

    def _judged(
        self, depth_m: DepthImage, rendered: RenderedDepth, tolerance_m: float
    ) -> tuple[Agreement, Surroundings | None]:
        def surroundings() -> Surroundings | None:
            sigma_m = self._noise.sigma_in(depth_m)
            return self._surroundings.of(depth_m, self.camera, sigma_m, self._stride)

        strided, beams = depth_m[:: self._stride, :: self._stride], self._beams_here()
        unlooked = None if beams is None else ~beams.is_seen
        agreement, others = judged(strided, rendered, tolerance_m, surroundings, unlooked)
        if others is None and self._has_several_bodies:
            agreement = replace(agreement, may_lack_a_part=True)
        return agreement, others

    @cached_property
    def _has_several_bodies(self) -> bool:
        return has_several_bodies(self._target.mesh)

    def _loosest(self, sigma_m: float) -> float:
        """The largest difference in depth, m, at which anything is said to agree: where little of a
        pose is known, much would."""
        return GATE_SIGMA * sigma_m + _LOOSE_FRACTION * self._diameter_m

    def doubt_px(self, T_cam_model: FloatArray, pose_covariance: FloatArray) -> float:
        """How far a point at the target's rim may be from where a pose (4, 4) shows it, pixels."""
        focal = max(self.camera.fx, self.camera.fy) / self._stride
        doubt_m = self._doubt_m(self._without_turns(T_cam_model), pose_covariance)
        return doubt_m * focal / float(np.linalg.norm(T_cam_model[:3, 3]))

    def _without_turns(self, T_cam_model: FloatArray) -> FloatArray | None:
        roundness = self._target.roundness
        return None if roundness is None else roundness.without_turns(T_cam_model[:3, :3])

    def _noise_beside_facets(self, T_cam_model: FloatArray) -> SensorNoise:
        """The noise, and of a round target how far the facets of its mesh are off: they are turned
        as it happens, and move all of its surface and of its outline together."""
        roundness, noise = self._target.roundness, self._noise
        if roundness is None:
            return noise
        off_px = roundness.deviation_m * self._span_px(T_cam_model) / self._diameter_m
        off_m = _FACET_SHARE * roundness.deviation_m
        return replace(
            noise,
            face_sd_m=float(np.hypot(noise.face_sd_m, off_m)),
            face_tilt_sd_m=float(np.hypot(noise.face_tilt_sd_m, off_m)),
            outline_sd_px=float(np.hypot(noise.outline_sd_px, off_px / self._stride)),
        )

    def _doubt_m(self, without_turns: FloatArray | None, pose_covariance: FloatArray) -> float:
        """How far a point at the target's rim may be from where a pose has it."""
        if without_turns is not None:
            pose_covariance = without_turns @ pose_covariance @ without_turns.T
        shift = float(np.trace(pose_covariance[:3, :3])) / 3.0
        turn = float(np.trace(pose_covariance[3:, 3:])) / 3.0
        return float(np.sqrt(shift + self.lever_m**2 * turn))

    def compare(
        self,
        depth_m: DepthImage,
        T_cam_model: FloatArray,
        pose_covariance: FloatArray,
        is_beaten: Callable[[Agreement], bool] = never,
    ) -> Comparison:
        """Compare a frame with a pose.

        Args:
            depth_m: (height, width), 0 where nothing returned.
            T_cam_model: (4, 4) predicted.
            pose_covariance: (6, 6) of its error, as `FaceEvidence` has it.
            is_beaten: whether no face is worth being measured, the frame being explained so.
        """
        whole = self._renderer.render(T_cam_model, self.exposure(T_cam_model))
        return self._compared(depth_m, whole, T_cam_model, pose_covariance, is_beaten)

    def compare_with_itself(
        self, T_cam_model: FloatArray, pose_covariance: FloatArray
    ) -> Comparison:
        """Compare the view from a pose (4, 4), without noise, with itself: what it would tell of an
        error of the pose, whose covariance is (6, 6)."""
        whole = self._renderer.render(T_cam_model)
        return self._compared(whole.depth_m, whole, T_cam_model, pose_covariance)

    def _compared(
        self,
        depth_m: DepthImage,
        whole: RenderedDepth,
        T_cam_model: FloatArray,
        pose_covariance: FloatArray,
        is_beaten: Callable[[Agreement], bool] = never,
    ) -> Comparison:
        """A frame with a view."""
        beams = self._beams_here()
        noise = self._noise_beside_facets(T_cam_model)
        whole_m, depth_m = depth_m, depth_m[:: self._stride, :: self._stride]
        # What depends on the noise roughly takes that at the target's range.
        typical_m = noise.sigma_at(float(np.linalg.norm(T_cam_model[:3, 3])))
        # What a face or a frame shares moves its returns off the view as well.
        total_m = float(np.hypot(typical_m, noise.shared_sd_m))
        unseen = self._unseen_beside(whole, self._loosest(total_m))
        rendered = whole.without(unseen)
        without_turns = self._without_turns(T_cam_model)
        doubt = PoseDoubt(T_cam_model, pose_covariance, total_m, without_turns)
        # A crease by less than the pose is doubted does not matter yet; of a curved mesh, whose
        # facets are small, hardly a pixel of a coarse grid would be left.
        doubted_m = float(np.hypot(typical_m, self._doubt_m(without_turns, pose_covariance)))
        doubt_px = self.doubt_px(T_cam_model, pose_covariance)
        # A coarse grid is made of more.
        few_pixels = FEW_PIXELS if self._stride == 1 else 0
        whole = rendered if beams is None else whole
        pixels = surface_pixels(whole, doubted_m, doubt_px, noise, few_pixels, beams)
        face_of_triangle = self._face_of_triangle
        residuals = pixels.residuals(depth_m, rendered, doubt, noise, face_of_triangle, beams)
        residuals = replace(residuals, time_s=self._times_of(pixels, rendered))
        face_of_triangle = pooled_faces(self._face_of_triangle, residuals, few_pixels)
        residuals = replace(residuals, face=face_of_triangle[pixels.triangle])
        variance = residuals.pose_variance_m2
        typical = float(np.median(variance)) if len(variance) else 0.0
        tolerance = GATE_SIGMA * float(np.sqrt(total_m**2 + typical))
        loosest = min(tolerance, self._loosest(total_m))
        explained, surroundings = self._judged(whole_m, rendered, loosest)
        reach = contour_reach(doubt_px)
        outline = outline_frame(*(depth_m, rendered, surroundings, tolerance, reach, unseen))
        if beams is not None:
            outline = outline_of_scan(beams, rendered.camera, depth_m, outline)
        if surroundings is not None:
            # Lone returns are false ones: where they are, one is lost.
            is_thing = surroundings.labels[rendered.window][pixels.pixels] > 0
            residuals = replace(residuals, returned=is_thing)
        if self._measured is not None:
            agrees = residuals.agrees & self._measured[pixels.triangle]
            residuals = replace(residuals, agrees=agrees)
        ranges = range_fits(residuals, noise)
        seen = SeenFrame(
            *(depth_m, rendered, doubt, self._edges, face_of_triangle),
            *(residuals.dropout, noise, self._noise),
            ranges=ranges,
            residuals=residuals,
            outline=outline,
            measured=self._measured,
        )
        faces: tuple[FaceEvidence, ...] = ()
        if not is_beaten(explained):
            faces = face_evidence(seen, self._target.rectangles, self._modalities)
        labels, motion = _labels(seen), self.readout
        return Comparison(T_cam_model, rendered, faces, explained, labels, seen, motion)


def _labels(seen: SeenFrame) -> IntArray:
    """(height, width) place in ``ranges`` of the face of each pixel that agrees, -1 for none."""
    residuals, rendered = seen.residuals, seen.rendered
    # The last place is that of faces that are in no catalogue.
    label_of_face = np.full(int(residuals.face.max(initial=-1)) + 2, -1, dtype=np.intp)
    for label, face in enumerate(seen.ranges):
        label_of_face[face] = label
    labels = np.full(seen.depth_m.shape, -1, dtype=np.intp)
    shown = np.where(residuals.agrees, label_of_face[residuals.face], -1)
    labels[rendered.window][residuals.pixels] = shown
    return labels
