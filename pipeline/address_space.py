"""What libraries need of memory, and the limit that may be set on it (`ulimit -v`).

A library that meets the limit while it is loaded ends the process, runs for ever (OpenBLAS, pycolmap) or
reports a broken installation. The limit is therefore compared with the need before any library is loaded.
"""

import os
import re
import resource

LIBRARIES_MIB, GRADING_MIB = 500.0, 2200.0
"""Address space that a command needs with one numerical thread, and one that grades or checks. Peaks of
VmPeak: 450 MiB of `convert`, 2,130 MiB of `grade`, mostly libraries that are mapped and never read."""
PER_THREAD_MIB = 220.0
"""And with each further thread: buffers of three copies of OpenBLAS, 214 MiB by the same measurement."""
MAPPED_MIB = 1800.0
"""Address space of a fruit's process beyond the memory that it holds: 3,050 MiB of VmPeak at 1,350 MiB."""
IN_WORDS = re.compile(
    r"failed to map segment|cannot allocate memory|memory allocation.* failed|bad_alloc|out of memory"
    r"|unable to allocate",
    re.IGNORECASE,
)
"""How native libraries report a lack of memory."""
MIB = 2**20
"""Bytes of a mebibyte."""


def numerical_threads() -> int:
    """Threads that OpenBLAS begins when it is loaded."""
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        if os.environ.get(name, "").isdecimal() and int(os.environ[name]) > 0:
            return int(os.environ[name])
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def limit_MiB() -> float | None:
    """Address space that a process may have; None: no limit."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return None if limit == resource.RLIM_INFINITY else limit / MIB


def lacking(need_MiB: float, *, threads: int) -> str:
    """Why a process with so many threads cannot work within the limit, as a sentence; empty where it can."""
    limit, need_MiB = limit_MiB(), need_MiB + (threads - 1) * PER_THREAD_MIB
    if limit is None or limit >= need_MiB:
        return ""
    fewer = ", or set OPENBLAS_NUM_THREADS=1 to need less" if threads > 1 else ""
    return (
        f"not enough memory: the limit of address space (ulimit -v) is {limit:.0f} MiB, but drupe "
        f"needs about {need_MiB:.0f} MiB; raise the limit{fewer}."
    )


def too_little_memory(free_MiB: float | None = None) -> str:
    """A lack of memory that was met, as a sentence. `free_MiB`: what is free now; None: not known."""
    threads = numerical_threads()
    if said := lacking(GRADING_MIB, threads=threads):
        return said
    free = "" if free_MiB is None else f"{free_MiB:.0f} MiB are free; "
    need_MiB = GRADING_MIB + (threads - 1) * PER_THREAD_MIB
    return (
        f"not enough memory: {free}grading needs about {need_MiB:.0f} MiB of address space, and up to "
        "1500 MiB per fruit; close other programs, or raise the limit (ulimit -v, ulimit -d, "
        "container)."
    )


def is_lack_of_memory(error: BaseException | None) -> bool:
    """Whether an error, or one that it was raised from, is a lack of memory, whichever library met it.

    An error that happens while a lack of memory is handled (`__context__`) is a fault of its own.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or IN_WORDS.search(str(error)):
            return True
        error = error.__cause__
    return False
