"""Candidate regions of made frames, against the pixels that the target was rendered to."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.spatial import make_transform
from pcnav.perception.regions import Region, RegionSearch, candidate_regions
from pcnav.recordings.sequence import Frame
from pcnav.target.flatness import flat_extent
from pcnav.target.rendering import RenderedDepth
from pcnav.target.satellite import Target

Shoot = Callable[..., tuple[Frame, RenderedDepth]]
SIGMA = 0.01


def with_behind(frame: Frame, depth_m: FloatArray, seed: int = 1) -> Frame:
    """The frame with a surface at depths (height, width) wherever nothing nearer returned."""
    noise = np.random.default_rng(seed).normal(0.0, SIGMA, depth_m.shape)
    behind = np.where(np.isfinite(depth_m), depth_m + noise, np.inf)
    seen = np.where(frame.depth_m > 0.0, frame.depth_m, np.inf)
    nearest = np.minimum(seen, behind)
    return replace(frame, depth_m=np.where(np.isfinite(nearest), nearest, 0.0).astype(np.float32))


def table_below(camera: PinholeCamera, height_m: float, far_m: float) -> FloatArray:
    """(height, width) depth of a level table so far below the optical axis, as far as it goes."""
    y = pixel_rays(camera)[..., 1]
    depth = np.where(y > 0.0, height_m / np.where(y > 0.0, y, 1.0), np.inf)
    return np.where(depth < far_m, depth, np.inf)


def iou(region: Region, shown: BoolArray) -> float:
    """Intersection over union of a region with pixels (height, width)."""
    mask = region.frame.depth_m > 0.0
    return float((mask & shown).sum() / (mask | shown).sum())


def overlap(search: RegionSearch, shown: BoolArray) -> float:
    """The largest of any region."""
    return max((iou(region, shown) for region in search.regions), default=0.0)


def test_a_frame_of_the_target_alone_is_one_region_itself(
    boxsat: Target, shoot: Shoot, random_pose: Callable[..., FloatArray]
) -> None:
    rng = np.random.default_rng(0)
    for seed in range(6):
        frame, _ = shoot(boxsat.mesh, random_pose(rng, 30.0, 35.0), SIGMA, seed)
        search = candidate_regions(frame, boxsat, SIGMA)
        (region,) = search.regions
        assert region.frame is frame
        assert region.is_whole
        assert region.n_returns == np.count_nonzero(frame.depth_m)


def test_the_target_before_a_wall_is_a_region(
    boxsat: Target, camera: PinholeCamera, shoot: Shoot, random_pose: Callable[..., FloatArray]
) -> None:
    rng = np.random.default_rng(1)
    for seed in range(4):
        frame, clean = shoot(boxsat.mesh, random_pose(rng), SIGMA, seed)
        wall = 32.0 + 6.0 * pixel_rays(camera)[..., 0]
        among = with_behind(frame, wall)
        search = candidate_regions(among, boxsat, SIGMA)
        assert overlap(search, clean.depth_m > 0.0) > 0.9
        assert not any(region.is_whole for region in search.regions)
        assert search.n_planes >= 1
        # What is behind is space to the region, not something that hides.
        own = max(search.regions, key=lambda region: iou(region, clean.depth_m > 0.0))
        assert own.frame.unseen is not None
        assert np.mean(own.frame.unseen) < 0.02


def test_a_box_that_stands_on_a_table_before_a_wall_is_a_region_of_its_own(
    camera: PinholeCamera, shoot: Shoot, boxsat: Target
) -> None:
    size = np.array([1.6, 2.2, 1.8])
    box = replace(boxsat, mesh=trimesh.creation.box(size), symmetry_transforms=np.eye(4)[None])
    for turn in (0.3, 0.8, 1.3):
        # The camera looks down a little; the table lies level under the box.
        c, s = np.cos(turn), np.sin(turn)
        upright = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        tilt = 0.35
        ct, st = np.cos(tilt), np.sin(tilt)
        R_cam_level = np.array([[1.0, 0.0, 0.0], [0.0, ct, -st], [0.0, st, ct]])
        T = make_transform(R_cam_level @ upright, np.array([0.1, 0.0, 12.0]))
        frame, clean = shoot(box.mesh, T, SIGMA)
        down = R_cam_level[:, 1]
        offset = down @ (T[:3, 3]) + 0.5 * size[1]
        across = pixel_rays(camera) @ down
        table = np.where(across > 0.0, offset / np.where(across > 0.0, across, 1.0), np.inf)
        wall = np.full(table.shape, 18.0)
        among = with_behind(frame, np.minimum(table, wall))
        search = candidate_regions(among, box, SIGMA)
        assert overlap(search, clean.depth_m > 0.0) > 0.8


def test_false_returns_all_over_the_image_leave_the_target_one_region(
    boxsat: Target, shoot: Shoot, random_pose: Callable[..., FloatArray]
) -> None:
    rng = np.random.default_rng(2)
    frame, clean = shoot(boxsat.mesh, random_pose(rng), SIGMA)
    for share in (0.05, 0.2):
        false = rng.random(frame.depth_m.shape) < share
        depth = np.where(false, rng.uniform(5.0, 60.0, false.shape), frame.depth_m)
        spoilt = replace(frame, depth_m=depth.astype(np.float32))
        search = candidate_regions(spoilt, boxsat, SIGMA)
        shown = (clean.depth_m > 0.0) & ~false
        assert overlap(search, shown) > 0.7


def test_an_arm_before_the_target_is_another_region_though_both_span_no_more_than_it(
    boxsat: Target, shoot: Shoot
) -> None:
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 40.0]))
    frame, clean = shoot(boxsat.mesh, T, SIGMA)
    depth = frame.depth_m.copy()
    rows, columns = np.nonzero(depth > 0.0)
    middle = int(np.median(columns))
    arm = np.zeros_like(depth, dtype=np.bool_)
    arm[: int(np.median(rows)), middle - 6 : middle + 6] = True
    depth[arm] = 36.0
    search = candidate_regions(replace(frame, depth_m=depth), boxsat, SIGMA)
    assert search.is_small
    assert not any(region.is_whole for region in search.regions)
    # Nor can it be ruled out that all of it is the target's.
    assert search.regions[0].frame.depth_m is depth
    assert overlap(search, (clean.depth_m > 0.0) & ~arm) > 0.9


def test_an_empty_frame_has_no_regions(boxsat: Target, camera: PinholeCamera) -> None:
    frame = Frame(0, 0.0, np.zeros((256, 256), dtype=np.float32), camera, np.eye(4))
    search = candidate_regions(frame, boxsat, SIGMA)
    assert search.regions == ()
    assert search.span_m == 0.0


def test_flat_extents() -> None:
    box = trimesh.creation.box([1.0, 2.0, 3.0])
    assert flat_extent(box) == pytest.approx(np.hypot(2.0, 3.0), rel=1e-6)
    # A plane that is fitted between two plates lies within 2 % of the diameter of both.
    low, high = trimesh.creation.box([1.0, 1.0, 0.01]), trimesh.creation.box([1.0, 1.0, 0.01])
    high.apply_translation([1.0, 0.0, 0.07])
    both = trimesh.util.concatenate(low, high)
    assert isinstance(both, trimesh.Trimesh)
    assert flat_extent(both) == pytest.approx(2.2, abs=0.1)
    # A sphere of radius 1 lies within 4 % of its bounding box's diagonal of a plane over a cap.
    cap = 2.0 * np.sqrt(2.0 * 0.04 * np.sqrt(12.0))
    assert 0.4 * cap < flat_extent(trimesh.creation.icosphere(4)) < 1.1 * cap


def test_a_frame_of_nothing_but_a_wall_holds_no_region(boxsat: Target, shoot: Shoot) -> None:
    # Without noise all of it is on the plane that is taken out: nothing is left to have parts.
    frame, _ = shoot(boxsat.mesh, make_transform(np.eye(3), np.array([0.0, 0.0, 25.0])), SIGMA, 0)
    wall = replace(frame, depth_m=np.full(frame.depth_m.shape, 40.0, dtype=np.float32))
    search = candidate_regions(wall, boxsat, SIGMA)
    assert search.regions == ()
    assert search.n_planes == 1
