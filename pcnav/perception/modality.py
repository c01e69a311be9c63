"""What a modality measures a frame by, and what it answers: evidence of a pose, face by face."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from pcnav.core.arrays import DepthImage, FloatArray, IntArray
from pcnav.perception.contour import MeshEdges, PoseDoubt
from pcnav.perception.outline_frame import OutlineFrame
from pcnav.target.rendering import RenderedDepth


class Evidence(NamedTuple):
    """Of the error of a pose: translation of the model origin (m, camera axes), rotation (rad,
    model axes)."""

    information: FloatArray
    """(6, 6) inverse covariance; may be singular."""
    vector: FloatArray
    """(6,) information times the error."""

    @staticmethod
    def of(value: FloatArray, variance: FloatArray, jacobian: FloatArray) -> "Evidence":
        """That of independent numbers (n,), measured minus predicted, with derivatives (n, 6)."""
        weighted = jacobian.T / variance
        return Evidence(weighted @ jacobian, weighted @ value)

    def with_also(self, other: "Evidence") -> "Evidence":
        """Both, which err independently."""
        return Evidence(self.information + other.information, self.vector + other.vector)


@dataclass(frozen=True)
class RangeFit:
    """The range residuals of the pixels of one face."""

    evidence: Evidence
    n_pixels: int
    chi_square_per_dof: float
    """About the face's own best fit."""


@dataclass(frozen=True)
class SeenFrame:
    """A frame beside the view rendered at a pose."""

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
    ranges: Mapping[int, RangeFit]
    """By face, of those of which enough is seen."""
    outline: OutlineFrame | None = None
    """The frame as the outline is read in it, where it holds more than the target."""


Modality = Callable[[SeenFrame], Callable[[int], Evidence]]
"""Measures a frame; the result is asked for each face that has ranges."""
