"""Files that arrive in a batch's folder: which fruit are complete and unchanged, and what others lack."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import BatchFolder, FruitFolder

State = tuple[tuple[str, int, int], ...]
"""Path, size and modification time (ns) of files: two states of an unchanged file are equal."""
OWN = frozenset({".toml", ".json", ".stl", ".ply", ".obj", ".glb", ".onnx"})
"""Suffixes of files in the batch's own folder that may affect the result of every fruit. fruits.csv is not
among them, because a row affects its fruit alone."""
MOST_FILES = 200_000
"""Most files of one fruit that a scan reads: the limit of frames per pad (tactile.readers.pictures)."""
DESCRIPTION = "grasp.toml"
"""A folder of frames counts as a grasp once it contains this file."""


@dataclass(frozen=True, kw_only=True)
class Arrival:
    """The state of a fruit's files; `missing`: the inputs that it lacks, in words (empty: none)."""

    state: State
    missing: str

    @property
    def last_change_ns(self) -> int:
        """Time of the last change of a file, ns; 0 without files."""
        return max((changed for _, _, changed in self.state), default=0)


def arrival(folder: FruitFolder, row: FruitRow) -> Arrival:
    """The present files of a fruit's folder. A fruit is complete with a shape and one recording."""
    recorded = bool(folder.grasp_files()) or any(
        (place / DESCRIPTION).is_file() for place in folder.raw_grasp_folders()
    )
    shaped = folder.fruit_ply.is_file() or bool(folder.photo_files()) or any(row.diameters)
    lacks = []
    if not shaped and not (recorded and folder.without_shape()):
        lacks.append("photos or fruit.ply")
    if not recorded:
        lacks.append("a recording in grasps/")
    return Arrival(state=state_of(islice(_files(folder), MOST_FILES)), missing=" and ".join(lacks))


@dataclass(kw_only=True)
class Arrivals:
    """The files of a batch's fruit at the last scan.

    `settle_s`: seconds without a change after which a fruit's files are at rest; `clock` in seconds.
    """

    settle_s: float
    clock: Callable[[], float]
    of: dict[str, Arrival] = field(default_factory=dict)
    """Fruit with at least one file, by id."""
    expected: int = 0
    """Number of fruit without a file."""
    since: dict[str, tuple[State, float]] = field(default_factory=dict)
    """State of each fruit's files, and the clock at their last change."""

    def look(self, folder: BatchFolder, rows: Sequence[FruitRow]) -> tuple[FruitRow, ...]:
        """Scans the folders of all `rows`; returns the rows of complete fruit."""
        arrivals = dict[str, Arrival]()
        for row in rows:
            name = row.fruit_id
            fruit_arrival = arrival(folder.fruit(name), row)
            if not fruit_arrival.state:
                continue
            arrivals[name] = fruit_arrival
            if self.since.get(name, ((), 0.0))[0] != fruit_arrival.state:
                self.since[name] = fruit_arrival.state, self.clock()
        self.of, self.expected = arrivals, len(rows) - len(arrivals)
        return tuple(row for row in rows if row.fruit_id in self.of and not self.of[row.fruit_id].missing)

    def at_rest(self, name: str) -> bool:
        """Whether a fruit's files are unchanged for `settle_s`."""
        return self.clock() - self.since[name][1] >= self.settle_s

    @property
    def lacking(self) -> tuple[tuple[str, str], ...]:
        """Fruit with incomplete files, and the inputs that they lack."""
        return tuple(
            (name, fruit_arrival.missing) for name, fruit_arrival in self.of.items() if fruit_arrival.missing
        )


def own_state(folder: BatchFolder) -> State:
    """The state of the batch's own files: settings, mat, and files beside them that settings may name."""
    return state_of(path for path in folder.root.iterdir() if path.suffix.lower() in OWN and path.is_file())


def state_of(files: Iterator[Path]) -> State:
    """The state of the files; skips files that vanish before it reads them."""
    states = []
    for path in files:
        try:
            at = path.stat()
        except OSError:
            continue
        states.append((str(path), at.st_size, at.st_mtime_ns))
    return tuple(sorted(states))


def _files(fruit: FruitFolder) -> Iterator[Path]:
    """Files that may be inputs of a fruit: in its folder, its subfolders and raw grasps (folders of frames).
    Each of these folders may be a link, and so may a folder in a raw grasp. Follows no other links.
    """
    for place in (fruit.root, fruit.photos, fruit.photos_flipped, fruit.grasps):
        yield from _inside(place)
    for grasp in fruit.raw_grasp_folders():
        if grasp.is_symlink() and not (grasp / DESCRIPTION).is_file():  # the link may lead to a whole disk
            continue
        for folder, folders, names in os.walk(grasp):
            yield from (Path(folder, name) for name in names)
            inner = (Path(folder, name) for name in folders)
            yield from (path for place in inner if place.is_symlink() for path in _inside(place))


def _inside(place: Path) -> list[Path]:
    """The files directly in a folder; empty if it is missing or unreadable."""
    try:
        with os.scandir(place) as entries:
            return [Path(entry.path) for entry in entries if not entry.is_dir()]
    except OSError:
        return []
