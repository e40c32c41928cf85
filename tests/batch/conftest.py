"""Batches that a test may break, and fruit that are graded in the test's own process."""

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from unittest import mock

import pytest
from in_this_process import InThisProcess
from sample_batches import ready_batch

import pipeline.fruit.elasticity
import pipeline.fruit.flesh_model
import pipeline.fruit.fruit_shape
import pipeline.fruit.missing_physics
import pipeline.fruit.stages
import pipeline.run.grading
from pipeline.batch.cache import Kept, cached
from reports.skin_picture import mesh_picture


@pytest.fixture(autouse=True, scope="module")
def _in_this_process() -> Iterator[None]:
    """For every `drupe grade` of these tests but `drupe_alone`; pictures of graded fruit are small."""
    small = partial(mesh_picture, view_px=110)
    with (
        mock.patch.object(pipeline.run.grading, "LocalPool", side_effect=lambda *_, **__: InThisProcess()),
        mock.patch.object(pipeline.fruit.stages, "mesh_picture", small),
    ):
        yield


@pytest.fixture(autouse=True, scope="module")
def _stages_of_all_files(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[None]:
    """What one test's grading kept of a stage serves all files and workers: its key is a hash of its inputs.

    A module whose claim is a second run's own stages states OWN_STAGES.
    """
    if getattr(request.module, "OWN_STAGES", False):
        yield
        return
    base = tmp_path_factory.getbasetemp()
    store = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "stages"

    def shared(
        folder: Path, stage: str, key: str, compute: Callable[[], Kept], *, record: type[Kept]
    ) -> Kept:
        kept = partial(cached, store, f"{stage}-{key}", key, compute, record=record)
        return cached(folder, stage, key, kept, record=record)

    fruit = pipeline.fruit
    with ExitStack() as patches:
        for package in (fruit.elasticity, fruit.flesh_model, fruit.fruit_shape, fruit.missing_physics):
            patches.enter_context(mock.patch.object(package, "cached", shared))
        yield


@pytest.fixture(scope="session")
def _pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ready_batch(tmp_path_factory.mktemp("pristine") / "batch", 2)


@pytest.fixture
def batch(_pristine: Path, tmp_path: Path) -> Path:
    """A batch of two ready fruit that a test may break."""
    return Path(shutil.copytree(_pristine, tmp_path / "batch"))
