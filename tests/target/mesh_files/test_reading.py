"""Mesh files as public libraries write them, against the mesh they were made of."""

import io
import json
import struct
import zipfile
from typing import Any

import numpy as np
import pytest
import trimesh

from pcnav.config.length_unit import LengthUnit
from pcnav.core.errors import InputError
from pcnav.target.mesh_files.reading import read_mesh, read_mesh_file
from tests.target.mesh_files.satellites import as_file, clean_parts, joined

FORMATS: dict[str, dict[str, Any]] = {
    "binary.stl": {},
    "text.stl": {"file_type": "stl_ascii"},
    "binary.ply": {},
    "text.ply": {"encoding": "ascii"},
    "mesh.obj": {},
    "one.glb": {},
    "several.gltf": {},
    "mesh.off": {},
    "mesh.dae": {},
    "draco.glb": {"extension_draco": True},
}


@pytest.fixture
def clean():
    return joined(clean_parts())


def agrees(mesh, clean, tolerance=1e-5):
    """Whether a mesh has bounds, area and volume of another."""
    scale = np.linalg.norm(np.ptp(clean.bounds, axis=0))
    assert np.allclose(mesh.bounds, clean.bounds, atol=tolerance * scale)
    assert mesh.area == pytest.approx(clean.area, rel=tolerance)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(clean.volume, rel=10 * tolerance)


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_mesh(tmp_path, clean, name):
    options = dict(FORMATS[name])
    if "extension_draco" in options:
        pytest.importorskip("DracoPy", reason="the extra `formats` is not installed")
    kind = options.pop("file_type", None)
    if kind is None:
        path = as_file(tmp_path, name, clean, **options)
    else:
        path = tmp_path / name
        path.write_text(clean.export(file_type=kind))
    # Draco keeps 14 bits of a coordinate.
    agrees(read_mesh(path), clean, 2e-4 if "draco" in name else 1e-5)


@pytest.mark.parametrize(
    ("unit", "metres"), [("millimeter", 1e-3), ("inch", 0.0254), ("foot", 0.3048)]
)
def test_units_of_3mf_are_read(tmp_path, clean, unit, metres):
    path = tmp_path / "mesh.3mf"
    clean.apply_scale(1.0 / metres)
    with zipfile.ZipFile(io.BytesIO(trimesh.Scene(clean).export(file_type="3mf"))) as written:
        files = {name: written.read(name) for name in written.namelist()}
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in files.items():
            model = content.replace(b'unit="millimeter"', f'unit="{unit}"'.encode())
            archive.writestr(name, model)
    found = read_mesh_file(path)
    assert found.origin.unit_from == "declared"
    clean.apply_scale(metres)
    agrees(found.mesh, clean)


def test_units_of_dae_are_read(tmp_path, clean):
    path = as_file(tmp_path, "mesh.dae", clean)
    text = path.read_text()
    assert "<asset>" in text
    unit = '<unit name="inch" meter="0.0254"/>'
    for old in ('<unit name="meter" meter="1.0"/>', '<unit name="meter" meter="1"/>'):
        text = text.replace(old, "")
    path.write_text(text.replace("</asset>", f"{unit}</asset>"))
    found = read_mesh_file(path)
    assert found.origin.metres_per_unit == pytest.approx(0.0254)
    clean.apply_scale(0.0254)
    agrees(found.mesh, clean)


def test_a_stated_unit_goes_before_a_declared_one(tmp_path, clean):
    path = as_file(tmp_path, "mesh.glb", clean)
    assert read_mesh_file(path).origin.unit_from == "declared"
    found = read_mesh_file(path, LengthUnit.CENTIMETRE)
    assert found.origin.unit_from == "stated"
    clean.apply_scale(0.01)
    agrees(found.mesh, clean)


def test_instances_stand_where_the_scene_puts_them_also_mirrored(tmp_path):
    scene, half = trimesh.Scene(), trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    half.apply_translation([1.0, 0.0, 0.5])
    mirrored = np.diag([-1.0, 1.0, 1.0, 1.0])
    turned = trimesh.transformations.rotation_matrix(0.4, [1.0, 2.0, 0.5], [3.0, 0.0, 9.0])
    scene.add_geometry(half, geom_name="half", node_name="plain")
    for name, T in (("mirrored", mirrored), ("turned", turned)):
        scene.graph.update(name, matrix=T, geometry="half")
    (tmp_path / "scene.glb").write_bytes(scene.export(file_type="glb"))
    parts = [half, half.copy(), half.copy()]
    parts[1].apply_transform(mirrored)
    parts[2].apply_transform(turned)
    agrees(read_mesh(tmp_path / "scene.glb"), joined(parts))


