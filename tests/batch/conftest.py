"""Batches that a test may break."""

import shutil
from pathlib import Path

import pytest
from sample_batches import ready_batch


@pytest.fixture(scope="session")
def _pristine(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return ready_batch(tmp_path_factory.mktemp("pristine") / "batch", 3)


@pytest.fixture
def batch(_pristine: Path, tmp_path: Path) -> Path:
    """A batch of three ready fruit that a test may break."""
    return Path(shutil.copytree(_pristine, tmp_path / "batch"))
