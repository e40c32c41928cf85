"""Whose results a folder holds: those of one batch are not replaced by another's.

A folder of results belongs to the batch whose photos and recordings it is of: one of them must be the same.
Where all were replaced, folder, label and the id of a fruit must be the same. Ids alone do not tell: many
people number their fruit from 1 every day.
"""

from collections.abc import Mapping
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


def batch_folder(batch: Batch) -> str:
    """The batch's folder, as batch.json names it: absolute, links followed."""
    return str(batch.folder.root.resolve())


def require_same_batch(results: Results, batch: Batch, inputs: Mapping[str, str], option: str) -> None:
    """Raises BatchRefused where `results` holds those of another batch than this one, whose files have the
    hashes `inputs` (by path inside the batch).
    """
    said = read_provenance(results)
    former_inputs, settings, outcomes = (
        _table((said or {}).get(name)) for name in ("inputs", "settings", "outcomes")
    )
    measured = _measured(former_inputs)
    if not measured or measured & _measured(inputs):
        return
    folder, now = str((said or {}).get("batch", "")), batch.settings.model_dump(mode="json")
    same_label = all(str(settings.get(name)) == str(now.get(name)) for name in LABEL)
    if folder == batch_folder(batch) and same_label and outcomes.keys() & batch.row_of.keys():
        return
    fruit = printable(listed(sorted(outcomes), SHOWN))
    sentence = (
        f"holds the results of another batch in {printable(folder)} (fruit {fruit}), with other photos and "
        f"recordings. They are not replaced; choose another folder with {option}, or move this one away."
    )
    raise refused(results.root, sentence)


def _measured(inputs: Mapping[str, Any]) -> set[str]:
    """SHA-256 of the fruit's photos and recordings."""
    paths = ((PurePosixPath(name), str(digest)) for name, digest in inputs.items())
    return {
        digest
        for path, digest in paths
        if len(path.parts) > 2
        and path.parts[0] == "fruits"
        and path.suffix.lower() not in SHARED_KINDS
        and path.stem != "reference"
        and " " not in digest  # a file that could not be read
    }


def _table(value: object) -> Mapping[str, Any]:
    return {str(name): entry for name, entry in value.items()} if isinstance(value, dict) else {}
