"""What stands beside a simulated target, against planes, spheres and shares known otherwise."""

from typing import Any

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.camera import pixel_rays
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.simulation.depth import Scene
from pcnav.simulation.surroundings.view import SceneRenderer, SceneView

BOX = trimesh.creation.box((1.0, 1.5, 2.0))
DIAMETER = float(np.linalg.norm((1.0, 1.5, 2.0)))
TABLES: dict[str, Any] = {
    "seed": 3,
    "scenario": {"frames": 12, "frame_rate_hz": 1.0},
    "orbit": {"r_hill_m": [12.0, 0.3, -0.2]},
    "body": {"omega_body_deg_s": [4.0, -6.0, 5.0], "attitude_rotvec_deg": [20.0, 30.0, 10.0]},
    "camera": {"width_px": 160, "height_px": 120},
    "noise": {"range_sigma_m": 0.01},
}


def scene(**tables: Any) -> Scene:
    found = {name: {**TABLES.get(name, {}), **table} for name, table in tables.items()}
    return Scene.of(Pipeline.model_validate({**TABLES, **found}), BOX)


def views(of: Scene) -> list[SceneView]:
    """The clean images of all frames."""
    renderer = SceneRenderer(of.mesh, of.truth.poses, of.parts, of.pipeline.camera.pinhole)
    return [renderer.render(k) for k in range(len(of))]


def points(view: SceneView, part: int) -> Any:
    """(n, 3) of a part, camera frame."""
    p_cam = pixel_rays(view.seen.camera) * view.seen.depth_m[..., None].astype(np.float64)
    return p_cam[view.part == part]


ALONE = views(scene())


def test_without_tables_there_is_nothing_but_the_target() -> None:
    plain = scene()
    assert plain.parts == ()
    assert all(set(np.unique(view.part)) == {-1, 0} for view in ALONE)


@pytest.mark.parametrize(
    "tables",
    [
        {"background": {"kind": "wall", "tilt_deg": 20.0}},
        {"background": {"kind": "table", "clutter_count": 5}},
        {"occluder": {"kind": "hand"}},
        {"background": {"kind": "wall"}, "occluder": {"kind": "arm", "start_s": 2.0, "end_s": 9.0}},
    ],
)
def test_the_targets_pixels_are_those_of_the_target_alone(tables: dict[str, Any]) -> None:
    """To the bit, clean and with the sensor's noise, where nothing stands before it."""
    with_parts = scene(**tables)
    noisy = list(with_parts.frames())
    plain = list(scene().frames())
    seen = 0
    for k, view in enumerate(views(with_parts)):
        shown, alone = view.shows_target, ALONE[k].shows_target
        assert not (shown & ~alone).any()
        np.testing.assert_array_equal(view.seen.depth_m[shown], ALONE[k].seen.depth_m[shown])
        np.testing.assert_array_equal(noisy[k].depth_m[shown], plain[k].depth_m[shown])
        assert (view.seen.depth_m <= np.where(alone, ALONE[k].seen.depth_m, np.inf)).all()
        seen += int(shown.sum())
    assert seen > 1000


def test_a_wall_is_a_plane_at_its_place_that_fills_the_view() -> None:
    tilt, behind = 25.0, 3.0
    of = scene(background={"kind": "wall", "behind_m": behind, "tilt_deg": tilt})
    normals = []
    for view in views(of):
        assert (view.part >= 0).all()
        p = points(view, 1)
        normal = np.linalg.lstsq(p, np.ones(len(p)), rcond=None)[0]
        np.testing.assert_allclose(p @ normal, 1.0, atol=1e-6)
        normals.append(normal)
    # Fixed in the Hill frame, like the camera.
    np.testing.assert_allclose(normals, np.tile(normals[0], (12, 1)), atol=1e-7)
    cosine = normals[0][2] / np.linalg.norm(normals[0])
    assert np.rad2deg(np.arccos(cosine)) == pytest.approx(tilt, abs=1e-3)
    middle = of.truth.poses[0][:3, 3] + [0.0, 0.0, behind]
    assert middle @ normals[0] == pytest.approx(1.0, abs=1e-6)


def test_a_rough_wall_has_its_roughness() -> None:
    flat = views(scene(background={"kind": "wall"}))[0]
    rough = views(scene(background={"kind": "wall", "roughness_m": 0.05}))[0]
    both = (flat.part == 1) & (rough.part == 1)
    off = (rough.seen.depth_m - flat.seen.depth_m)[both]
    # Interpolated between independent corners: 4/9 of their variance on average.
    assert off.std() == pytest.approx(0.05 * 0.6, rel=0.4)


