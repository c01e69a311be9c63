"""Pose hypotheses from the parts of a frame that may be the target, by the look of its surface.

Each part is compared with sampled views of the target; what fits the part is then judged by the
same score as any other hypothesis, the agreement of the whole frame with the view rendered there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.agreement import Agreement
from pcnav.perception.pose_hypotheses import PoseHypothesis, depth_tolerance
from pcnav.perception.regions import Region, RegionSearch
from pcnav.perception.render_compare import RenderComparer
from pcnav.perception.sampled_views import SampledViews
from pcnav.perception.view_matching import PartLayout, ViewMatch
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Target

_MAX_COMPARED = 6
"""Parts that are compared with all views, those first that some view fits best."""
_MIN_FIRST_SHARE = 0.4
"""Of the best part's score on few views, for another part to be compared with all."""
_MAX_LAG = 0.25
_MAX_RENDERED = 24
"""Poses that are scored by rendering; each part has its best two among them."""
_PROPOSED_BY = "sampled view"


@dataclass(frozen=True)
class RegionTried:
    """A part of a frame in which the target was searched for."""

    extent_m: float
    """Of its returns, as the diameter of a ball about them."""
    n_returns: int
    inlier_ratio: float
    """Of the frame with the best pose found there, 0 to 1; nan where none was worth rendering."""


@dataclass(frozen=True)
class SearchReport:
    """What a search of one frame for the target looked at."""

    diameter_m: float
    """Of the target."""
    span_m: float
    """Of all returns, as the diameter of a ball about them; 0 without any."""
    n_planes: int
    """Planes larger than any flat part of the target that were taken out."""
    tried: tuple[RegionTried, ...]
    """Parts of about its size, the best first."""

    @property
    def best_inlier_ratio(self) -> float:
        """Of the best pose found anywhere; nan without one."""
        found = [region.inlier_ratio for region in self.tried]
        return float(np.nanmax(found)) if not np.all(np.isnan(found)) else float("nan")


def report_of(search: RegionSearch, best: Sequence[float], diameter_m: float) -> SearchReport:
    """A report of a search whose regions gave poses that explain so much of the frame."""
    tried = [
        RegionTried(region.extent_m, region.n_returns, ratio)
        for region, ratio in zip(search.regions, best, strict=True)
    ]
    tried.sort(key=lambda region: -np.nan_to_num(region.inlier_ratio, nan=-1.0))
    return SearchReport(diameter_m, search.span_m, search.n_planes, tuple(tried))


def view_hypotheses(
    frame: Frame,
    search: RegionSearch,
    views: SampledViews,
    target: Target,
    comparer: RenderComparer,
) -> tuple[tuple[PoseHypothesis, ...], SearchReport]:
    """Hypotheses from the regions of a frame, the one that explains most first, and a report.

    ``comparer`` scores, each region by the noise that it shows.
    """
    hypotheses = []
    best = [float("nan")] * len(search.regions)
    for region, match in _worth_rendering(_matches(frame, search.regions, views, target)):
        part = search.regions[region]
        tolerance = depth_tolerance(target, part.sigma_m)
        agreement = comparer.score(frame.depth_m, match.T_cam_model, tolerance)
        hypotheses.append(PoseHypothesis(match.T_cam_model, agreement, _PROPOSED_BY, part))
        best[region] = float(np.fmax(best[region], agreement.inlier_ratio))
    weights = evidence_weights([(h.T_cam_model, h.agreement) for h in hypotheses])
    order = np.argsort(-weights, kind="stable").tolist()
    return tuple(hypotheses[k] for k in order), report_of(search, best, target.diameter_m)


def evidence_weights(found: Sequence[tuple[FloatArray, Agreement]]) -> FloatArray:
    """(n,) how much speaks for each of poses (4, 4) in one frame, 0 to 1.

    That nothing speaks against a pose means little where hardly anything speaks for it: it may lie
    behind other things, or on a patch of them. The surface explained counts, in square metres, so
    that a far target weighs as much as a near one.
    """
    areas = np.array(
        [max(agreement.support, 0) * float(T[:3, 3] @ T[:3, 3]) for T, agreement in found]
    )
    ratios = np.array([np.nan_to_num(agreement.inlier_ratio) for _, agreement in found])
    return ratios * np.sqrt(areas / max(float(areas.max(initial=0.0)), 1e-12))


def _matches(
    frame: Frame, regions: Sequence[Region], views: SampledViews, target: Target
) -> list[tuple[int, list[ViewMatch]]]:
    """For each region compared with all views, its number and the poses found there."""
    layouts = [PartLayout(region, frame, views) for region in regions]
    first = np.array([layout.first_score() for layout in layouts])
    order = np.argsort(-first)[:_MAX_COMPARED].tolist()
    chosen = [k for k in order if first[k] >= _MIN_FIRST_SHARE * first.max()]
    for k in chosen:
        layouts[k].match()
    return [(k, layouts[k].matches(target)) for k in chosen]


def _worth_rendering(
    found: Sequence[tuple[int, Sequence[ViewMatch]]],
) -> list[tuple[int, ViewMatch]]:
    """The best fitting poses of all regions, with the number of their region."""
    fits = [match.fit for _, matches in found for match in matches]
    least = max(fits, default=0.0) - _MAX_LAG
    pairs = [
        (k, match, place)
        for k, matches in found
        for place, match in enumerate(matches)
        if match.fit >= least or place < 2
    ]
    pairs.sort(key=lambda pair: (pair[2] >= 2, -pair[1].fit))
    return [(k, match) for k, match, _ in pairs[:_MAX_RENDERED]]
