"""The number of fruit that fit into the free memory at once."""

PER_FRUIT_MIB = {"photos": 1500.0, "mesh": 1000.0, "traces": 600.0}
"""Peak of one fruit's process (`peak_memory_MiB` in record.json), plus a tenth: 1.3 GiB for 36 photos, 0.89
GiB for ready meshes, 542 MiB for force-displacement curves."""
LEAST_MIB = 750.0
"""Below it no fruit begins. The smallest fruit, a ball without a recording, peaks at 732 MiB, mostly
libraries (`benchmarks/campaign_kills.py`, `peak_memory_MiB` in record.json)."""

KEPT_FREE = 0.1
"""Share of the free memory that no fruit gets: the command itself and other programs grow. Set by hand."""


def jobs_that_fit(jobs: int, *, per_fruit_MiB: float, free_MiB: float) -> int:
    """How many fruit memory holds at once: at least 1, at most `jobs`."""
    return max(1, min(jobs, int(free_MiB // per_fruit_MiB)))


def share_MiB(jobs: int, per_fruit_MiB: float, *, free_MiB: float) -> float:
    """Memory limit of each of `jobs` fruit: its share of the free memory less KEPT_FREE, but at least what a
    fruit needs.
    """
    return max(per_fruit_MiB, (1.0 - KEPT_FREE) * free_MiB / jobs)
