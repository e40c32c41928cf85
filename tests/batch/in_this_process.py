"""Fruit that are graded in the test's own process."""

import gc
import pickle
from collections.abc import Iterator
from typing import Self

from pipeline.run.scheduling import Event, Finished, Progressed


class InThisProcess:
    """Works on one fruit after the other without processes: libraries are loaded once, and the shapes of
    arrays are checked in grading too. What processes are for is tested with `drupe_alone` and in
    tests/pipeline/test_runner.py.
    """

    def __init__(self) -> None:
        self._begun: list[tuple[str, bytes]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._begun.clear()

    def room(self) -> int:
        return 1 - len(self._begun)

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
