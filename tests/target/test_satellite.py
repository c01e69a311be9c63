"""Loading targets: file formats, sidecars, errors, mass properties and the shipped satellites."""

import importlib.util
import io
import logging
import tomllib

import numpy as np
import pytest
import trimesh
from rich.console import Console
from scipy.spatial import cKDTree

from pcnav.core.errors import InputError
from pcnav.core.spatial import transform_points
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia
from pcnav.target.satellite import describe, load_target, write_target_toml
from pcnav.target.unknown_density import unknown_density

SATELLITES = {"boxsat": "C1", "twinwing": "C2 about z", "cubesat6u": "C2 about x"}
QUADS = [(1, 4, 3, 2), (5, 6, 7, 8), (1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8)]
CORNERS = [(x, y, z) for z in (0, 3) for x, y in ((0, 0), (1, 0), (1, 2), (0, 2))]


@pytest.fixture
def box_file(tmp_path):
    path = tmp_path / "box.stl"
    trimesh.creation.box(extents=(1, 2, 3)).export(path)
    return path


@pytest.fixture(scope="module")
def build(repository):
    spec = importlib.util.spec_from_file_location("build", repository / "meshes" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module", params=sorted(SATELLITES))
def shipped(request, repository):
    return load_target(repository / "meshes" / f"{request.param}.obj")


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "glb", "STL"])
def test_formats_give_the_same_target(tmp_path, suffix):
    mesh = trimesh.creation.box(extents=(1, 2, 3))
    mesh.apply_translation([4, 5, 6])
    path = tmp_path / f"box.{suffix}"
    content = mesh.export(file_type=suffix.lower())
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    target = load_target(path)
    assert target.name == "box"
    assert target.mesh.vertices.shape == (8, 3)
    assert np.allclose(target.mesh.bounds, mesh.bounds)
    assert [r.length_m for r in target.rectangles] == pytest.approx([3, 3, 3, 3, 2, 2])
    assert target.symmetry_name == "D2"


def test_scene_is_joined_where_its_nodes_put_it(tmp_path):
    scene = trimesh.Scene()
    cube = trimesh.creation.box(extents=(1, 1, 1))
    for x in (0.0, 3.0):
        pose = trimesh.transformations.translation_matrix([x, 0, 0])
        scene.add_geometry(cube, transform=pose)
    scene.export(tmp_path / "two.glb")
    target = load_target(tmp_path / "two.glb")
    assert np.allclose(target.mesh.bounds, [[-0.5, -0.5, -0.5], [3.5, 0.5, 0.5]])
    assert len(target.rectangles) == 12


def test_obj_of_polygons_without_its_materials_is_quiet(tmp_path, caplog, capfd):
    lines = ["mtllib absent.mtl", "o thing"]
    lines += [f"v {x} {y} {z}" for x, y, z in CORNERS]
    lines += ["usemtl white"] + ["f " + " ".join(map(str, quad)) for quad in QUADS[:3]]
    lines += ["usemtl blue"] + ["f " + " ".join(map(str, quad)) for quad in QUADS[3:]]
    path = tmp_path / "box.obj"
    path.write_text("\n".join(lines))
    with caplog.at_level(logging.WARNING):
        target = load_target(path)
    assert len(target.rectangles) == 6
    assert target.mesh.is_watertight
    assert not caplog.records
    assert capfd.readouterr() == ("", "")


BAD_FILES = {
    "garbage.stl": (b"hello\n", "faces"),
    "garbage.ply": (b"hello\n", "file"),
    "garbage.glb": (b"hello\n", "file"),
    "empty.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "faces"),
    "unknown.xyzq": (b"hello\n", "file"),
    "nan.obj": (b"v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n", "vertices"),
    "huge.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1e300 0\nf 1 2 3\n", "vertices"),
    "flat.obj": (b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "faces"),
    "points.ply": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nend_header\n0 0 0\n",
        "faces",
    ),
}