def test_the_earth_is_a_sphere_with_its_limb_where_geometry_has_it() -> None:
    radius, behind, offset = 40.0, 10.0, 30.0
    of = scene(
        background={
            "kind": "earth",
            "behind_m": behind,
            "earth_radius_m": radius,
            "earth_offset_deg": offset,
        }
    )
    view = views(of)[0]
    p = points(view, 1)
    assert 1000 < len(p) < view.part.size
    altitude = of.truth.poses[0][2, 3] + behind
    # Its middle lies so far off the boresight, in a direction that the points tell.
    A = np.column_stack([2.0 * p, np.ones(len(p))])
    fit = np.linalg.lstsq(A, np.sum(p * p, axis=1), rcond=None)[0]
    assert np.linalg.norm(fit[:3]) == pytest.approx(radius + altitude, rel=2e-3)
    assert np.rad2deg(np.arccos(fit[2] / np.linalg.norm(fit[:3]))) == pytest.approx(offset, abs=0.1)
    np.testing.assert_allclose(np.linalg.norm(p - fit[:3], axis=1), radius, rtol=1e-3)
    # A pixel shows it just when its ray is within the angle of the horizon.
    rays = pixel_rays(view.seen.camera)
    towards = rays @ fit[:3] / np.linalg.norm(fit[:3]) / np.linalg.norm(rays, axis=-1)
    angle, horizon = np.arccos(towards), np.arcsin(radius / (radius + altitude))
    empty = view.part == -1
    assert (angle[view.part == 1] < horizon + 1e-3).all()
    assert (angle[empty] > horizon - 1e-3).all()
    assert empty.any()


def test_the_real_earth_is_out_of_reach_of_the_sensor_and_dark_where_asked_for() -> None:
    far = next(scene(background={"kind": "earth"}).frames())
    plain = next(scene().frames())
    np.testing.assert_array_equal(far.depth_m, plain.depth_m)
    near = {"kind": "earth", "behind_m": 8.0, "earth_radius_m": 50.0}
    whole = next(scene(background=near).frames()).depth_m
    half = next(scene(background={**near, "return_fraction": 0.5}).frames()).depth_m
    background = (whole > 0.0) & (plain.depth_m == 0.0)
    assert (half[background] > 0.0).mean() == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("moves", [True, False])
def test_a_table_touches_the_target_and_moves_with_it_or_not(moves: bool) -> None:
    of = scene(
        background={"kind": "table", "table_up_model": [0.0, -1.0, 0.0], "table_moves": moves},
        # Up in the image is -z of Hill, which is -y of the camera.
        body={"attitude_rotvec_deg": [-60.0, 0.0, 0.0]},
    )
    poses, shown = of.truth.poses, 0
    for k, view in enumerate(views(of)):
        p = points(view, 1)
        T = poses[k] if moves else poses[0]
        height = transform_points(invert_transform(T), p)[:, 1]
        # The box reaches from -0.75 to 0.75 along y: the table is where it ends.
        np.testing.assert_allclose(height, 0.75, atol=1e-5)
        shown += len(p)
    assert shown > 1000


@pytest.mark.parametrize("kind", ["hand", "beam"])
@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
def test_an_occluder_covers_its_share_and_moves_as_it_should(kind: str, share: float) -> None:
    of = scene(occluder={"kind": kind, "share_fraction": share})
    found = views(of)
    alone = ALONE[0].shows_target
    covered = 1.0 - found[0].shows_target.sum() / alone.sum()
    assert covered == pytest.approx(share, abs=0.02)
    (part,) = of.parts
    T = part.T_cam_part
    if kind == "beam":
        assert np.array_equal(T, np.broadcast_to(np.eye(4), T.shape))
    else:
        in_model = np.linalg.inv(of.truth.poses) @ T
        np.testing.assert_allclose(in_model, np.tile(in_model[0], (12, 1, 1)), atol=1e-12)
    # Where it covers the target it is nearer.
    hidden = alone & (found[0].part == 1)
    assert (found[0].seen.depth_m[hidden] < ALONE[0].seen.depth_m[hidden]).all()


def test_a_hand_that_does_not_turn_stays_before_the_target() -> None:
    of = scene(occluder={"kind": "hand", "turns": False})
    for k, view in enumerate(views(of)):
        assert 0.1 < 1.0 - view.shows_target.sum() / ALONE[k].shows_target.sum() < 0.8


def test_a_share_that_cannot_be_covered_is_refused() -> None:
    with pytest.raises(InputError, match=r"occluder.share_fraction.*at most"):
        scene(occluder={"kind": "beam", "share_fraction": 0.9, "radius_m": 0.01})


def test_the_arm_crosses_the_target_between_its_times() -> None:
    of = scene(occluder={"kind": "arm", "start_s": 2.5, "end_s": 8.5})
    there = [bool((view.part == 1).any()) for view in views(of)]
    seen = zip(views(of), ALONE, strict=True)
    covered = [bool((view.shows_target != alone.shows_target).any()) for view, alone in seen]
    assert not any(there[:3]) and not any(there[9:])
    assert any(covered[4:8])


def test_things_about_do_not_touch_the_target() -> None:
    for kind in ("wall", "table", "none"):
        of = scene(background={"kind": kind, "clutter_count": 12})
        clutter = of.parts[-1]
        T = invert_transform(of.truth.poses[0]) @ clutter.T_cam_part[0]
        p_model = transform_points(T, np.asarray(clutter.mesh.vertices))
        outside = np.abs(p_model) - [0.5, 0.75, 1.0]
        assert outside.max(axis=1).min() > 0.0
        assert len(clutter.mesh.split(only_watertight=False)) == 12
