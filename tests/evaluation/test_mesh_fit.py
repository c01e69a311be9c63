"""Parts of a target that are not as in its mesh, told from returns of meshes changed by hand."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform
from pcnav.evaluation.mesh_fit import mesh_fit_csv, sentences
from pcnav.perception.part_fit import MeshFit, PartFit, PartVerdict
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.recordings.sequence import Frame
from pcnav.simulation.depth import Scene
from pcnav.target.parts import has_several_bodies
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target, load_target

CAMERA = PinholeCamera(96, 96, 160.0, 160.0, 47.5, 47.5)
SIGMA_M = 0.01
BUS, PANEL = (1.6, 1.8, 2.2), (0.04, 3.0, 1.4)
PANEL_CENTRE = np.array([0.3, 2.6, 0.2])
HINGE_AXIS = np.array([0.0, 1.0, 0.0])


def box(size: tuple[float, float, float], centre: np.ndarray) -> trimesh.Trimesh:
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(centre))


def satellite(turn_deg: float | None) -> trimesh.Trimesh:
    """A bus and its panel, turned about its long axis; none where the turn is None."""
    bus = box(BUS, np.zeros(3))
    if turn_deg is None:
        return bus
    panel = box(PANEL, PANEL_CENTRE)
    about = trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), HINGE_AXIS, PANEL_CENTRE)
    mesh = trimesh.util.concatenate([bus, panel.apply_transform(about)])
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Target:
    path: Path = tmp_path_factory.mktemp("mesh") / "satellite.obj"
    satellite(0.0).export(path)
    return load_target(path)


def fitted(
    target: Target, shown: trimesh.Trimesh, frames: int = 8, mesh_scale: float = 1.0
) -> dict[str, PartFit]:
    """Parts by name after frames of a mesh that is shown, at poses all about it."""
    rng = np.random.default_rng(2)
    renderer, fit = DepthRenderer(shown, CAMERA), MeshFit(target)
    for index, R in enumerate(Rotation.random(frames, random_state=5).as_matrix()):
        pose = make_transform(R, np.array([0.0, 0.0, 14.0]))
        depth = renderer.render(pose).depth_m
        depth = np.where(depth > 0.0, depth + SIGMA_M * rng.standard_normal(depth.shape), 0.0)
        frame = Frame(index, float(index), depth.astype(np.float32), CAMERA, np.eye(4))
        fit.add(frame, pose, SensorNoise(SIGMA_M), mesh_scale)
    bus, panel = fit.parts()
    return {"bus": bus, "panel": panel}


def test_the_shipped_satellite_is_as_in_its_mesh(boxsat: Target) -> None:
    """Its ring is seen at grazing angles, more of its wall than of its face."""
    path = shipped_pipeline("demo")
    assert path is not None
    scene, fit = Scene.of(read_pipeline(path), boxsat.mesh), MeshFit(boxsat)
    noise = SensorNoise(scene.pipeline.noise.range_sigma_m)
    for frame, pose in zip(scene.frames(), scene.truth.poses, strict=True):
        fit.add(frame, pose, noise)
    parts = {part.name: part for part in fit.parts()}
    assert parts["bus_z_plus"].pixels > 1000
    assert sentences(tuple(parts.values())) == ()


def test_a_target_as_in_its_mesh_fits(target: Target) -> None:
    parts = fitted(target, satellite(0.0))
    assert {part.verdict for part in parts.values()} == {PartVerdict.FITS}
    assert sentences(tuple(parts.values())) == ()


@pytest.mark.parametrize("turn_deg", [3.0, 10.0, 30.0])
def test_a_turned_panel_is_named_with_its_angle_and_axis(target: Target, turn_deg: float) -> None:
    parts = fitted(target, satellite(turn_deg))
    panel = parts["panel"]
    assert parts["bus"].verdict is PartVerdict.FITS
    assert panel.verdict is PartVerdict.TURNED
    assert panel.turn_deg == pytest.approx(turn_deg, abs=0.4)
    assert panel.axis_model is not None
    assert abs(float(np.array(panel.axis_model) @ HINGE_AXIS)) > np.cos(np.deg2rad(5.0))
    (said,) = sentences(tuple(parts.values()))
    assert panel.name in said and f"{panel.turn_deg:.1f} deg" in said


def test_a_target_of_another_size_is_judged_at_that_size(target: Target) -> None:
    larger = satellite(10.0)
    larger.apply_scale(1.03)
    parts = fitted(target, larger, mesh_scale=1.03)
    assert parts["bus"].verdict is PartVerdict.FITS
    assert parts["panel"].turn_deg == pytest.approx(10.0, abs=0.4)
    # At the mesh's own size most of it seems to be hidden by what is nearer.
    assert fitted(target, larger)["bus"].pixels < 0.5 * parts["bus"].pixels


def test_a_missing_panel_is_named(target: Target) -> None:
    parts = fitted(target, satellite(None))
    assert parts["bus"].verdict is PartVerdict.FITS
    assert parts["panel"].verdict is PartVerdict.MISSING


def test_bodies_that_touch_nowhere_are_several() -> None:
    assert has_several_bodies(satellite(0.0))
    assert not has_several_bodies(satellite(None))
    small = box((0.1, 0.1, 0.1), np.array([0.0, 0.0, 1.3]))
    both = trimesh.util.concatenate([satellite(None), small])
    assert isinstance(both, trimesh.Trimesh) and not has_several_bodies(both)


def test_nothing_is_said_of_what_is_hardly_seen(target: Target) -> None:
    parts = fitted(target, satellite(0.0), frames=2)
    assert {part.verdict for part in parts.values()} == {PartVerdict.HARDLY_SEEN}


def test_a_row_of_the_table_is_a_part(target: Target) -> None:
    lines = mesh_fit_csv(tuple(fitted(target, satellite(10.0)).values())).splitlines()
    header = lines[0].split(",")
    rows = [dict(zip(header, line.split(","), strict=True)) for line in lines[1:]]
    assert [row["verdict"] for row in rows] == ["fits", "turned"]
    assert float(rows[1]["turn_deg"]) == pytest.approx(10.0, abs=0.4)
