"""The fruit_ids of a batch, as the process of one fruit knows them: read where one asks, few do."""

import json
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from pipeline.batch.layout import Results, write_whole
from pipeline.files.manifest import json_in

FORMAT = "drupe-run"


class BatchFruits(Collection[str]):
    """Every fruit_id of a batch; sent to another process as the place of the list that `write_run` wrote.

    A task that held them all would make n tasks of n ids.
    """

    def __init__(self, fruit_ids: Iterable[str], *, listed: Path) -> None:
        self._listed = listed
        self._known: frozenset[str] | None = frozenset(fruit_ids)

    def __contains__(self, fruit_id: object) -> bool:
        return fruit_id in self._all()

    def __iter__(self) -> Iterator[str]:
        return iter(self._all())

    def __len__(self) -> int:
        return len(self._all())

    def __getstate__(self) -> Path:
        return self._listed

    def __setstate__(self, listed: Path) -> None:
        self._listed, self._known = listed, None

    def _all(self) -> frozenset[str]:
        if self._known is None:
            said = json_in(self._listed)
            if not is_run(said):
                raise FileNotFoundError(f"{self._listed}: the run's list of fruit is missing or damaged.")
            self._known = frozenset(map(str, said["fruits"]))
        return self._known


def write_run(results: Results, fruit_ids: Iterable[str], *, mark: str) -> None:
    """Lists the fruit of a run, and its mark, by which another machine knows that it sees the same folder.

    Raises NotWritten.
    """
    content = {"format": FORMAT, "version": 1, "mark": mark, "fruits": sorted(fruit_ids)}
    write_whole(results.run, json.dumps(content) + "\n")


def is_run(said: Any) -> bool:
    """Whether this is what `write_run` wrote."""
    return isinstance(said, dict) and said.get("format") == FORMAT and isinstance(said.get("fruits"), list)
