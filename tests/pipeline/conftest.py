"""A case, a batch of one fruit, and `drupe explain` with another finder than its own."""

import shutil
from functools import partial

import pytest
import sample_batches
from explain_runs import DATA, GRADED, NO_MESH, SETTINGS, change, stronger
from fake_explanation import fake_explanation
from small_batches import batch_of_nectarines
from threadpoolctl import threadpool_info

import pipeline.diagnosis.diagnosis
import pipeline.fruit.grasped
from reports import explain_page
from reports.skin_picture import map_picture


@pytest.fixture
def drupe():
    """Runs the command in this process."""
    return sample_batches.drupe


@pytest.fixture
def finder(monkeypatch):
    """Takes the finder's place: keeps what it is handed, and gives the explanation it is told to, whose maps
    are drawn small.
    """
    handed = {}

    def find(case, graded, log, *, jobs):
        log.report("naming")
        handed["case"], handed["graded"], handed["jobs"] = case, graded, jobs
        handed["blas threads"] = {pool["num_threads"] for pool in threadpool_info()}
        return handed.get("answer", fake_explanation())

    def graded_case(_case, _fruit, *, jobs):
        handed["jobs of grading"] = jobs
        return GRADED, []

    monkeypatch.setattr(pipeline.diagnosis.diagnosis, "find", find)
    monkeypatch.setattr(pipeline.diagnosis.diagnosis, "graded_case", graded_case)

    def finer_flesh(*_, grasps):
        return f"for {grasps} grasps"

    monkeypatch.setattr(pipeline.diagnosis.diagnosis, "finer_flesh", finer_flesh)
    monkeypatch.setattr(pipeline.fruit.grasped, "flesh_mesh", lambda *_: NO_MESH)
    monkeypatch.setattr(explain_page, "map_picture", partial(map_picture, view_px=50))
    return handed


@pytest.fixture
def case(tmp_path):
    """Two recordings of one fruit."""
    folder = tmp_path / "case"
    folder.mkdir()
    for name in ("fruit.ply", "pit.ply"):
        shutil.copy(DATA / name, folder)
    for k in (1, 2):
        shutil.copy(DATA / "grasp.h5", folder / f"grasp-{k}.h5")
    change(folder / "grasp-2.h5", stronger)
    (folder / "case.toml").write_text(SETTINGS)
    return folder


@pytest.fixture
def batch(tmp_path):
    """A batch of one fruit."""
    root = batch_of_nectarines(tmp_path / "batch", "N01", pit=True)
    grasps = root / "fruits" / "N01" / "grasps"
    shutil.copy(grasps / "grasp-1.h5", grasps / "grasp-2.h5")
    change(grasps / "grasp-2.h5", stronger)
    (root / "batch.toml").write_text('# ours\ncategory = "nectarine"\npoisson_ratio = 0.45\n')
    return root
