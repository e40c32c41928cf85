"""Batches that a test may break, and fruit that are graded in the test's own process."""

import gc
import pickle
import shutil
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self
from unittest import mock

import pytest
from sample_batches import ready_batch

import pipeline.fruit.stages
import pipeline.run.grading
from pipeline.run.scheduling import Event, Finished, Progressed
from reports.mesh_picture import mesh_picture


class InThisProcess:
    """Works on one fruit after the other without processes: libraries are loaded once, and the shapes of
    arrays are checked in grading too. What processes are for is tested with `drupe_alone` and in
    tests/pipeline/test_runner.py.
    """

    at_once = 1

    def __init__(self) -> None:
        self._begun: list[tuple[str, bytes]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._begun.clear()

    def room(self) -> int:
        return self.at_once - len(self._begun)

    def begin(self, fruit_id: str, packed: bytes) -> None:
        self._begun.append((fruit_id, packed))

    def happened(self) -> Iterator[Event]:
        fruit_id, packed = self._begun.pop()
        stages: list[str] = []
        try:
            work, task = pickle.loads(packed)
            result = work(task, stages.append)
        except Exception as error:  # noqa: BLE001 - as pipeline.run.runner hands it over
            result = error
        finally:
            gc.unfreeze()  # a fruit's own process ends; this one goes on
        yield from (Progressed(fruit_id, stage) for stage in stages)
        yield Finished(fruit_id, result)


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
