"""Whose results a folder holds: those of one batch are not replaced by another's.

A folder of results belongs to the batch whose photos and recordings it is of: one of them must be the same.
Where all were replaced, folder, label and the id of a fruit must be the same. Ids alone do not tell: many
people number their fruit from 1 every day.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from pipeline.batch.layout import Results
from pipeline.batch.opening import Batch
from pipeline.batch.provenance import read_provenance
from pipeline.files.plain_file import printable
from pipeline.problem import listed, refused

LABEL = ("lot", "harvest_date", "cultivar", "category")
"""Settings by which people tell batches apart."""
SHARED_KINDS = frozenset({".toml", ".json", ".csv", ".ply"})
"""Files that different batches may have alike byte by byte: descriptions of sensors, protocols of the
gripper, the mould of a cast body. Photos and recordings are of one fruit."""
SHOWN = 3
"""Ids that a sentence names."""


@dataclass(frozen=True, kw_only=True)
class BatchIdentity:
    """What tells a batch from others: its folder ("" where not known), its label, its fruit, and SHA-256 of
    their photos and recordings.
    """

    folder: str
    label: tuple[str, ...]
    fruit: frozenset[str]
    measured: frozenset[str]


def identity(batch: Batch, inputs: Mapping[str, str]) -> BatchIdentity:
    """Of the batch whose files have the hashes `inputs` (by path inside the batch)."""
    return _identity(
        batch_folder(batch),
        batch.settings.model_dump(mode="json"),
        inputs,
        (row.fruit_id for row in batch.rows),
    )


def batch_folder(batch: Batch) -> str:
    """The batch's folder, as batch.json names it: absolute, links followed."""
    return str(batch.folder.root.resolve())


def require_same_batch(results: Results, batch: BatchIdentity, option: str) -> None:
    """Raises BatchRefused where `results` holds those of another batch."""
    former = former_batch(results)
    if former is None or not former.measured or former.measured & batch.measured:
        return
    if (former.folder, former.label) == (batch.folder, batch.label) and former.fruit & batch.fruit:
        return
    where = f" in {printable(former.folder)}" if former.folder else ""
    sentence = (
        f"holds the results of another batch{where} ({_listed(former.fruit)}), with other photos and "
        f"recordings. They are not replaced; choose another folder with {option}, or move this one away."
    )
    raise refused(results.root, sentence)


def former_batch(results: Results) -> BatchIdentity | None:
    """The batch whose results these are; None where there are none, or none that can be read."""
    if (said := read_provenance(results)) is None:
        return None
    folder = said.get("batch")
    settings, inputs, outcomes = (_table(said.get(name)) for name in ("settings", "inputs", "outcomes"))
    return _identity(folder if isinstance(folder, str) else "", settings, inputs, outcomes)


def _identity(
    folder: str, settings: Mapping[str, Any], inputs: Mapping[str, Any], fruit: Iterable[str]
) -> BatchIdentity:
    """By what one batch is known from another: folder, label, fruit and the digests of what was measured."""
    digests = {
        path: str(digest)
        for name, digest in inputs.items()
        if len((path := PurePosixPath(name)).parts) > 2 and path.parts[0] == "fruits"
    }
    return BatchIdentity(
        folder=folder,
        label=tuple(str(settings.get(name)) for name in LABEL),
        fruit=frozenset({*fruit, *(path.parts[1] for path in digests)}),
        measured=frozenset(
            digest
            for path, digest in digests.items()
            if path.suffix.lower() not in SHARED_KINDS and path.stem != "reference" and " " not in digest
        ),
    )


def _table(value: object) -> Mapping[str, Any]:
    return {str(name): entry for name, entry in value.items()} if isinstance(value, dict) else {}


def _listed(fruit: frozenset[str]) -> str:
    return f"fruit {printable(listed(sorted(fruit), SHOWN))}"
