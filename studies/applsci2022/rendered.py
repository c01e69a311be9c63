"""Figs. 5 and 7 from images: the nutating satellite rendered, its corners found and followed."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh

from pcnav.config.image_motion import FeatureTrackerTable
from pcnav.config.sensors import ShadingTable
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import log_rotation, make_transform
from pcnav.core.statistics import finite, root_mean_square
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.files.text_table import TextTable
from pcnav.perception.feature_tracking import track_features
from pcnav.recordings.images import GreyImage
from pcnav.recordings.tracks import MonocularTracks, TrackFrame
from pcnav.report.figures import new_figure, style_axes
from pcnav.simulation.images import RenderedImages
from pcnav.simulation.shading import ImageRenderer

from ..folder import StudyFigure
from ..tables import Claim, below, table
from . import paper
from .runs import KEY_FRAMES
from .scene import POINT_COLOUR, Truth, nutation, track_figure

NAME = "applsci2022, rendered"
_SEED = 1
_MIN_MATCHES = 8
"""The paper asks for more."""
_MARGIN_PX = 40
_LAST = 10


@dataclass(frozen=True)
class Tracked:
    """What the tracker made of the images, and the chain of its tracks."""

    first: GreyImage
    """(height, width)"""
    tracks: MonocularTracks
    matches: IntArray
    """(n - 1,) features that a frame shares with the one before."""
    pixel_error: FloatArray
    """(k,) by how much tracks left the point of the hull that they were first seen at, px."""
    angle_deg: FloatArray
    """(n,) error of the attitude; nan where the first segment is not."""


def rendered_images(truth: Truth, seed: int = _SEED) -> RenderedImages:
    """The hull of the printed mass properties, textured, before the paper's camera."""
    half, R_body_hull = paper.hull_half_sides_m()
    box = trimesh.creation.box(2.0 * half)
    box.apply_transform(make_transform(R_body_hull, np.zeros(3)))
    renderer = ImageRenderer(box, paper.CAMERA, ShadingTable(), seed)
    return RenderedImages(NAME, renderer, truth.motion, seed)


def track_images(duration_s: float) -> Tracked:
    """Render, follow, chain, compare.

    Raises `InputError` without the extra `images`.
    """
    truth, settings = nutation(duration_s, paper.INTERVAL_S, _SEED), FeatureTrackerTable()
    images = rendered_images(truth)
    seen = ((image.time_s, image.R_cam_world, image.grey) for image in images)
    frames = tuple(track_features(seen, paper.CAMERA, settings))
    tracks = MonocularTracks(NAME, paper.CAMERA, settings.pixel_sigma_px, frames)
    angle = np.full(len(frames), np.nan)
    for k, found in enumerate(run_chain(tracks, KEY_FRAMES)):
        if found.segment == 0 and found.R_world_body is not None:
            theta = log_rotation(found.R_world_body.T @ truth.R_world_body[k])
            angle[k] = np.rad2deg(np.linalg.norm(theta))
    names = [set(frame.features.tolist()) for frame in frames]
    shared = [len(before & now) for before, now in pairwise(names)]
    matches: IntArray = np.array(shared, dtype=np.intp)
    error = _pixel_errors(images, truth, frames)
    return Tracked(next(iter(images)).grey, tracks, matches, error, angle)


def _pixel_errors(images: RenderedImages, truth: Truth, frames: Sequence[TrackFrame]) -> FloatArray:
    """Tracks against the point of the hull that each was first seen at."""
    half, R_body_hull = paper.hull_half_sides_m()
    camera, place = paper.CAMERA, np.array(paper.PLACE_M)
    focal, middle = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    first: dict[int, FloatArray] = {}
    apart = []
    for frame, R in zip(frames, truth.R_world_body, strict=True):
        for name, pixel in zip(frame.features.tolist(), frame.pixels, strict=True):
            if name not in first:
                ray = np.append((pixel - middle) / focal, 1.0)
                start, along = (R_body_hull.T @ R.T @ v for v in (-place, ray))
                # The nearest face that looks this way is the last plane the ray enters by.
                enter = float(np.max((-np.sign(along) * half - start) / along))
                first[name] = R_body_hull @ (start + enter * along)
                continue
            p = R @ first[name] + place
            apart.append(np.linalg.norm(pixel - (p[:2] / p[2] * focal + middle)))
    return np.array(apart)


def rendered_figures(tracked: Tracked) -> list[StudyFigure]:
    """Figs. 5 and 7 as the tracker has them."""
    return [_feature_figure(tracked), track_figure(tracked.tracks)]


def _feature_figure(tracked: Tracked) -> StudyFigure:
    """Fig. 5: the first image and the corners that were found in it, in yellow as in print."""
    pixels = tracked.tracks.frames[0].pixels
    low = pixels.min(axis=0) - _MARGIN_PX
    high = pixels.max(axis=0) + _MARGIN_PX
    figure = new_figure(4.2)
    axes = figure.add_subplot()
    style_axes(axes)
    axes.grid(False)
    axes.imshow(tracked.first, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    axes.plot(pixels[:, 0], pixels[:, 1], "o", color=POINT_COLOUR, markersize=2.5)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(high[1], low[1])
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")
    return StudyFigure("fig_5", figure)


def rendered_claims(tracked: Tracked) -> list[Claim]:
    """More than eight features are found and followed, as the paper has it; how well, is ours."""
    found, least, share = _count(tracked), int(tracked.matches.min()), _share(tracked)
    more, images = f"> {_MIN_MATCHES}", "rendered images, key frames"
    attitude = f"last attitudes from {images}, deg"
    return [
        Claim(*("Fig. 5", "features found in an image", more, found), found > _MIN_MATCHES),
        Claim(*("Fig. 7", "features followed, fewest", more, least), least > _MIN_MATCHES),
        Claim("Fig. 8", f"frames with an attitude, {images}", "all", f"{share:.0%}", share == 1.0),
        below("-", attitude, [_last_error(tracked)], 1.0),
    ]


def rendered_table(tracked: Tracked) -> TextTable:
    """Finding and following in numbers."""
    lives = np.bincount(np.concatenate([frame.features for frame in tracked.tracks.frames]))
    rows = (
        ("features in the first image", _count(tracked)),
        ("features shared by successive images, fewest", int(tracked.matches.min())),
        ("the same, median", int(np.median(tracked.matches))),
        ("frames that a feature is followed, median", int(np.median(lives[lives > 0]))),
        ("error of a followed feature, RMS, px", root_mean_square(tracked.pixel_error)),
        ("the same, 95 % of them within, px", float(np.percentile(tracked.pixel_error, 95.0))),
        ("frames with an attitude", f"{_share(tracked):.0%}"),
        ("error of the last ten attitudes, RMS, deg", _last_error(tracked)),
    )
    return table("rendered", ("what", "ours"), rows)


def _count(tracked: Tracked) -> int:
    return len(tracked.tracks.frames[0].features)


def _share(tracked: Tracked) -> float:
    """Of the frames after the first that have an attitude."""
    return float(np.mean(np.isfinite(tracked.angle_deg[1:])))


def _last_error(tracked: Tracked) -> float:
    """RMS of the last attitudes that there are, deg."""
    return root_mean_square(finite(tracked.angle_deg)[-_LAST:])
