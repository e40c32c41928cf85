"""How long each stage took, told as it begins; and native libraries held to one thread and one seed."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import cv2
from threadpoolctl import threadpool_limits

Progress = Callable[[str, float], None]


class StageClock:
    """Collects `seconds[stage]`; calls `progress(stage, share done)` when a stage begins."""

    def __init__(self, progress: Progress | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress

    @contextmanager
    def stage(self, name: str, share: float) -> Iterator[None]:
        """Time what runs inside; a stage that runs again adds to it."""
        if self._progress is not None:
            self._progress(name, share)
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread for OpenCV and BLAS, and OpenCV's seed set, so that a run can be repeated."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    cv2.setRNGSeed(1)
    try:
        with threadpool_limits(limits=1):
            yield
    finally:
        cv2.setNumThreads(before)
