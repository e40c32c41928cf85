"""Free memory of the machine, a container or a control group."""

from collections.abc import Iterator
from pathlib import Path


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
