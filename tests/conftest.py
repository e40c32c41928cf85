"""Array shapes and dtypes that functions declare are checked in the first calls of each test.

The hook holds for what this process imports; workers that tests start as processes of their own are not
checked.
"""

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import array_annotations  # the hook's checks, while their folder is on the path
import jaxtyping
import pytest
import scipy.linalg  # noqa: F401  # loads the libraries of linear algebra, whose threads are limited below
from jaxtyping import config, install_import_hook
from threadpoolctl import threadpool_limits

sys.path.remove(str(Path(__file__).parent))  # else tests/recon could be imported as the room of that name
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # else every process that tests start compiles all modules
threadpool_limits(1)  # numpy and scipy: two workers share two cores
os.fsync = lambda _: None  # type: ignore[assignment]  # no test cuts the power, and a disk takes 3 ms for it
if "PYTEST_XDIST_WORKER" in os.environ:
    gc.disable()  # while modules are imported: pipeline.safe_start.uncollected says why
ROOT = Path(__file__).parents[1]
CHECKED = ("fem", "recon", "reports", "samples", "tactile", "pipeline", "drupe")
"""The rooms, all of whose modules are checked."""


def modules_with_arrays() -> list[str]:
    """Names of the modules in CHECKED that import jaxtyping."""
    paths = [path for folder in CHECKED for path in sorted((ROOT / folder).rglob("*.py"))]
    return [
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for path in paths
        if "from jaxtyping import" in path.read_text(encoding="utf-8")
    ]


jaxtyping.jaxtyped = array_annotations.first_calls_with_arrays(jaxtyping.jaxtyped)
install_import_hook(modules_with_arrays(), "array_annotations.check")


def pytest_addoption(parser: pytest.Parser) -> None:
    """How many broken inputs `tests/batch/test_campaign.py` leaves out."""
    parser.addoption("--every", type=int, default=15, help="run every N-th broken input (default 15)")


def pytest_collection_finish() -> None:
    """Garbage is looked for from now on, less often than by default (700, 10, 10): modules stay, and are many
    objects. Set by hand; without looking for it at all four files of tests took 0 to 6 % less.
    """
    gc.enable()
    gc.set_threshold(10_000, 20, 20)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Every test checks the first calls of each function again."""
    array_annotations.CALLS.clear()


@pytest.fixture
def unchecked_shapes() -> Iterator[None]:
    """For tests of a function's own refusal of arrays that its annotation forbids."""
    config.update("jaxtyping_disable", True)
    yield
    config.update("jaxtyping_disable", False)
