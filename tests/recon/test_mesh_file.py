"""Mesh files, asked by rays: other tools' forms are read, broken ones are named."""

import re
import struct
import sys

import numpy as np
import pytest
import trimesh
from refusals import refused

from recon.pit.placement import require_closed
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import mesh_bytes, read_mesh, write_mesh
from recon.surface.ray_mesh import consistently_oriented, open3d, seeing_views, seen_and_unseen
from recon.triangle_mesh import open_edges, sides_of, unique_edges, volume_mm3


def test_ply_round_trip_keeps_every_coordinate_to_single_precision(tmp_path):
    vertices, faces = ball(2)
    write_mesh(tmp_path / "a.ply", vertices, faces)
    again, same = read_mesh(tmp_path / "a.ply")
    np.testing.assert_allclose(again, vertices, rtol=1e-6, atol=1e-9)
    assert np.array_equal(same, faces)
    assert (tmp_path / "a.ply").read_bytes() == mesh_bytes(vertices, faces)


def test_what_the_photos_saw_is_written_beside_the_coordinates(tmp_path):
    vertices, faces = ball(2)
    views = np.where(vertices[:, 2] > 0, 300, 1)
    (tmp_path / "a.ply").write_bytes(mesh_bytes(vertices, faces, views=views))
    np.testing.assert_allclose(read_mesh(tmp_path / "a.ply")[0], vertices, rtol=1e-6, atol=1e-9)
    table = trimesh.load_mesh(tmp_path / "a.ply", process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert np.array_equal(table["views"].ravel(), views)
    colours = np.asarray(open3d().io.read_triangle_mesh(str(tmp_path / "a.ply")).vertex_colors)
    assert np.array_equal(np.ptp(colours, axis=1) < 0.1, views < 2)  # grey where not seen


def test_text_ply_obj_and_stl_are_read(tmp_path):
    ply = _text_ply([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    (tmp_path / "a.ply").write_text(ply.replace("vertex_indices", "vertex_index"))
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n")
    corners = "".join(f"vertex {x} {y} 0\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    (tmp_path / "a.stl").write_text(
        f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid\n"
    )
    assert [len(read_mesh(tmp_path / f"a.{s}")[1]) for s in ("ply", "obj", "stl")] == [1, 2, 1]


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("none.ply", None, "does not exist"),
        ("a.ply", b"ply\nformat ascii 1.0\n", "no PLY header"),
        ("a.xyz", b"", "expected one of .ply, .stl, .obj"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "is broken"),
        ("a.obj", b"# nothing\n", "holds 0 vertices"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no number"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "holds 0 vertices and 0 faces"),
        ("cut.ply", mesh_bytes(*ball(1))[:-40], "is broken"),
        ("far.ply", mesh_bytes(ball(1)[0], ball(1)[1] + 1), "has a face that names vertex 42 of 42"),
    ],
)
def test_a_broken_mesh_is_named(tmp_path, name, data, words):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with refused(ReconProblem.UNREADABLE_MESH, rf"{name}.*{words}"):
        read_mesh(tmp_path / name)


@pytest.mark.parametrize("kind", ["ply", "stl", "obj"])
def test_a_mesh_finer_than_one_fruits_memory_carries_is_refused_with_what_to_do(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("recon.surface.mesh_file.MOST_ELEMENTS", 300)
    vertices, faces = ball(2)
    path = tmp_path / f"fruit.{kind}"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    words = (
        rf"fruit\.{kind} holds.* 320 .*expected at most 300 each: decimate it, for example to 200,000 faces\."
    )
    with refused(ReconProblem.UNREADABLE_MESH, words):
        read_mesh(path)


def _head(vertices, faces, kind="ascii"):
    head = f"ply\nformat {kind} 1.0\ncomment TextureFile skin.png\nelement vertex {len(vertices)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    return head + f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"


def _text_ply(vertices, faces):
    rows = [" ".join(f"{x:.9g}" for x in v) for v in vertices]
    rows += [" ".join(map(str, (len(f), *f))) for f in faces]
    return _head(vertices, faces) + "\n".join(rows) + "\n"


def test_a_cube_of_quadrilaterals_or_of_one_triangle_more_has_its_volume(tmp_path):
    corners = np.array([[x, y, z] for x in (0, 2) for y in (0, 2) for z in (0, 2)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    mixed = [*quads[1:], [0, 1, 3], [0, 3, 2]]
    split = [[5 * k + j for j in range(4)] for k in range(6)]
    apart = np.concatenate([np.vstack([corners[q], [[9.0, 9.0, 9.0]]]) for q in quads])
    turned = [quads[0][::-1], *quads[1:4], quads[4][::-1], quads[5]]
    for name, (vertices, faces) in {
        "quads": (corners, quads),
        "mixed": (corners, mixed),
        "each face with corners of its own": (apart, split),
        "mixed winding": (corners, turned),
        "mixed winding, most of it inward": (corners, [q[::-1] for q in quads[:4]] + quads[4:]),
    }.items():
        (tmp_path / "a.ply").write_text(_text_ply(vertices, faces))
        places, triangles = read_mesh(tmp_path / "a.ply")
        assert open_edges(triangles) == 0, name
        assert len(triangles) == 12, name
        assert volume_mm3(places, triangles) == pytest.approx(8.0), name


@pytest.mark.parametrize("endian", ["<", ">"])
def test_a_binary_pyramid_of_a_quadrilateral_and_triangles_has_its_volume(tmp_path, endian):
    corners = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [1, 1, 3]], f"{endian}f4")
    faces = [(3, 2, 1, 0), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    head = _head(corners, faces, {"<": "binary_little_endian", ">": "binary_big_endian"}[endian])
    rows = b"".join(struct.pack(f"{endian}B{len(face)}i", len(face), *face) for face in faces)
    (tmp_path / "a.ply").write_bytes(head.encode() + corners.tobytes() + rows)
    places, triangles = read_mesh(tmp_path / "a.ply")
    assert open_edges(triangles) == 0
    assert volume_mm3(places, triangles) == pytest.approx(4.0)


@pytest.mark.parametrize("kind", ["ply", "stl", "obj", "glb"])
def test_a_closed_surface_that_is_inside_out_is_refused_in_each_format(tmp_path, kind):
    vertices, faces = ball(2)
    path = tmp_path / f"fruit.{kind}"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    require_closed(*read_mesh(path), what=path.name)
    trimesh.Trimesh(vertices, faces[:, ::-1], process=False).export(path)
    with pytest.raises(ReconFailure, match=rf"fruit\.{kind}'s mesh is inside out; expected faces that"):
        require_closed(*read_mesh(path), what=path.name)


def test_gltf_is_in_metres_and_a_broken_one_is_named(tmp_path):
    vertices, faces = ball(2)
    trimesh.Trimesh(0.028 * vertices, faces, process=False).export(tmp_path / "a.glb")
    corners, triangles = read_mesh(tmp_path / "a.glb")
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), 28.0, rtol=1e-6)
    assert open_edges(triangles) == 0
    whole = (tmp_path / "a.glb").read_bytes()
    for broken, words in (
        (whole[:-40], "cut short"),
        (whole.replace(b'"count":', b'"cuont":'), "its description cannot be read"),
        (whole.replace(b'"count":162', b'"count":9e9', 1), "holds 9000000000 values in a list"),
    ):
        (tmp_path / "b.glb").write_bytes(broken)
        with pytest.raises(ReconFailure, match=words):
            read_mesh(tmp_path / "b.glb")


def test_gltf_has_y_up_and_is_turned_to_z_up(tmp_path):
    vertices, faces = ball(2)
    vertices = vertices * [20.0, 25.0, 30.0] + [1.0, 2.0, 3.0]
    x, y, z = vertices.T / 1e3
    for name, node in (("a", np.eye(4)), ("b", trimesh.transformations.translation_matrix([0, 1, 0]))):
        scene = trimesh.Scene()
        mesh = trimesh.Trimesh(np.c_[x, z, -y] - node[:3, 3], faces, process=False)
        scene.add_geometry(mesh, transform=node)
        scene.export(tmp_path / f"{name}.glb")
        corners, triangles = read_mesh(tmp_path / f"{name}.glb")
        np.testing.assert_allclose(corners, vertices, atol=1e-3)
        assert volume_mm3(corners, triangles) == pytest.approx(volume_mm3(vertices, faces), rel=1e-4)
    glb = (tmp_path / "a.glb").read_bytes()
    generator = glb[glb.index(b'"generator":') : glb.index(b"}", glb.index(b'"generator":'))]
    (tmp_path / "c.glb").write_bytes(glb.replace(generator, b'"generator":"drupe"'.ljust(len(generator))))
    with pytest.raises(
        ReconFailure, match=r"c\.glb is a picture of drupe's results.*the fruit\.ply beside it"
    ):
        read_mesh(tmp_path / "c.glb")


def test_points_without_faces_are_called_so(tmp_path):
    vertices, _ = ball(2)
    no_faces = _text_ply(vertices, [])
    for text in (no_faces, re.sub(r"element face 0\nproperty list .*\n", "", no_faces)):
        (tmp_path / "a.ply").write_text(text)
        with pytest.raises(ReconFailure, match=r"is a cloud of 162 points without faces; .*mesh the points"):
            read_mesh(tmp_path / "a.ply")


@pytest.mark.parametrize(
    ("why", "ends"), [("OSError('libGL.so.1')", ReconFailure), ("KeyboardInterrupt()", KeyboardInterrupt)]
)
def test_a_stop_while_a_library_is_loaded_is_no_missing_library(tmp_path, monkeypatch, why, ends):
    (tmp_path / "open3d.py").write_text(f"raise ImportError('initialization failed') from {why}\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name in [module for module in sys.modules if module.partition(".")[0] == "open3d"]:
        monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ends):
        open3d()


def test_a_closed_mesh_has_each_edge_once_and_each_side_knows_its_own() -> None:
    vertices, faces = ball(2)
    edges, of_side = unique_edges(faces)
    assert len(vertices) - len(edges) + len(faces) == 2  # Euler's formula
    assert np.array_equal(edges, np.unique(edges, axis=0))
    assert np.array_equal(edges[of_side], np.sort(sides_of(faces), axis=1))
    assert (np.bincount(of_side) == 2).all()


def test_faces_turned_at_random_are_consistently_oriented_again_and_one_sided_surfaces_are_left() -> None:
    _, faces = ball(3)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        mixed = np.where(rng.random((len(faces), 1)) < 0.4, faces[:, ::-1], faces)
        assert open_edges(mixed) > 0
        assert open_edges(consistently_oriented(mixed)) == 0
    strip = np.array([[k, (k + 1) % 5, (k + 2) % 5] for k in range(5)])  # of five triangles, the smallest
    assert consistently_oriented(strip) is strip
    projective_plane = np.array(
        [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [0, 5, 1],
         [1, 2, 4], [2, 3, 5], [3, 4, 1], [4, 5, 2], [5, 1, 3]]
    )  # fmt: skip
    assert consistently_oriented(projective_plane) is projective_plane


RADIUS = 10.0
FAR = 1e6


def test_a_far_camera_faces_half_a_ball_and_a_near_one_less():
    directions, faces = ball(5)
    vertices = RADIUS * directions
    far = seeing_views(vertices, faces, np.array([[0.0, 0.0, FAR]]))
    near = seeing_views(vertices, faces, np.array([[0.0, 0.0, 2 * RADIUS]]))
    height = vertices[:, 2] / RADIUS
    assert ((far == 1) == (height > 0))[np.abs(height) > 0.02].all()
    assert ((near == 1) == (height > 0.5))[np.abs(height - 0.5) > 0.02].all()


def test_what_two_cameras_see_together_is_a_lune_and_the_rest_is_the_hole():
    directions, faces = ball(5)
    vertices = RADIUS * directions
    across = np.array([[FAR, 0.0, 0.0], [0.0, FAR, 0.0]])
    share, hole = seen_and_unseen(vertices, faces, seeing_views(vertices, faces, across))
    assert share == pytest.approx(0.25, abs=0.008)  # a lune of 90 degrees; its rim is cut by triangles
    assert hole == pytest.approx(0.75 * 4 * np.pi * RADIUS**2, rel=0.012)
