"""Memory: what the machine has free, a limit for native libraries, and the return of freed memory."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Lock


def free_memory_MiB(proc: Path = Path("/proc"), groups: Path = Path("/sys/fs/cgroup")) -> float | None:
    """Available memory in MiB: the machine's, or less if a container or control group has a limit.

    None if the system does not report it.
    """
    left_bytes = [*_of_machine(proc / "meminfo"), *_of_groups(proc / "self" / "cgroup", groups)]
    return min(left_bytes) / 2**20 if left_bytes else None


def _of_machine(meminfo: Path) -> Iterator[float]:
    try:
        lines = meminfo.read_text().splitlines()
    except OSError:
        return
    fields = {line.split(":")[0]: line.split()[1] for line in lines if len(line.split()) > 1}
    if "MemAvailable" in fields:
        yield float(fields["MemAvailable"]) * 2**10


def _of_groups(cgroup_file: Path, groups: Path) -> Iterator[float]:
    """Memory left in each control group around this process (versions 2 and 1); file cache counts as free."""
    try:
        lines = cgroup_file.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, kinds, path = line.split(":", 2)
        if kinds == "" or "memory" in kinds.split(","):
            root = groups if kinds == "" else groups / "memory"
            place = root / path.lstrip("/")
            for folder in (place, *place.parents):
                if not folder.is_relative_to(root):
                    break
                yield from _left(folder, "memory.max", "memory.current", "")
                yield from _left(folder, "memory.limit_in_bytes", "memory.usage_in_bytes", "total_")


def _left(folder: Path, limit: str, usage: str, prefix: str) -> Iterator[float]:
    """What a limit leaves, bytes; the system drops cached files when a process needs the memory."""
    try:
        most, used = (folder / limit).read_text().strip(), float((folder / usage).read_text())
        counters = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
    except (OSError, ValueError):
        return
    if most.isdigit() and int(most) < 2**60:
        cached = sum(float(counters.get(f"{prefix}{kind}_file", 0)) for kind in ("active", "inactive"))
        yield max(0.0, int(most) - used + cached)


try:
    import resource
except ModuleNotFoundError:
    resource = None  # type: ignore[assignment]

_USER = "user"
_limits: dict[object, int] = {}
"""Soft limits in bytes of address space: the user's (_USER), and that of each open block, in any thread."""
_changing = Lock()


@contextmanager
def limited_memory(most_bytes: int) -> Iterator[None]:
    """Inside the block this process can allocate at most `most_bytes` more; a larger request raises an error.

    The limit is on the address space (RLIMIT_AS) of the whole process, so its other threads have it too. The
    tightest of the open blocks holds. A forked process starts without its parent's blocks. Only Linux reports
    the address space in use; elsewhere there is no limit.
    """
    if resource is None or sys.platform != "linux":
        yield
        return
    block, most = object(), _addresses_in_use() + most_bytes
    try:
        with _changing:
            if len(_limits) <= 1:
                _limits[_USER] = resource.getrlimit(resource.RLIMIT_AS)[0]
            _limits[block] = most
            _set_tightest()
        yield
    finally:
        with _changing:
            if _limits.pop(block, None) is not None:
                _set_tightest()


def _set_tightest() -> None:
    finite = [most for most in _limits.values() if most != resource.RLIM_INFINITY]
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (min(finite, default=resource.RLIM_INFINITY), hard))


def _forget_blocks() -> None:
    """In a forked process: its parent's threads, which would end the blocks, do not exist here."""
    try:
        if len(_limits) > 1:
            user = _limits[_USER]
            _limits.clear()
            _limits[_USER] = user
            _set_tightest()
    finally:
        _changing.release()


if sys.platform != "win32":
    os.register_at_fork(
        before=_changing.acquire, after_in_parent=_changing.release, after_in_child=_forget_blocks
    )


def _addresses_in_use() -> int:
    """Size of this process's address space in bytes, from /proc (Linux)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * os.sysconf("SC_PAGE_SIZE")


def return_freed_memory() -> None:
    """Returns freed memory to the system (Linux): after photos, glibc keeps some 400 MiB of it."""
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