@pytest.mark.parametrize("name", sorted(BAD_FILES))
def test_bad_mesh_is_one_clear_line(tmp_path, name):
    content, field = BAD_FILES[name]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as caught:
        load_target(tmp_path / name)
    assert caught.value.field == field
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mesh_without_rectangles_has_an_empty_catalogue(tmp_path):
    body = trimesh.creation.icosphere(subdivisions=2)
    body.apply_scale([1.0, 1.4, 2.0])
    body.export(tmp_path / "ellipsoid.stl")
    target = load_target(tmp_path / "ellipsoid.stl")
    assert target.rectangles == ()
    # Turned half about any of its axes, it lies on itself.
    tree = cKDTree(np.asarray(trimesh.sample.sample_surface(target.mesh, 20_000, seed=0)[0]))
    for motion in target.half_turns:
        moved = transform_points(motion, np.asarray(target.mesh.vertices))
        assert float(np.max(tree.query(moved)[0])) < 0.05


def test_missing_mesh(tmp_path):
    with pytest.raises(InputError, match="found none"):
        load_target(tmp_path / "absent.stl")


BAD_SIDECARS = {
    "unknown key": ("colour = 'red'", "colour"),
    "unknown mass key": ("[mass]\nkg = 3.0", "mass.kg"),
    "short vector": ("[mass]\ncom_model_m = [0.0, 1.0]", "mass.com_model_m"),
    "outside": ("[mass]\ncom_model_m = [0.0, 0.0, 9.0]", "mass.com_model_m"),
    "no spread": ("[mass]\ncom_sd_m = 0.0", "mass.com_sd_m"),
    "unphysical": ("[mass]\ninertia_ratios = [1.0, 3.0, 0, 0, 0]", "mass.inertia_ratios"),
    "not TOML": ("name = ", "file"),
    "elsewhere": (
        "[[rectangles.names]]\nname='a'\ncentroid_model_m=[0,0,0]\nnormal_model=[1,0,0]",
        "rectangles.names.0 (a)",
    ),
    "facing the other way": (
        "[[rectangles.names]]\nname='a'\ncentroid_model_m=[0.5,0,0]\nnormal_model=[-1,0,0]",
        "rectangles.names.0 (a)",
    ),
    "twice": (
        "[[rectangles.names]]\nname='a'\ncentroid_model_m=[0.5,0,0]\nnormal_model=[1,0,0]\n"
        "[[rectangles.names]]\nname='b'\ncentroid_model_m=[0.5,0,0]\nnormal_model=[1,0,0]",
        "rectangles.names.1 (b)",
    ),
}


@pytest.mark.parametrize("fault", sorted(BAD_SIDECARS))
def test_bad_sidecar_is_one_clear_line(box_file, fault):
    text, field = BAD_SIDECARS[fault]
    sidecar = box_file.with_suffix(".toml")
    sidecar.write_text(text)
    with pytest.raises(InputError) as caught:
        load_target(box_file)
    assert caught.value.file == sidecar
    assert caught.value.field.startswith(field)
    assert "\n" not in str(caught.value)


def test_defaults_without_a_sidecar(box_file):
    target = load_target(box_file)
    found = unknown_density(target.mesh)
    assert np.array_equal(target.com_model, found.com_model)
    assert np.array_equal(target.mass.parameter_covariance, found.parameter_covariance)
    # A box of 1 x 2 x 3 m about the origin.
    assert np.all(np.abs(target.com_model) < [0.03, 0.05, 0.08])
    com_sd, _ = target.mass.prior.sd
    assert np.all(com_sd > [0.1, 0.2, 0.3]) and np.all(com_sd < [0.2, 0.4, 0.6])


