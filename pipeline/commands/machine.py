"""What the machine must have for a command, and how much of it there is."""

import os

from pipeline.problem import BatchRefused, Problem
from pipeline.system_libraries import missing_libraries


def require_libraries() -> None:
    """Raises BatchRefused with every system library that native wheels load and that is missing."""
    if missing := missing_libraries():
        raise BatchRefused([Problem("this machine", sentence) for sentence in missing])


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
