"""The size of a target that is not that of its mesh, told from single frames at a known pose."""

import numpy as np
import pytest
import trimesh

from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.mesh_scale import ScaleBelief
from pcnav.perception.render_compare import RenderComparer
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

SIGMA_M = 0.01
CAMERA = PinholeCamera.from_field_of_view(128, 128, np.deg2rad(25.0))
EXACT_SD = np.zeros(6)
SPREAD = np.diag(np.repeat([0.05, 0.01], 3) ** 2)


def belief_after(target: Target, factor: float, frames: int, sd: float = 0.01) -> ScaleBelief:
    """Of frames that show the mesh enlarged by a factor, compared with the mesh itself at poses
    all about it."""
    shown: trimesh.Trimesh = target.mesh.copy()
    shown.apply_scale(factor)
    renderer, rng = DepthRenderer(shown, CAMERA), np.random.default_rng(3)
    comparer = RenderComparer(target, CAMERA, SIGMA_M)
    belief = ScaleBelief(sd)
    for _ in range(frames):
        pose = make_transform(exp_rotation(rng.standard_normal(3)), np.array([0.0, 0.0, 24.0]))
        depth = renderer.render(pose).depth_m
        noisy = depth + SIGMA_M * rng.standard_normal(depth.shape)
        depth = np.where(depth > 0.0, noisy, 0.0).astype(np.float32)
        seen = comparer.compare(depth, pose, SPREAD).seen
        belief = belief.with_frame(seen, list(seen.ranges), 0.5 * target.diameter_m)
    return belief


@pytest.mark.parametrize("factor", [0.99, 1.01, 1.02])
def test_frames_tell_how_much_larger_the_target_is(boxsat: Target, factor: float) -> None:
    assert belief_after(boxsat, factor, 10).factor(EXACT_SD) == pytest.approx(factor, abs=1.5e-3)


def test_a_mesh_that_is_right_stays_as_it_is(boxsat: Target) -> None:
    assert belief_after(boxsat, 1.0, 10).factor(EXACT_SD) == 1.0


def test_few_frames_and_a_mesh_taken_for_right_change_nothing(boxsat: Target) -> None:
    assert belief_after(boxsat, 1.02, 4).factor(EXACT_SD) == 1.0
    assert belief_after(boxsat, 1.02, 8, sd=0.0).factor(EXACT_SD) == 1.0


def test_a_target_is_enlarged_about_the_origin_of_its_model(boxsat: Target) -> None:
    larger = boxsat.scaled(1.1)
    np.testing.assert_allclose(larger.mesh.bounds, 1.1 * boxsat.mesh.bounds)
    assert larger.mesh.volume == pytest.approx(1.1**3 * boxsat.mesh.volume)
    for one, other in zip(larger.rectangles, boxsat.rectangles, strict=True):
        assert one.area_m2 == pytest.approx(1.1**2 * other.area_m2)
        np.testing.assert_allclose(one.T_model_rect[:3, 3], 1.1 * other.T_model_rect[:3, 3])
    np.testing.assert_allclose(larger.com_model, 1.1 * boxsat.com_model)


def test_ranges_and_focal_length_may_be_off_as_a_mesh_is(boxsat: Target) -> None:
    belief = belief_after(boxsat, 1.01, 10)
    both_sd = np.array([0.01, 0.0, 0.0, 0.0, 0.01, 0.0])
    assert belief.factor(both_sd) == 1.0
    assert belief.factor(0.1 * both_sd) == pytest.approx(1.01, abs=1.5e-3)
    assert belief.sd_left(both_sd) > 4.0 * belief.sd_left(EXACT_SD)