def test_written_sidecar_reads_back(box_file):
    box_file.with_suffix(".toml").write_text(
        "name = 'crate \"7\" \u00e9'\n[mass]\ncom_model_m = [0.1, -0.2, 0.3]\ncom_sd_m = 0.07\n"
        "inertia_ratios = [0.8, 0.4, 0.01, -0.02, 0.03]\ninertia_ratio_sd = 0.11\n"
        "[[rectangles.names]]\nname = 'lid'\n"
        "centroid_model_m = [0.0, 0.01, 1.5]\nnormal_model = [0.0, 0.02, 1.0]\n",
        encoding="utf-8",
    )
    first = load_target(box_file)
    assert first.name == 'crate "7" \u00e9'
    assert np.allclose(first.com_model, [0.1, -0.2, 0.3])
    assert np.allclose(first.mass.com_covariance_m2, 0.07**2 * np.eye(3))
    assert np.allclose(first.mass.prior.ratio_covariance, 0.11**2 * np.eye(5), atol=1e-12)
    (lid,) = [r for r in first.rectangles if r.name == "lid"]
    assert np.allclose(lid.T_model_rect[:3, 3], [0, 0, 1.5])
    write_target_toml(first, box_file.with_suffix(".toml"))
    second = load_target(box_file)
    assert second.name == first.name
    assert [r.name for r in second.rectangles] == [r.name for r in first.rectangles]
    for field in ("com_model", "com_covariance_m2", "inertia_ratios", "parameter_covariance"):
        assert np.array_equal(getattr(second.mass, field), getattr(first.mass, field))
    # Nothing is left over from the temporary name.
    assert sorted(p.name for p in box_file.parent.iterdir()) == ["box.stl", "box.toml"]


def test_sidecar_of_a_shipped_satellite_reads_back(shipped, tmp_path):
    copy = tmp_path / shipped.mesh_path.name
    copy.write_bytes(shipped.mesh_path.read_bytes())
    write_target_toml(shipped, copy.with_suffix(".toml"))
    again = load_target(copy)
    assert again.name == shipped.name
    assert [r.name for r in again.rectangles] == [r.name for r in shipped.rectangles]
    assert np.array_equal(again.inertia_ratios, shipped.inertia_ratios)


def test_sidecar_into_a_missing_folder(box_file, tmp_path):
    with pytest.raises(InputError, match="writable"):
        write_target_toml(load_target(box_file), tmp_path / "absent" / "box.toml")


def test_shipped_satellite(shipped):
    assert shipped.symmetry_name == SATELLITES[shipped.name]
    # Every rectangle has a human name, and the mass properties are those of a real body.
    assert not [r.name for r in shipped.rectangles if r.name.startswith("rectangle")]
    assert is_physical_inertia(inertia_from_ratios(shipped.inertia_ratios))
    com_sd, ratios_sd = shipped.mass.prior.sd
    assert 0.001 < np.linalg.norm(shipped.com_model) < 3 * com_sd.min()
    # Nobody states how far the real one is from its plans: any body is thought of.
    assert np.all(ratios_sd[:2] > 0.2) and shipped.stated_mass.inertia_ratio_sd is None
    assert shipped.mesh.is_watertight
    # Rays from outside agree with where the catalogue puts the middle of each panel.
    for rectangle in shipped.rectangles:
        if "panel" in rectangle.name or "wing" in rectangle.name:
            centroid, normal = rectangle.T_model_rect[:3, 3], rectangle.T_model_rect[:3, 2]
            hit, _, _ = shipped.mesh.ray.intersects_location(
                [centroid + 0.5 * rectangle.width_m * normal], [-normal], multiple_hits=False
            )
            assert np.allclose(hit, centroid, atol=1e-5)


