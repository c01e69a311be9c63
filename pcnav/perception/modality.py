"""What a modality measures a frame by, and what it answers: evidence of a pose, face by face."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray, picked
from pcnav.perception.contour import ContourRuns, contour_runs
from pcnav.perception.edge_conflicts import KnownError
from pcnav.perception.mesh_edges import MeshEdges
from pcnav.perception.outline_frame import OutlineFrame
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.rendering import RenderedDepth

POSE_SIZE = 6
_MAX_DROPOUT = 0.9
_ANYWHERE_FRACTION, _ANYWHERE_RAD = 0.1, 0.2
"""So far a pose may be off, over the diameter and in rad, for all that its outline is asked."""


class Evidence(NamedTuple):
    """Of the error of a pose: translation of the model origin (m, camera axes), rotation (rad,
    model axes).

    After these six may stand k errors of the sensor that the faces of a frame share, in standard
    deviations: what is known of them beforehand, that they have unit variance, is not part of it.
    """

    information: FloatArray
    """(6 + k, 6 + k) inverse covariance; may be singular."""
    vector: FloatArray
    """(6 + k,) information times the error."""

    @staticmethod
    def of(value: FloatArray, variance: FloatArray, jacobian: FloatArray) -> "Evidence":
        """That of independent numbers (n,), measured minus predicted, with derivatives
        (n, 6 + k)."""
        weighted = jacobian.T / variance
        return Evidence(weighted @ jacobian, weighted @ value)

    def with_also(self, other: "Evidence") -> "Evidence":
        """Both, which err independently."""
        return Evidence(self.information + other.information, self.vector + other.vector)

    @property
    def of_pose(self) -> "Evidence":
        """Of the pose alone, the shared errors being what they may be."""
        size = len(self.vector)
        if size == POSE_SIZE:
            return self
        shared = self.information[POSE_SIZE:, POSE_SIZE:] + np.eye(size - POSE_SIZE)
        cross = self.information[:POSE_SIZE, POSE_SIZE:]
        both = np.column_stack([cross.T, self.vector[POSE_SIZE:]])
        solved = np.linalg.solve(shared, both)
        information = self.information[:POSE_SIZE, :POSE_SIZE] - cross @ solved[:, :-1]
        return Evidence(
            0.5 * (information + information.T), self.vector[:POSE_SIZE] - cross @ solved[:, -1]
        )

    @staticmethod
    def together(parts: "Iterable[Evidence]", n_shared: int) -> "Evidence":
        """All of them, which err independently but for ``n_shared`` errors."""
        size = POSE_SIZE + n_shared
        return reduce(Evidence.with_also, parts, Evidence(np.zeros((size, size)), np.zeros(size)))


@dataclass(frozen=True)
class RangeFit:
    """The range residuals of the pixels of one face."""

    evidence: Evidence
    n_pixels: int
    chi_square_per_dof: float
    """About the face's own best fit."""
    variance_m2: float
    """Of the white noise of each pixel, which a face that is not as modelled has more of."""
    by_field: FloatArray | None = None
    """(3, 6 + k) what the offset and the tilts of the face, each of one deviation, add to the
    vector of the evidence; None where faces are not known to err."""


@dataclass(frozen=True)
class RangeResiduals:
    """The returns on the surfaces of a view (n pixels), measured minus predicted range."""

    face: IntArray
    """(n,) place in the catalogue, -1 for surfaces that are on none of it."""
    returned: BoolArray
    agrees: BoolArray
    """(n,) with the view, to the noise and the doubt about the pose."""
    residual_m: FloatArray
    jacobian: FloatArray
    """(n, 6) by the pose."""
    pose_variance_m2: FloatArray
    """(n,) of the residual, by the doubt about the pose."""
    range_m: FloatArray
    """(n,) predicted."""
    sigma_m: float | FloatArray
    """White noise of each, or of all."""
    pixels: tuple[IntArray, IntArray]
    """(n,) rows and (n,) columns, in the window of the view, that they are of."""
    shape: tuple[int, int]
    """(height, width) of that window."""
    time_s: FloatArray | None = None
    """(n,) when they were seen, from the time of the frame on; None where all at once."""

    @property
    def dropout(self) -> float:
        """Share of the returns that are lost at random: of the pixels beside one that returned.

        Where the target is cut, or sees nothing over a patch, all are lost and none at random.
        """
        if self.returned.all():
            return 0.0
        inside, seen = np.zeros((2, *self.shape), dtype=np.bool_)
        inside[self.pixels] = True
        seen[self.pixels] = self.returned
        beside = inside[:, 1:] & seen[:, :-1]
        n = int(np.count_nonzero(beside))
        return np.count_nonzero(beside & ~seen[:, 1:]) / n if n else 1.0

    @cached_property
    def v(self) -> FloatArray:
        """(n,) row in the window."""
        return self.pixels[0].astype(np.float64)

    @cached_property
    def u(self) -> FloatArray:
        """(n,) column in the window."""
        return self.pixels[1].astype(np.float64)


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """A frame beside the view rendered at a pose. Each is like itself alone."""

    depth_m: DepthImage
    """(height, width), 0 where nothing returned."""
    rendered: RenderedDepth
    doubt: PoseDoubt
    """About the pose."""
    edges: MeshEdges
    face_of_triangle: IntArray
    """Of the mesh: place in the catalogue, -1 for none."""
    dropout: float
    """Share of the returns that are lost at random."""
    noise: SensorNoise
    """Of the sensor, and what the facets of a round target add to it."""
    sensor_noise: SensorNoise
    """Of the sensor alone."""
    ranges: Mapping[int, RangeFit]
    """By face, of those of which enough is seen."""
    residuals: "RangeResiduals"
    outline: OutlineFrame | None = None
    """The frame as the outline is read in it, where it holds more than the target."""
    measured: BoolArray | None = None
    """(n_faces,) triangles of the mesh that say something of the pose; None for all."""

    @property
    def is_beside_others(self) -> bool:
        """Whether other things hide, touch or go on with parts of the target's outline."""
        return self.outline is not None and bool(self.outline.unknown.any())

    @cached_property
    def contour(self) -> ContourRuns:
        """The outline of the frame against that of the view."""
        depth_m, unknown = self.depth_m, None
        if self.outline is not None:
            depth_m, unknown = self.outline.depth_m, self.outline.unknown
        dropout = min(self.dropout, _MAX_DROPOUT)
        runs = contour_runs(
            *(self.edges, depth_m, self.rendered, self.doubt, dropout, self.noise, unknown),
            self._without_outline,
        )
        return runs if self.measured is None else picked(runs, self.measured[runs.triangle])

    @property
    def _without_outline(self) -> KnownError:
        faces = (fit.evidence for fit in self.ranges.values())
        seen = Evidence.together(faces, self.noise.n_shared).of_pose
        # The doubt is that of a pose which the outline may have been part of.
        sd = np.repeat([_ANYWHERE_FRACTION * self.edges.diameter_m, _ANYWHERE_RAD], 3)
        prior = np.linalg.inv(self.doubt.covariance + np.diag(sd**2))
        covariance = np.asarray(np.linalg.inv(prior + seen.information))
        return KnownError(covariance @ seen.vector, covariance)


Modality = Callable[[SeenFrame], Callable[[int], Evidence]]
"""Measures a frame; the result is asked for each face that has ranges."""
