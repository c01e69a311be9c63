"""The rectangle catalogue against solids whose rectangles are known in closed form."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from pcnav.core.spatial import exp_rotation, make_transform, rotation_fault
from pcnav.target.catalogue import Rectangle, rectangle_fault
from pcnav.target.facets import planar_faces
from pcnav.target.mesh import wireframe_edges
from pcnav.target.mesh_files.reading import read_mesh
from tests.target.catalogued import find_rectangles

SIZE = (1.0, 2.0, 3.0)
POSE = make_transform(exp_rotation(np.array([0.3, -1.1, 0.7])), np.array([3.0, -2.0, 5.0]))


def solid(size=SIZE, centre=(0.0, 0.0, 0.0)):
    return trimesh.creation.box(
        extents=size, transform=trimesh.transformations.translation_matrix(centre)
    )


def together(*meshes):
    return trimesh.util.concatenate(list(meshes))


def sides(rectangles):
    return [(round(r.length_m, 6), round(r.width_m, 6)) for r in rectangles]


def corners(rectangle: Rectangle):
    """The four corners of a rectangle, model frame."""
    half = 0.5 * np.array([rectangle.width_m, rectangle.length_m])
    local = np.array([[sx, sy] for sx in (-1, 1) for sy in (-1, 1)]) * half
    flat = np.column_stack([local, np.zeros(4), np.ones(4)])
    return (flat @ rectangle.T_model_rect.T)[:, :3]


def check_frames(rectangles, mesh):
    """Axes are right-handed and every corner is where the mesh has one."""
    for rectangle in rectangles:
        assert rotation_fault(rectangle.T_model_rect[:3, :3]) is None
        distance = np.linalg.norm(corners(rectangle)[:, None] - mesh.vertices, axis=-1)
        assert distance.min(axis=1).max() < 1e-6


@settings(max_examples=15)
@given(
    st.tuples(*[st.floats(0.2, 3.0)] * 3),
    st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    st.tuples(*[st.floats(-20.0, 20.0)] * 3),
)
def test_box_anywhere_has_its_six_faces(size, turn, shift):
    mesh = solid(size)
    mesh.apply_transform(make_transform(exp_rotation(np.array(turn)), np.array(shift)))
    rectangles = find_rectangles(mesh)
    a, b, c = sorted(size)
    # Areas may tie, so the sides are compared each on their own, and then in pairs by area.
    lengths, widths = np.array([(r.length_m, r.width_m) for r in rectangles]).T
    assert np.allclose(np.sort(lengths), [b, b, c, c, c, c], rtol=1e-6)
    assert np.allclose(np.sort(widths), [a, a, a, a, b, b], rtol=1e-6)
    assert np.allclose(np.sort(lengths * widths), np.sort([a * b, a * c, b * c] * 2), rtol=1e-6)
    check_frames(rectangles, mesh)
    areas = [r.area_m2 for r in rectangles]
    assert np.all(np.diff(areas) <= 1e-5 * areas[0])
    centre = mesh.bounds.mean(axis=0)
    for r in rectangles:
        outward = r.T_model_rect[:3, 3] - shift
        assert outward @ r.T_model_rect[:3, 2] > 0.0
        assert not r.two_sided
    assert np.allclose(np.mean([r.T_model_rect[:3, 3] for r in rectangles], axis=0), centre)


def test_frame_axes_are_short_long_normal():
    for rectangle in find_rectangles(solid()):
        centroid, R = rectangle.T_model_rect[:3, 3], rectangle.T_model_rect[:3, :3]
        # On this box a model axis has the extent of the same index: a closed form of the axes.
        extent = np.abs(R).T @ np.array(SIZE)
        assert np.allclose(extent[:2], [rectangle.width_m, rectangle.length_m])
        assert np.allclose(centroid, 0.5 * extent[2] * R[:, 2])


def test_order_and_axes_do_not_depend_on_the_triangles():
    mesh = solid((1.0, 1.0, 2.0))
    reference = find_rectangles(mesh)
    rng = np.random.default_rng(5)
    for _ in range(4):
        fine = mesh.subdivide()
        shuffled = trimesh.Trimesh(fine.vertices, fine.faces[rng.permutation(len(fine.faces))])
        again = find_rectangles(shuffled)
        assert sides(again) == sides(reference)
        for r, s in zip(again, reference, strict=True):
            assert np.allclose(r.T_model_rect, s.T_model_rect, atol=1e-6)


def test_tiles_of_unshared_vertices_and_unlike_cuts_are_one_rectangle():
    # Two boxes side by side, one cut finer than the other: their long faces are continuous, their
    # vertices along the seam do not match, and the faces in contact are inside.
    mesh = together(solid((1, 1, 1)).subdivide().subdivide(), solid((2, 1, 1), (1.5, 0, 0)))
    assert sides(find_rectangles(mesh)) == [(3, 1)] * 4 + [(1, 1)] * 2


def test_loose_triangles_are_one_rectangle():
    mesh = solid()
    loose = trimesh.Trimesh(
        mesh.triangles.reshape(-1, 3), np.arange(36).reshape(-1, 3), process=False
    )
    assert sides(find_rectangles(loose)) == sides(find_rectangles(mesh))


def test_coplanar_parts_with_a_gap_stay_apart():
    mesh = together(solid((2, 1, 0.1)), solid((2, 1, 0.1), (2.05, 0, 0)))
    assert sides(find_rectangles(mesh, minimum_side_fraction=0.1)) == [(2, 1)] * 4


def test_bodies_meeting_in_a_plane_from_either_side_stay_apart():
    # The upper face of one box and the lower face of the other share a plane and an edge.
    mesh = together(solid((1, 1, 1)), solid((1, 1, 1), (1, 0, 1)))
    rectangles = find_rectangles(mesh)
    assert sides(rectangles) == [(1, 1)] * 12
    in_plane = [r for r in rectangles if abs(r.T_model_rect[2, 3] - 0.5) < 1e-9]
    normals = sorted(r.T_model_rect[2, 2] for r in in_plane if abs(r.T_model_rect[2, 2]) > 0.5)
    assert np.allclose(normals, [-1, 1])


def test_part_that_stands_on_a_face_leaves_the_face():
    mesh = together(solid((2, 2, 2)), solid((0.5, 0.4, 1), (0.3, 0, 1.5)))
    rectangles = find_rectangles(mesh)
    assert sides(rectangles)[:6] == [(2, 2)] * 6
    # The foot of the small box, pressed on the large one, is seen by nobody.
    assert sides(rectangles)[6:] == [(1, 0.5)] * 2 + [(1, 0.4)] * 2 + [(0.5, 0.4)]


def test_hidden_body_is_not_listed():
    assert sides(find_rectangles(together(solid(), solid((0.5, 0.5, 0.5))))) == sides(
        find_rectangles(solid())
    )


@pytest.mark.parametrize("flip", [slice(None), slice(None, None, 2)])
def test_winding_is_not_relied_upon(flip):
    mesh = solid()
    faces = mesh.faces.copy()
    faces[flip] = faces[flip][:, ::-1]
    turned = find_rectangles(trimesh.Trimesh(mesh.vertices, faces, process=False))
    for r, s in zip(turned, find_rectangles(mesh), strict=True):
        assert np.allclose(r.T_model_rect, s.T_model_rect, atol=1e-6)


@pytest.mark.parametrize(
    "faces",
    [
        [[0, 1, 2], [0, 2, 3]],
        [[0, 1, 2], [0, 3, 2]],
        [[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]],
    ],
    ids=["one winding", "mixed winding", "doubled"],
)
def test_sheet_is_one_rectangle_with_two_sides(faces):
    sheet = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 0, 1], [0, 0, 1]], faces, process=False)
    (rectangle,) = find_rectangles(sheet)
    assert rectangle.two_sided
    assert np.allclose([rectangle.length_m, rectangle.width_m], [2, 1])
    assert np.allclose(rectangle.T_model_rect[:3, 2], [0, 1, 0])
    assert np.allclose(rectangle.T_model_rect[:3, 1], [1, 0, 0])


def slab(x, y):
    """A box over the given spans of x and y, 0.1 thick."""
    size = (x[1] - x[0], y[1] - y[0], 0.1)
    return solid(size, (0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1]), 0.0))


def test_hole_of_more_than_one_percent_is_no_rectangle():
    frame = together(
        slab((0, 1), (0, 0.4)),
        slab((0, 1), (0.6, 1)),
        slab((0, 0.4), (0.4, 0.6)),
        slab((0.6, 1), (0.4, 0.6)),
    )
    # The edges of the plate remain, made of one slab or three, and two walls of the hole; the other
    # two belong to faces that lie for the most part hidden between the slabs.
    assert sides(find_rectangles(frame)) == [(1, 0.1)] * 4 + [(0.2, 0.1)] * 2


@pytest.mark.parametrize(("notch", "found"), [(0.15, 0), (0.05, 2)])
def test_notch_is_let_pass_below_one_percent(notch, found):
    notched = together(slab((0, 1), (notch, 1)), slab((0, 1 - notch), (0, notch)))
    big = [r for r in find_rectangles(notched) if r.width_m > 0.5]
    assert len(big) == found
    assert np.allclose([[r.length_m, r.width_m] for r in big], 1.0, atol=3e-3)


def test_facets_of_a_curved_wall_are_not_rectangles():
    assert find_rectangles(trimesh.creation.cylinder(1.0, 4.0, sections=32), 0.01) == ()
    # A hexagonal prism has honest edges.
    prism = trimesh.creation.cylinder(1.0, 4.0, sections=6)
    assert np.allclose([(r.length_m, r.width_m) for r in find_rectangles(prism)], [(4, 1)] * 6)


def test_moments_of_a_face_agree_with_the_mesh_library():
    mesh = trimesh.creation.cylinder(1.0, 0.5, sections=5, transform=POSE)
    face = planar_faces(mesh, 1.0)[0]
    # A regular pentagon of circumradius 1: area 5/2 sin 72, equal second moments.
    assert face.area_m2 == pytest.approx(2.5 * np.sin(np.radians(72)), rel=1e-6)
    expected = (2.0 + np.cos(np.radians(72))) / 12.0
    assert np.allclose(face.second_moments_m2, expected * np.eye(2), atol=1e-6)
    assert rectangle_fault(face) > 0.05


def test_small_sides_are_left_out():
    panel = solid((0.04, 4.0, 1.5))
    assert sides(find_rectangles(panel)) == [(4, 1.5)] * 2
    assert len(find_rectangles(panel, minimum_side_fraction=0.005)) == 6


def test_wireframe_of_a_box_is_its_twelve_edges():
    edges = wireframe_edges(solid().subdivide().subdivide())
    length = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1)
    assert length.sum() == pytest.approx(4 * sum(SIZE))
    sheet = trimesh.Trimesh([[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    edges = wireframe_edges(sheet)
    assert np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).sum() == pytest.approx(6)


def test_third_party_cubesat(shared_data):
    mesh = read_mesh(shared_data / "meshes" / "Cubesat_6U.obj")
    assert len(mesh.faces) > 400
    rectangles = find_rectangles(mesh)
    assert sides(rectangles) == [(0.3, 0.2)] * 2 + [(0.3, 0.1)] * 2 + [(0.2, 0.1)] * 2


def test_a_gentle_curve_cut_finely_is_no_flat_face():
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, 301), np.linspace(-0.3, 0.3, 31), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), (x**2 / 20.0).ravel()])
    corner = np.arange(300)[:, None] * 31 + np.arange(30)
    first, across = corner.ravel(), corner.ravel() + 31
    faces = np.vstack(
        [
            np.column_stack([first, across, across + 1]),
            np.column_stack([first, across + 1, first + 1]),
        ]
    )
    bent = trimesh.Trimesh(vertices, faces, process=False)
    flat = trimesh.Trimesh(vertices * [1.0, 1.0, 0.0], faces, process=False)
    assert len(planar_faces(flat, 0.01)) == 1
    assert planar_faces(bent, 0.01) == ()


def test_many_triangles_of_a_plane_that_cross_are_one_surface():
    # A fine tessellation that was damaged: joined as a coverage they are none.
    rng = np.random.default_rng(2)
    vertices = np.column_stack([rng.uniform(size=(40, 2)), np.zeros(40)])
    corners = np.array([rng.permutation(40)[:3] for _ in range(200)])
    sheet = trimesh.Trimesh(vertices, corners, process=False)
    faces = planar_faces(sheet, 0.1)
    assert faces and max(face.area_m2 for face in faces) <= 1.0
