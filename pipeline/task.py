"""What the process that grades one fruit is told."""

from dataclasses import dataclass
from pathlib import Path

from pipeline.config import Settings
from pipeline.layout import FruitFolder, FruitResults
from pipeline.records import Given
from recon.mat import Mat
from recon.priors import PitPrior


@dataclass(frozen=True, kw_only=True)
class FruitTask:
    """All that one fruit's process is told."""

    fruit_id: str
    folder: FruitFolder
    batch_root: Path
    results: FruitResults
    settings: Settings
    mat: Mat | None
    prior: PitPrior | None
    given: Given
    key: str
