"""Meshes as they are written: each where it was made, the fruit's with what the photos showed of it."""

import numpy as np
import pytest
import trimesh

from pipeline.batch.layout import FruitResults
from pipeline.batch.records import MeshRecord, PitRecord
from pipeline.fruit.fruit_shape import FruitPit, FruitShape, write_meshes
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import read_mesh

DIRECTIONS, FACES = ball(3)
BOX = (60.0, 60.0, 60.0)


def pit():
    record = PitRecord(
        source="pit.ply", volume_mm3=1.0, centre_mm=(0, 0, 0), box_mm=BOX, thinnest_flesh_mm=1.0,
        flesh_volume_mm3=1.0,
    )  # fmt: skip
    return FruitPit(vertices=10 * DIRECTIONS, faces=FACES, skin=(30 * DIRECTIONS, FACES), record=record)


def shape(views):
    counts = {"vertices": len(DIRECTIONS), "faces": len(FACES), "volume_mm3": 1.0}
    record = MeshRecord(source="photos", **counts, height_mm=60.0, box_mm=BOX)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = [[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1.0, 2.0, 3.0]
    return FruitShape(
        vertices=30 * DIRECTIONS, faces=FACES, mesh_from_fruit=pose, record=record, warnings=(), views=views
    )


@pytest.mark.parametrize("known", [True, False])
def test_views_stay_with_their_vertices_and_both_meshes_go_back_to_their_frame(tmp_path, known):
    views = np.arange(len(DIRECTIONS)) % 7
    results = FruitResults(tmp_path)
    write_meshes(results, shape(views if known else None), pit())
    for path, radius in ((results.fruit_ply, 30), (results.pit_ply, 10)):
        x, y, z = (radius * DIRECTIONS).T
        np.testing.assert_allclose(read_mesh(path)[0], np.column_stack([1 - y, 2 + x, 3 + z]), atol=1e-5)
    table = trimesh.load_mesh(results.fruit_ply, process=False).metadata["_ply_raw"]["vertex"]["data"]
    assert ("views" in table.dtype.names) is known
    if known:
        assert np.array_equal(table["views"].ravel(), views)