def quads_and_polygons(path, notch):
    """A prism of 1.5 m on an L-shaped or notched outline, its caps polygons with many corners."""
    n = len(notch)
    lines = ["mtllib absent.mtl", "o prism"]
    lines += [f"v {x} {y} {z}" for z in (0.0, 1.5) for x, y in notch]
    lines += ["f " + " ".join(f"{k}//1" for k in range(n, 0, -1))]
    # Counted backwards from the last vertex, and broken over two lines.
    lines += ["f " + " ".join(str(k) for k in range(-n, 0)).replace(" -2 ", " \\\n -2 ")]
    lines += [f"f {k + 1} {(k + 1) % n + 1} {(k + 1) % n + 1 + n} {k + 1 + n}" for k in range(n)]
    path.write_text("\n".join(lines))
    x, y = np.array(notch).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


COMB = [
    *((0, 0), (5, 0), (5, 3), (4, 3), (4, 1), (3, 1)),
    *((3, 3), (2, 3), (2, 1), (1, 1), (1, 3), (0, 3)),
]
PERIMETER = 5 + 3 + 1 + 2 + 1 + 2 + 1 + 2 + 1 + 2 + 1 + 3
RING = [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]


@pytest.mark.parametrize("turn", range(0, 12, 3))
@pytest.mark.parametrize("backwards", [False, True])
def test_polygons_that_are_not_convex_are_covered_once(tmp_path, turn, backwards):
    outline = COMB[turn:] + COMB[:turn]
    area = quads_and_polygons(tmp_path / "comb.obj", outline[::-1] if backwards else outline)
    mesh = read_mesh(tmp_path / "comb.obj")
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1.5 * area)
    assert mesh.area == pytest.approx(2 * area + 1.5 * PERIMETER)


def test_a_hole_that_a_cut_leads_to_stays_a_hole(tmp_path):
    lines = [f"v {x} {y} 0" for x, y in RING] + ["f " + " ".join(map(str, range(1, 11)))]
    (tmp_path / "ring.obj").write_text("\n".join(lines))
    assert read_mesh(tmp_path / "ring.obj").area == pytest.approx(16 - 4)


def broken(kind, clean, rng):
    """A mesh with a fault that does not change what the satellite looks like."""
    vertices, faces = np.array(clean.vertices), np.array(clean.faces)
    if kind == "turned faces":
        turned = rng.random(len(faces)) < 0.4
        faces[turned] = faces[turned, ::-1]
    elif kind == "bodies inside out":
        parts = clean_parts()
        for part in parts[::2]:
            part.invert()
        return joined(parts)
    elif kind == "faces twice":
        again = faces[rng.permutation(len(faces))[:200]]
        faces = np.vstack([faces, np.roll(again, 1, axis=1), again[:50, ::-1]])
    elif kind == "no shared vertices":
        vertices, faces = vertices[faces].reshape(-1, 3), np.arange(faces.size).reshape(-1, 3)
    elif kind == "faces without area":
        first = faces[:40].copy()
        first[:, 1] = first[:, 0]
        faces = np.vstack([first, faces])
    elif kind == "stray vertices":
        vertices = np.vstack([vertices, [[1e9, 0.0, 0.0], [np.nan, 0.0, np.inf]]])
    elif kind == "another order":
        faces = faces[rng.permutation(len(faces))]
    return trimesh.Trimesh(vertices, faces, process=False, validate=False)


BROKEN = [
    *("turned faces", "bodies inside out", "faces twice", "no shared vertices"),
    *("faces without area", "stray vertices", "another order"),
]


@pytest.mark.parametrize("kind", BROKEN)
@pytest.mark.parametrize("suffix", ["obj", "ply"])
def test_faults_of_a_mesh_are_mended(tmp_path, clean, kind, suffix):
    mesh = broken(kind, clean, np.random.default_rng(3))
    path = tmp_path / f"mesh.{suffix}"
    if suffix == "obj":
        lines = ["v " + " ".join(map(repr, map(float, v))) for v in mesh.vertices]
        path.write_text("\n".join(lines + ["f " + " ".join(map(str, f + 1)) for f in mesh.faces]))
    else:
        as_file(tmp_path, path.name, mesh)
    agrees(read_mesh(path), clean)


def test_an_open_shell_stays_open_and_faces_outward(tmp_path):
    box = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    lidless = box.faces[np.abs(box.face_normals[:, 2] - 1.0) > 1e-6]
    shell = trimesh.Trimesh(box.vertices, lidless[:, ::-1], process=False)
    mesh = read_mesh(as_file(tmp_path, "shell.ply", shell))
    assert mesh.area == pytest.approx(2 * (2 + 3 + 6) - 2)
    assert not mesh.is_watertight
    assert np.all(np.einsum("ij,ij->i", mesh.face_normals, mesh.triangles_center) > 0.0)


def test_a_hollow_of_a_body_stays_hollow(tmp_path):
    outer, inner = (trimesh.creation.box(extents=(s, s, s)) for s in (2.0, 1.0))
    inner.invert()
    mesh = read_mesh(as_file(tmp_path, "hollow.stl", joined([outer, inner])))
    assert mesh.volume == pytest.approx(8 - 1)


