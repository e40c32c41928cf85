"""Batches that a test may break, and fruit that are graded in the test's own process."""

import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from unittest import mock

import pytest
from in_this_process import InThisProcess
from sample_batches import ready_batch

import pipeline.fruit.stages
import pipeline.run.grading
from reports.mesh_picture import mesh_picture


@pytest.fixture(autouse=True, scope="module")
def _in_this_process() -> Iterator[None]:
    """For every `drupe grade` of these tests but `drupe_alone`; pictures of graded fruit are small."""
    small = partial(mesh_picture, view_px=110)
    with (
        mock.patch.object(pipeline.run.grading, "local_pool", side_effect=lambda *_, **__: InThisProcess()),
        mock.patch.object(pipeline.fruit.stages, "mesh_picture", small),
    ):
        yield


@pytest.fixture(scope="session")
def _pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ready_batch(tmp_path_factory.mktemp("pristine") / "batch", 2)


@pytest.fixture
def batch(_pristine: Path, tmp_path: Path) -> Path:
    """A batch of two ready fruit that a test may break."""
    return Path(shutil.copytree(_pristine, tmp_path / "batch"))
