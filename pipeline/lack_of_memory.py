"""Recognises a lack of memory, whichever library reports it."""

import re

IN_WORDS = re.compile(
    r"failed to map segment|cannot allocate memory|memory allocation.* failed|bad_alloc|out of memory"
    r"|unable to allocate",
    re.IGNORECASE,
)
"""The wording by which native libraries report a lack of memory."""


def too_little_memory(free_MiB: float | None = None) -> str:
    """The message on a lack of memory. `free_MiB`: memory that is free now; None: unknown."""
    free = "" if free_MiB is None else f"{free_MiB:.0f} MiB are free; "
    return (
        f"not enough memory: {free}grading needs about 2200 MiB of address space, and up to 1500 MiB per "
        "fruit; close other programs, or raise the limit (ulimit -v, ulimit -d, container)."
    )


def is_lack_of_memory(error: BaseException | None) -> bool:
    """Whether an error, or one of its causes (`__cause__`), is a lack of memory.

    An error that occurs while a lack of memory is handled (`__context__`) is a separate fault.
    """
    seen: set[int] = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, MemoryError) or IN_WORDS.search(str(error)):
            return True
        error = error.__cause__
    return False