def test_sizes_that_no_target_has_are_asked_about(tmp_path, clean):
    plain = read_mesh_file(as_file(tmp_path, "plain.stl", clean))
    assert plain.origin.unit_doubt is None
    clean.apply_scale(1000.0)
    path = as_file(tmp_path, "large.stl", clean)
    doubt = read_mesh_file(path).origin.unit_doubt
    assert doubt == "5.46 km across: is the mesh in millimetres (--mesh-unit mm)?"
    stated = read_mesh_file(path, LengthUnit.MILLIMETRE)
    assert stated.mesh.extents.max() < 5.0
    assert stated.origin.unit_doubt is None


def header_of(path, change):
    """A GLB file with another header."""
    content = path.read_bytes()
    size = struct.unpack("<I", content[12:16])[0]
    header = json.loads(content[20 : 20 + size])
    change(header)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + size :]
    head = struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON")
    path.write_bytes(head + text + rest)


def meshopt(header):
    header["extensionsRequired"] = ["EXT_meshopt_compression"]


def points_alone(header):
    for mesh in header["meshes"]:
        for primitive in mesh["primitives"]:
            primitive["mode"] = 0


def endless(header):
    header["accessors"][0]["count"] = 10**12


def quantised(header):
    for accessor in header["accessors"]:
        accessor["normalized"] = True


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (meshopt, "gltf-transform"),
        (points_alone, "found points or lines alone"),
        (endless, "accessors.0.count"),
        (quantised, "dequantize"),
    ],
)
def test_gltf_that_cannot_be_read_says_what_to_do(tmp_path, clean, change, says):
    path = as_file(tmp_path, "mesh.glb", clean)
    header_of(path, change)
    with pytest.raises(InputError) as caught:
        read_mesh(path)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_gltf_without_its_buffers_names_them(tmp_path, clean):
    path = as_file(tmp_path, "mesh.gltf", clean)
    buffer = sorted(tmp_path.glob("*.bin"))[-1]
    buffer.unlink()
    with pytest.raises(InputError, match=f"expected the file {buffer.name} beside it"):
        read_mesh(path)


def test_compressed_gltf_without_its_library_names_the_extra(tmp_path, clean, monkeypatch):
    path = as_file(tmp_path, "mesh.glb", clean)
    header_of(path, lambda header: header.update(extensionsRequired=["KHR_draco_mesh_compression"]))
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match="extra `formats`"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("sat.step", "export them as STL, 3MF or GLB"),
        ("sat.STP", "export them as STL, 3MF or GLB"),
        ("sat.fbx", "export it as GLB or OBJ"),
        ("sat.blend", "export it as GLB or OBJ"),
        ("sat.xyz", "reconstruct it first"),
        ("sat.zip", "unpack it"),
        ("sat", "no suffix"),
    ],
)
def test_other_formats_say_what_to_do(tmp_path, name, says):
    (tmp_path / name).write_bytes(b"anything")
    with pytest.raises(InputError) as caught:
        read_mesh(tmp_path / name)
    assert says in str(caught.value)
    assert str(caught.value).count("\n") == 0


@pytest.mark.parametrize("suffix", ["ply", "glb"])
def test_point_clouds_are_refused_in_one_line(tmp_path, suffix):
    cloud = trimesh.PointCloud(np.random.default_rng(0).normal(size=(70, 3)))
    scene = cloud if suffix == "ply" else trimesh.Scene(cloud)
    (tmp_path / f"cloud.{suffix}").write_bytes(scene.export(file_type=suffix))
    with pytest.raises(InputError, match="points"):
        read_mesh(tmp_path / f"cloud.{suffix}")


@pytest.mark.parametrize("name", sorted(FORMATS))
@pytest.mark.parametrize("share", [0.0, 0.3, 0.7])
def test_files_cut_short_are_one_line(tmp_path, clean, name, share):
    if "draco" in name:
        pytest.importorskip("DracoPy", reason="the extra `formats` is not installed")
    options = dict(FORMATS[name])
    kind = options.pop("file_type", None)
    if kind is None:
        path = as_file(tmp_path, name, clean, **options)
        content = path.read_bytes()
    else:
        path, content = tmp_path / name, clean.export(file_type=kind).encode()
    path.write_bytes(content[: int(share * len(content))])
    try:
        mesh = read_mesh(path)
    except InputError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 400 + len(str(path))
    else:
        # These do not say how much they hold: what was there is read.
        assert name in {"text.stl", "mesh.obj"}
        assert len(mesh.faces) < len(clean.faces)


@pytest.mark.parametrize("folder", ["mesh_glb-23-hang", "mesh_obj-22-traceback"])
def test_files_that_were_not_answered_in_one_line(shared_data, folder):
    (path,) = (shared_data / "bad_inputs" / folder).iterdir()
    try:
        mesh = read_mesh(path)
    except InputError as error:
        assert "\n" not in str(error)
        assert str(error).isprintable()
    else:
        # Two thousand instances of one satellite in one place are that satellite.
        assert folder == "mesh_glb-23-hang"
        assert mesh.volume == pytest.approx(6.8162526, rel=1e-6)
        assert len(mesh.faces) == 468
