"""`drupe new --like`: what a new batch takes from an earlier one."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.batch.layout import BatchFolder
from pipeline.batch.opening import own_files
from pipeline.batch.settings import Settings, read_settings
from pipeline.files.toml_text import as_toml
from recon.learned.onnx_file import model_files

OF_THE_DAY = frozenset(
    {"harvest_date", "lot", "measured_on", "mismatch", "notes", "pulp_temperature_C", "temperature"}
)
"""Settings of the earlier day. Confirmed effects are of its fruit, or of its sensors on that day.
[temperature] needs the new day's temperature; `left_out` names it."""


@dataclass(frozen=True, kw_only=True)
class EarlierBatch:
    """The settings of the batch in `root`, for another day."""

    root: Path
    settings: Settings

    def written(self, named: dict[str, str]) -> str:
        """batch.toml with `named` (category, lot, cultivar) in place of the earlier day's."""
        kept = self.settings.model_dump(mode="json", exclude_unset=True, exclude=set(OF_THE_DAY))
        head = f"# Settings of {self.root.resolve().name}, by drupe new --like. All keys: docs/formats.md\n\n"
        return head + as_toml({**kept, **named})

    def _named_files(self) -> Iterator[Path]:
        """The mat, and the files inside the batch that the settings name, by their names there."""
        folder = BatchFolder(self.root)
        files = [folder.mat, *own_files(folder, self.settings)]
        if (model := self.settings.recon.geometry_model) is not None:
            files += model_files(self.root / model)
        return (
            path
            for path in files
            if path.is_file() and path.is_relative_to(self.root) and ".." not in path.parts
        )

    def _leaves(self, path: Path) -> bool:
        """Whether links lead out of the batch: what lies there may be no part of it."""
        return not path.resolve().is_relative_to(self.root.resolve())

    def copy_files(self, batch: Path) -> None:
        """Copies those files, but for links that lead out of the batch. Raises OSError."""
        for path in self._named_files():
            if not self._leaves(path):
                target = batch / path.relative_to(self.root)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)

    def left_out(self, batch: Path) -> Iterator[str]:
        """What staff must look at in the new batch."""
        settings = self.settings
        if settings.pulp_temperature_C is not None or settings.temperature is not None:
            table = settings.temperature
            again = "" if table is None else f", and again [temperature] {_in_a_line(table.model_dump())}"
            yield f"pulp_temperature_C: write that of the new day into batch.toml{again}"
        if settings.mismatch:
            names = ", ".join(sorted({effect.effect for effect in settings.mismatch}))
            yield f"confirmed effects ({names}): drupe copies none; run `drupe explain` on the new fruit"
        for path in filter(self._leaves, self._named_files()):
            yield f"{path}: is a link to a file outside {self.root}, which drupe does not copy"
        for name in (settings.category, settings.pit.prior, settings.rig):
            if name and (".." in Path(name).parts or Path(name).is_absolute()):
                place = (batch / name).resolve()
                if place != (self.root / name).resolve():
                    yield f"{name}: lies outside {self.root} and now means {place}; correct it in batch.toml"


def earlier_batch(root: Path) -> EarlierBatch:
    """The batch in `root`; raises BatchRefused where its settings cannot be read."""
    return EarlierBatch(root=root, settings=read_settings(BatchFolder(root).settings))


def _in_a_line(table: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {number:g}" for name, number in table.items())
