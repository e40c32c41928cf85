"""Requirements of a command on the machine: system libraries and cores."""

import os

from pipeline.problem import BatchRefused, Problem
from pipeline.system_libraries import missing_libraries


def require_libraries() -> None:
    """Raises BatchRefused with every missing system library that native wheels load."""
    if missing := missing_libraries():
        raise BatchRefused([Problem("this machine", sentence) for sentence in missing])


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
