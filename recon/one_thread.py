"""One thread for native libraries: sums in another order are other numbers."""

from collections.abc import Iterator
from contextlib import contextmanager

import cv2
from threadpoolctl import threadpool_limits


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
