"""Render and compare: how far a frame lies from the view that a predicted pose gives.

The model is ray-cast once at the prediction. The range residuals of the pixels inside its surfaces
tell how each face is displaced along the line of sight and tilted; the outline (`contour`) tells
how it is displaced across. Both are linear in the error of the pose, with noise that is known:
white along the rays, and the pixel grid's at the outline. Cut and hidden parts bias nothing, since
the prediction is cut alike. No planes are searched for and no pixel is given to a face by what it
measures, so the measurement does not lean on the prediction.
"""

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from functools import reduce

import numpy as np
from scipy import ndimage

from pcnav.config.depth import MODALITIES_BY_DEFAULT, ModalityName
from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays, range_per_depth
from pcnav.perception.agreement import Agreement, judged
from pcnav.perception.contour import contour_reach
from pcnav.perception.correlated_ranges import face_field, range_evidence
from pcnav.perception.mesh_edges import mesh_edges
from pcnav.perception.modality import Evidence, Modality, RangeFit, RangeResiduals, SeenFrame
from pcnav.perception.outline_frame import outline_frame
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.predicted_view import rectangle_of_triangle
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.surroundings import Surroundings, SurroundingsFinder
from pcnav.target.rendering import DepthRenderer, RenderedDepth
from pcnav.target.row_motion import Readout
from pcnav.target.satellite import Rectangle, Target

_GATE_SIGMA = 4.0
"""A range residual beyond this many standard deviations is no return of the predicted surface."""
_LOOSE_FRACTION = 0.01
"""However uncertain a pose is, its view explains what lies within this share of the diameter, and
the noise, of it."""
_CREASE_SIGMA = 0.5
"""A pixel is inside a surface when the faces of its neighbours, extended to it, differ from its own
by less than this many standard deviations of the noise."""
_MIN_PIXELS = 12
"""Fewer pixels of a face are not used."""
_MIN_COSINE = 0.1
"""Surfaces seen at more than 84 degrees are not used: within a pixel their range varies widely."""
_MISFIT_SD = 3.0
"""Residuals this much above the noise's own spread are no chance: the face is not as modelled."""
_WHOLE_SHARE, _MIN_WHOLE = 0.5, 300
"""While it is not known what a pixel sees, those beside an edge are left out of a view of which
this share and so many pixels remain."""
_COARSEST_STRIDE = 4
_MIN_COARSE_PIXELS = 300
"""A coarse grid keeps about so many pixels on the target."""
_NO_FACE = -1
_WITHOUT_RANGES = -2
"""Asks for the outline of all faces that have no ranges."""


@dataclass(frozen=True)
class FaceEvidence:
    """What one face (or all surfaces that belong to none) says of the error of a predicted pose.

    The error is (6,): translation of the model origin (m, camera axes), rotation (rad, model axes).
    """

    rectangle: Rectangle | None
    """None for the surfaces that are on no catalogue rectangle."""
    information: FloatArray
    """(6, 6) inverse covariance; may be singular."""
    vector: FloatArray
    """(6,) information times the error."""
    n_pixels: int
    chi_square_per_dof: float
    """Of the range residuals about the face's own best fit."""
    with_shared: Evidence | None = None
    """The same with errors that the faces of the frame share as further unknowns, if there are."""

    @property
    def joint(self) -> Evidence:
        """All that it says, for a sum over the faces of a frame."""
        return self.with_shared or Evidence(self.information, self.vector)

    @property
    def name(self) -> str:
        """For tables."""
        return "other surfaces" if self.rectangle is None else self.rectangle.name


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


def _ranges(seen: SeenFrame) -> Callable[[int], Evidence]:
    return lambda face: seen.ranges[face].evidence


def _outline(seen: SeenFrame) -> Callable[[int], Evidence]:
    runs = seen.contour
    run_face = seen.face_of_triangle[runs.triangle]
    jacobian = runs.jacobian
    if seen.noise.has_shared_errors:
        no_offset = np.zeros((len(runs), 1))
        shared = runs.shared * seen.noise.outline_offset_sd_px
        jacobian = np.hstack([jacobian, no_offset, shared])
    compared = np.isin(run_face, list(seen.ranges))

    def of_face(face: int) -> Evidence:
        own = ~compared if face == _WITHOUT_RANGES else run_face == face
        return Evidence.of(runs.value[own], runs.variance[own], jacobian[own])

    return of_face


