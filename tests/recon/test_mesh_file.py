"""Mesh files: what is written is read again, other tools' forms are read, broken ones are named."""

import numpy as np
import pytest
import trimesh

from recon.native import open3d
from recon.recon_failure import ReconFailure, ReconProblem
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import mesh_bytes, read_mesh, write_mesh


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
    ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    ply += "element face 1\nproperty list uchar int vertex_index\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    (tmp_path / "a.ply").write_text(ply)
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n")
    corners = "".join(f"vertex {x} {y} 0\n" for x, y in ((0, 0), (1, 0), (0, 1)))
    (tmp_path / "a.stl").write_text(
        f"solid a\nfacet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\nendsolid\n"
    )
    assert [len(read_mesh(tmp_path / f"a.{s}")[1]) for s in ("ply", "obj", "stl")] == [1, 2, 1]


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\n", "no PLY header"),
        ("a.xyz", b"", "expected one of .ply, .stl, .obj"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", "is broken"),
        ("a.obj", b"# nothing\n", "holds 0 vertices"),
        ("a.obj", b"v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no number"),
    ],
)
def test_a_broken_mesh_is_named(tmp_path, name, data, words):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(ReconFailure, match=words) as caught:
        read_mesh(tmp_path / name)
    assert caught.value.problem is ReconProblem.UNREADABLE_MESH
    assert name in str(caught.value)


def test_a_truncated_or_missing_file_is_named(tmp_path):
    vertices, faces = ball(1)
    path = tmp_path / "cut.ply"
    write_mesh(path, vertices, faces)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(ReconFailure, match=r"cut\.ply is broken"):
        read_mesh(path)
    with pytest.raises(ReconFailure, match="does not exist"):
        read_mesh(tmp_path / "none.ply")


def test_a_face_that_names_no_vertex_is_named(tmp_path):
    vertices, faces = ball(1)
    path = tmp_path / "far.ply"
    write_mesh(path, vertices, faces + 1)
    with pytest.raises(ReconFailure, match=r"far\.ply"):
        read_mesh(path)


@pytest.mark.parametrize("kind", ["ply", "stl", "obj"])
def test_a_mesh_finer_than_one_fruits_memory_carries_is_refused_with_what_to_do(tmp_path, monkeypatch, kind):
    monkeypatch.setattr("recon.surface.mesh_file.MOST_ELEMENTS", 300)
    vertices, faces = ball(2)
    path = tmp_path / f"fruit.{kind}"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    with pytest.raises(ReconFailure) as caught:
        read_mesh(path)
    assert f"fruit.{kind} holds" in caught.value.detail
    assert "320" in caught.value.detail
    assert "expected at most 300 each: decimate it, for example to 200,000 faces." in caught.value.detail


def test_a_vertex_that_no_face_uses_is_of_no_surface(tmp_path):
    vertices, faces = ball(2)
    path = tmp_path / "a.ply"
    write_mesh(path, np.concatenate([[[0.0, 0.0, 900.0]], vertices]), faces + 1)
    again, same = read_mesh(path)
    np.testing.assert_allclose(again, vertices, rtol=1e-6, atol=1e-9)
    assert np.array_equal(same, faces)
