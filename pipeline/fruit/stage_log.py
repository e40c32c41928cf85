"""Facts about a fruit while its stages run; a fruit that ends with a reason loses none of them."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from pipeline.batch.records import (
    FleshRecord,
    MeshRecord,
    ModulusRecord,
    PitRecord,
    PressedRecord,
    ScreenRecord,
)
from reports.grasp_record import GraspRecord


@dataclass
class FruitFacts:
    """Results of the stages so far, as in FruitRecord; None and empty: not known yet."""

    mesh: MeshRecord | None = None
    pit: PitRecord | None = None
    pressed: PressedRecord | None = None
    flesh: FleshRecord | None = None
    grasps: tuple[GraspRecord, ...] = ()
    modulus: ModulusRecord | None = None
    mismatch: str | None = None
    screen: ScreenRecord | None = None
    doubts: tuple[str, ...] = ()
    strangers: dict[str, bool] = field(default_factory=dict)


@dataclass
class StageLog:
    """Facts, warnings and times so far; `report` gets a message when a stage, the `current` one, begins, and
    on its progress: its name, a colon, and a line.
    """

    report: Callable[[str], None]
    facts: FruitFacts = field(default_factory=FruitFacts)
    warnings: list[str] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)
    current: str = ""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Reports that a stage begins, and keeps its duration."""
        self.report(name)
        self.current = name
        started = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(time.perf_counter() - started, 2)

    def progress(self, line: str) -> None:
        """Reports the progress of the present stage."""
        self.report(f"{self.current}: {line}")