MODALITIES: Mapping[ModalityName, Modality] = {
    ModalityName.RANGES: _ranges,
    ModalityName.OUTLINE: _outline,
}
"""What frames may be compared by. Their errors are taken as independent."""


class RenderComparer:
    """Compares frames of one camera with one target; what never changes is built once."""

    def __init__(
        self,
        target: Target,
        camera: PinholeCamera,
        noise: SensorNoise | float,
        stride: int = 1,
        modalities: Sequence[ModalityName] = MODALITIES_BY_DEFAULT,
    ) -> None:
        """``stride`` compares on every so many pixels of the frames of ``camera`` only, by
        ``modalities``; ``noise`` that is a number is white and of that deviation, m."""
        self.camera, self._modalities = camera, tuple(modalities)
        self._target, self._stride = target, stride
        self._noise, self._coarser = SensorNoise.of(noise), dict[int, RenderComparer]()
        self._renderer = DepthRenderer(target.mesh, camera.strided(stride))
        self._edges = mesh_edges(target.mesh)
        self._face_of_triangle = rectangle_of_triangle(target)
        self._diameter_m = target.diameter_m
        self.readout: Readout | None = None
        """How the target moves while rows are read out; None while that is unknown or nothing."""
        self._surroundings = SurroundingsFinder(target.diameter_m)
        self._unseen: BoolArray | None = None

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
                self._target, self.camera, self._noise, stride, self._modalities
            )
            self._coarser[stride].unseen = self._unseen
        self._coarser[stride].readout = self.readout
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
    def unseen(self) -> BoolArray | None:
        """(height, width) pixels of the frames compared next of which nothing is known."""
        return self._unseen

    @unseen.setter
    def unseen(self, unseen: BoolArray | None) -> None:
        self._unseen = unseen
        for comparer in self._coarser.values():
            comparer.unseen = unseen

    def _view(self, T_cam_model: FloatArray) -> RenderedDepth:
        """From a pose (4, 4), as far as it is seen."""
        row_poses = None
        if self.readout is not None:
            row_poses = self.readout.poses(T_cam_model, self.camera.height, self._stride)
        rendered = self._renderer.render(T_cam_model, row_poses)
        if self._unseen is None:
            return rendered
        return rendered.without(self._unseen[:: self._stride, :: self._stride])

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
        rendered = self._view(T_cam_model)
        return self._judged(depth_m, rendered, tolerance_m)[0]

    def _judged(
        self, depth_m: DepthImage, rendered: RenderedDepth, tolerance_m: float
    ) -> tuple[Agreement, Surroundings | None]:
        def surroundings() -> Surroundings | None:
            sigma_m = self._noise.sigma_in(depth_m)
            return self._surroundings.of(depth_m, self.camera, sigma_m, self._stride)

        strided = depth_m[:: self._stride, :: self._stride]
        return judged(strided, rendered, tolerance_m, surroundings)

    def _loosest(self, sigma_m: float) -> float:
        """The largest difference in depth, m, at which anything is said to agree: where little of a
        pose is known, much would."""
        return _GATE_SIGMA * sigma_m + _LOOSE_FRACTION * self._diameter_m

    def doubt_px(self, T_cam_model: FloatArray, pose_covariance: FloatArray) -> float:
        """How far a point at the target's rim may be from where a pose (4, 4) shows it, pixels."""
        focal = max(self.camera.fx, self.camera.fy) / self._stride
        doubt_m = self._doubt_m(pose_covariance)
        return doubt_m * focal / float(np.linalg.norm(T_cam_model[:3, 3]))

    def _doubt_m(self, pose_covariance: FloatArray) -> float:
        """How far a point at the target's rim may be from where a pose has it."""
        shift = float(np.trace(pose_covariance[:3, :3])) / 3.0
        turn = float(np.trace(pose_covariance[3:, 3:])) / 3.0
        return float(np.sqrt(shift + self.lever_m**2 * turn))

    def compare(
        self, depth_m: DepthImage, T_cam_model: FloatArray, pose_covariance: FloatArray
    ) -> Comparison:
        """Compare a frame with a pose.

        Args:
            depth_m: (height, width), 0 where nothing returned.
            T_cam_model: (4, 4) predicted.
            pose_covariance: (6, 6) of its error, as `FaceEvidence` has it.
        """
        rendered = self._view(T_cam_model)
        whole_m, depth_m = depth_m, depth_m[:: self._stride, :: self._stride]
        # What depends on the noise roughly takes that at the target's range.
        typical_m = self._noise.sigma_at(float(np.linalg.norm(T_cam_model[:3, 3])))
        # A crease by less than the pose is doubted does not matter yet; of a curved mesh, whose
        # facets are small, hardly a pixel of a coarse grid would be left.
        doubted_m = float(np.hypot(typical_m, self._doubt_m(pose_covariance)))
        pixels = _surface_pixels(rendered, doubted_m, self._noise)
        seen_m = depth_m[rendered.window][pixels.inside] * pixels.range_per_depth
        returned = seen_m > 0.0
        residual = seen_m - pixels.range_m
        doubt = PoseDoubt(T_cam_model, pose_covariance, typical_m)
        sigma_m = self._noise.sigma_at(pixels.range_m)
        # ``n . dx / (n . ray)`` at the surface point x.
        along, p_cam = pixels.m * pixels.range_m[:, None], pixels.rays * pixels.range_m[:, None]
        jacobian = doubt.by_pose(along, p_cam)
        variance = doubt.variance(jacobian)
        agrees = returned & (residual**2 < _GATE_SIGMA**2 * (sigma_m**2 + variance))
        typical = float(np.median(variance)) if len(variance) else 0.0
        tolerance = _GATE_SIGMA * float(np.sqrt(typical_m**2 + typical))
        loosest = min(tolerance, self._loosest(typical_m))
        explained, surroundings = self._judged(whole_m, rendered, loosest)
        reach = contour_reach(self.doubt_px(T_cam_model, pose_covariance))
        unseen = None
        if self._unseen is not None:
            unseen = self._unseen[:: self._stride, :: self._stride]
        outline = outline_frame(depth_m, rendered, surroundings, tolerance, reach, unseen)
        if surroundings is not None:
            # Lone returns are false ones: where they are, one is lost.
            returned = surroundings.labels[rendered.window][pixels.inside] > 0
        dropout = float(np.mean(~returned)) if len(returned) else 0.0
        index = self._face_of_triangle[pixels.triangle]
        residuals = RangeResiduals(
            index, returned, agrees, residual, jacobian, pixels.range_m, sigma_m, pixels.inside
        )
        ranges = self._ranges(residuals)
        seen = SeenFrame(
            *(depth_m, rendered, doubt, self._edges, self._face_of_triangle, dropout),
            *(self._noise, ranges, residuals, outline),
        )
        labels = np.full(depth_m.shape, _NO_FACE, dtype=np.intp)
        label_of_face = np.full(len(self._target.rectangles) + 1, _NO_FACE, dtype=np.intp)
        for label, face in enumerate(ranges):
            label_of_face[face] = label
        shown = np.where(agrees, label_of_face[index], _NO_FACE)
        labels[rendered.window][pixels.inside] = shown
        return Comparison(
            T_cam_model,
            rendered,
            self._faces(seen),
            explained,
            labels,
            seen,
        )

    def _faces(self, seen: SeenFrame) -> tuple[FaceEvidence, ...]:
        measured, rectangles = (
            [MODALITIES[name](seen) for name in self._modalities],
            self._target.rectangles,
        )
        faces = []
        for face, fit in seen.ranges.items():
            joint = reduce(Evidence.with_also, (of_face(face) for of_face in measured))
            rectangle = None if face == _NO_FACE else rectangles[face]
            of_pose = joint.of_pose
            fitted = fit.n_pixels, fit.chi_square_per_dof
            faces.append(FaceEvidence(rectangle, *of_pose, *fitted, joint))
        if faces and seen.is_beside_others and ModalityName.OUTLINE in self._modalities:
            # Grazed faces have no ranges, but edges. Where others are hidden, they are needed.
            rest = measured[self._modalities.index(ModalityName.OUTLINE)](_WITHOUT_RANGES)
            if rest.information.any():
                faces.append(FaceEvidence(None, *rest.of_pose, 0, float("nan"), rest))
        return tuple(faces)

    def _ranges(self, seen: RangeResiduals) -> dict[int, RangeFit]:
        """By face of which enough pixels agree."""
        found = {}
        index = np.where(seen.agrees, seen.face, len(self._target.rectangles) + 1)
        for face in np.unique(index[seen.agrees]).tolist():
            chosen = index == face
            n = int(np.count_nonzero(chosen))
            if n < _MIN_PIXELS:
                continue
            H, r, scale_m = seen.jacobian[chosen], seen.residual_m[chosen], seen.sigma_m
            if isinstance(scale_m, np.ndarray):
                # Weighted about the face's own typical noise.
                own = scale_m[chosen]
                scale_m = float(np.sqrt(np.mean(own**2)))
                H, r = H * (scale_m / own)[:, None], r * (scale_m / own)
            information, vector = H.T @ H, H.T @ r
            misfit = _misfit(information, vector, float(r @ r), n, scale_m)
            variance = scale_m**2 * _inflation(misfit, n)
            if self._noise.is_white:
                weight = 1.0 / variance
                evidence = Evidence(information * weight, vector * weight)
            else:
                field = face_field(seen.u[chosen], seen.v[chosen])
                evidence = range_evidence(H, r, field, variance, self._noise)
            found[face] = RangeFit(evidence, n, misfit)
        return found


