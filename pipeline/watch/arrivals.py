"""What has arrived in the folder of a batch: which fruit are whole and at rest, and what others lack."""

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.layout import BatchFolder, FruitFolder

State = tuple[tuple[str, int, int], ...]
"""Name, size and time of last change (ns) of files: what differs between two moments has changed."""
OWN = frozenset({".toml", ".json", ".stl", ".ply", ".obj", ".glb", ".onnx"})
"""Kinds of files in the batch's own folder on which the result of every fruit may depend. Of fruits.csv it
depends on the fruit's own row alone."""
MOST_FILES = 200_000
"""Files of one fruit that a look goes through: as many as the frames that are read of one pad."""
DESCRIPTION = "grasp.toml"
"""The file without which a folder of frames is no grasp yet."""


@dataclass(frozen=True, kw_only=True)
class Arrival:
    """The files of one fruit's folder, and what it still lacks (empty: nothing)."""

    state: State
    missing: str

    @property
    def last_change_ns(self) -> int:
        """When a file of it changed last; 0 where there is none."""
        return max((changed for _, _, changed in self.state), default=0)


def arrival(folder: FruitFolder, row: FruitRow) -> Arrival:
    """What lies in a fruit's folder now. A fruit is whole with a shape and one recording."""
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
    """What lies in the folders of a batch's fruit, look by look.

    `settle_s`: seconds without a change after which a fruit's files are at rest; `clock` in seconds.
    """

    settle_s: float
    clock: Callable[[], float]
    of: dict[str, Arrival] = field(default_factory=dict)
    """The fruit that have any files."""
    expected: int = 0
    """Fruit that have none yet."""
    since: dict[str, tuple[State, float]] = field(default_factory=dict)
    """Files of each fruit, and since when they are so."""

    def look(self, folder: BatchFolder, rows: Sequence[FruitRow]) -> tuple[FruitRow, ...]:
        """Looks into the folders of all `rows`; the rows of fruit that lack nothing."""
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
        """Whether a fruit's files have been as they are for long enough."""
        return self.clock() - self.since[name][1] >= self.settle_s

    @property
    def lacking(self) -> tuple[tuple[str, str], ...]:
        """Fruit that have files, but not all that grading needs, and what they lack."""
        return tuple(
            (name, fruit_arrival.missing) for name, fruit_arrival in self.of.items() if fruit_arrival.missing
        )


def own_state(folder: BatchFolder) -> State:
    """Of the batch's own files: settings, mat, and what may be named in the settings beside them."""
    return state_of(path for path in folder.root.iterdir() if path.suffix.lower() in OWN and path.is_file())


def state_of(files: Iterator[Path]) -> State:
    """Of files that may vanish meanwhile."""
    states = []
    for path in files:
        try:
            at = path.stat()
        except OSError:
            continue
        states.append((str(path), at.st_size, at.st_mtime_ns))
    return tuple(sorted(states))


def _files(fruit: FruitFolder) -> Iterator[Path]:
    """Files that may be inputs of a fruit: those in its folder, in its parts, and in grasps that are folders
    of frames. Any of these may be a link, and so may a folder of frames in a grasp; no other is followed.
    """
    for place in (fruit.root, fruit.photos, fruit.photos_flipped, fruit.grasps):
        yield from _inside(place)
    for grasp in fruit.raw_grasp_folders():
        if grasp.is_symlink() and not (grasp / DESCRIPTION).is_file():  # it may lead to a whole disk
            continue
        for folder, folders, names in os.walk(grasp):
            yield from (Path(folder, name) for name in names)
            inner = (Path(folder, name) for name in folders)
            yield from (path for place in inner if place.is_symlink() for path in _inside(place))


def _inside(place: Path) -> list[Path]:
    """What a folder holds but for folders; nothing where it is gone or cannot be read."""
    try:
        with os.scandir(place) as entries:
            return [Path(entry.path) for entry in entries if not entry.is_dir()]
    except OSError:
        return []