def test_boxsat_is_as_described(repository):
    target = load_target(repository / "meshes" / "boxsat.obj")
    assert np.linalg.norm(target.mesh.vertices, axis=1).max() < 5.4
    found = {r.name: (r.length_m, r.width_m) for r in target.rectangles}
    for name, size in {
        "panel_long_front": (4.0, 1.5),
        "panel_short_back": (3.0, 1.2),
        "bus_x_plus": (2.2, 1.8),
        "bus_y_minus": (2.2, 1.6),
        "bus_z_plus": (1.8, 1.6),
        "antenna_front": (0.8, 0.8),
    }.items():
        assert found[name] == pytest.approx(size, rel=1e-6)
    assert len(found) == 12
    # No half turn about an axis of a panel maps the bus onto itself within 0.3 m.
    bus = np.array([[x, y, z] for x in (-0.8, 0.8) for y in (-0.9, 0.9) for z in (-1.1, 1.1)])
    signs = ((1, -1, -1), (-1, 1, -1), (-1, -1, 1))
    half_turns = np.array([np.diag([*sign, 1.0]) for sign in signs])
    for rectangle in target.rectangles:
        if rectangle.name.startswith("panel"):
            T = rectangle.T_model_rect @ half_turns @ np.linalg.inv(rectangle.T_model_rect)
            for turn in T:
                gap = np.linalg.norm(transform_points(turn, bus)[:, None] - bus, axis=-1)
                assert gap.min(axis=1).max() > 0.3


def test_shipped_files_are_what_the_build_script_builds(build, repository, tmp_path):
    build.build(tmp_path)
    for name in SATELLITES:
        built, kept = tmp_path / f"{name}.obj", repository / "meshes" / f"{name}.obj"
        assert built.read_text() == kept.read_text()
        built, kept = built.with_suffix(".toml"), kept.with_suffix(".toml")
        assert tomllib.loads(built.read_text()) == tomllib.loads(kept.read_text())


def test_mass_properties_of_the_build_are_those_of_a_point_cloud(build):
    satellite = build.boxsat()
    com, inertia = build.mass_properties(satellite)
    rng = np.random.default_rng(8)
    points, weights = [], []
    for part in satellite.parts:
        inside = trimesh.sample.volume_mesh(part.mesh, 4000)
        points.append(inside)
        weights.append(np.full(len(inside), part.mass_kg / len(inside)))
    for ball in satellite.equipment:
        direction = rng.normal(size=(20_000, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        radius = ball.radius_m * np.cbrt(rng.random((20_000, 1)))
        points.append(ball.centre_m + radius * direction)
        weights.append(np.full(20_000, ball.mass_kg / 20_000))
    cloud, weight = np.vstack(points), np.concatenate(weights)
    mean = weight @ cloud / weight.sum()
    second = np.einsum("n,ni,nj->ij", weight, cloud - mean, cloud - mean)
    assert np.allclose(com, mean, atol=0.02)
    assert np.allclose(inertia, np.trace(second) * np.eye(3) - second, atol=0.03 * inertia[0, 0])


def test_mesh_without_a_true_rectangle_uses_equivalent_ones(shared_data):
    # Its panels are rectangles of 5.5 x 2 m, each with a triangle of 1 m towards the bus.
    target = load_target(shared_data / "meshes" / "ARC_Target.obj")
    assert target.symmetry_name == "C2 about z"
    assert [r.name for r in target.rectangles] == [f"equivalent_{k}" for k in range(1, 5)]
    # Centroid and second moment of rectangle and triangle, by the parallel axis theorem.
    centroid = (11 * 4.75 + 1 * 5 / 3) / 12
    along = (11 * (5.5**2 / 12 + (4.75 - centroid) ** 2) + 1 / 18 + (5 / 3 - centroid) ** 2) / 12
    across = (11 * 4 / 12 + 4 / 24) / 12
    for rectangle in target.rectangles:
        assert rectangle.length_m == pytest.approx(np.sqrt(12 * along), rel=1e-5)
        assert rectangle.width_m == pytest.approx(np.sqrt(12 * across), rel=1e-5)
        assert abs(rectangle.T_model_rect[1, 3]) == pytest.approx(centroid, rel=1e-5)


def test_description_names_every_rectangle(shipped):
    with io.StringIO() as file:
        Console(width=200, file=file).print(*describe(shipped))
        text = file.getvalue()
    assert SATELLITES[shipped.name] in text
    for rectangle in shipped.rectangles:
        assert rectangle.name in text