@dataclass(frozen=True)
class _Pixels:
    """Pixels inside the surfaces of a rendered view (n of them)."""

    inside: BoolArray
    """(height, width) of the rendered window: which they are."""
    triangle: IntArray
    rays: FloatArray
    """(n, 3) unit."""
    range_m: FloatArray
    range_per_depth: FloatArray
    m: FloatArray
    """(n, 3) plane, ``m . ray = 1 / range``."""


def _surface_pixels(rendered: RenderedDepth, sigma_m: float, noise: SensorNoise) -> _Pixels:
    """``sigma_m`` is that of the noise where the target is."""
    triangle = rendered.triangle[rendered.window]
    depth = rendered.depth_m[rendered.window].astype(np.float64)
    rays = pixel_rays(rendered.camera)[rendered.window]
    inside = triangle >= 0
    # Slices, for a target out of view leaves an empty window.
    inside[:1] = inside[-1:] = False
    inside[:, :1] = inside[:, -1:] = False
    planes = rendered.inverse_depth_planes
    for first, second in (
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
    ):
        i, j = np.nonzero(triangle[first] != triangle[second])
        a, b = triangle[first][i, j], triangle[second][i, j]
        for here, mine, other in ((first, a, b), (second, b, a)):
            # Relative gap of inverse depths is that of depths.
            gap = np.einsum("ij,ij->i", planes[other] - planes[mine], rays[here][i, j])
            smooth = (mine >= 0) & (other >= 0)
            smooth &= np.abs(gap) * depth[here][i, j] ** 2 < _CREASE_SIGMA * sigma_m
            inside[here][i[~smooth], j[~smooth]] = False
    if noise.may_have_footprint:
        # Pixels that see nothing but their surface in all of their area.
        whole = ndimage.binary_erosion(inside, np.ones((3, 3), dtype=np.bool_))
        left, n = np.count_nonzero(whole), np.count_nonzero(inside)
        if noise.has_footprint or left > max(_WHOLE_SHARE * n, _MIN_WHOLE):
            inside = whole
    kept = triangle[inside]
    per_depth = range_per_depth(rendered.camera)[rendered.window][inside]
    m = planes[kept]
    if rendered.row_planes is not None:
        m = rendered.row_planes.at(kept, np.nonzero(inside)[0] + rendered.window[0].start)
    norm = np.linalg.norm(m, axis=1)
    unit = rays[inside] / per_depth[:, None]
    inverse = np.einsum("ij,ij->i", m, unit)
    steep = inverse < _MIN_COSINE * norm
    if steep.any():
        inside[inside] = ~steep
        kept, per_depth, m, unit, inverse = (
            part[~steep] for part in (kept, per_depth, m, unit, inverse)
        )
    return _Pixels(inside, kept, unit, 1.0 / inverse, per_depth, m)


def _misfit(gram: FloatArray, vector: FloatArray, squares: float, n: int, sigma_m: float) -> float:
    """Chi-square per degree of freedom of residuals about their own linear fit."""
    strength, axes = np.linalg.eigh(gram)
    known = strength > 1e-9 * strength[-1]
    fitted = float(np.sum((vector @ axes[:, known]) ** 2 / strength[known]))
    return max(squares - fitted, 0.0) / (sigma_m**2 * max(n - 3, 1))


def _inflation(chi_square_per_dof: float, n: int) -> float:
    expected = 1.0 + _MISFIT_SD * np.sqrt(2.0 / n)
    return chi_square_per_dof if chi_square_per_dof > expected else 1.0
