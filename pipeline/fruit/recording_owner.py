"""Whose recording it is: the fruit and the category that a recording names, compared with its folder's."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.batch.layout import BatchFolder
from pipeline.batch.records import FruitRecord
from pipeline.files.plain_file import printable
from pipeline.fruit.input_doubts import DOUBTED
from recon.pit.priors import known_categories
from tactile.consistency.finding import E_OF_ANOTHER_FRUIT, Finding, FindingKind
from tactile.tactile_failure import TactileFailure, TactileProblem


def refuse_copy(source: str, first: str | None) -> None:
    """Raises TactileFailure (repeated-recording) if `first`, of the same fruit, has the same contents."""
    if first is not None:
        raise TactileFailure(
            TactileProblem.REPEATED_RECORDING,
            f"{source}: contains the same displacements and forces as {first}, so drupe counts one "
            "grasp; remove one of the two, or replace it by the intended grasp.",
        )


def in_two_fruit(source: str, others: Iterable[str]) -> str:
    """The sentence about a recording that files of other fruit hold too."""
    return (
        f"{source}: contains the same displacements and forces as {', '.join(others)}. At least one "
        "of these fruit has another fruit's recording; remove it from the wrong folder."
    )


def copies_doubted(records: Sequence[FruitRecord], folder: BatchFolder) -> list[FruitRecord]:
    """The records, with E in doubt if another fruit's has the same displacements and forces in a recording
    that is used. Nobody can say whose it is, and moduli of one lot differ by E_OF_ANOTHER_FRUIT. Doubts of an
    earlier run about copies are replaced.
    """
    holders: Mapping[str, list[tuple[str, str]]] = defaultdict(list)
    for record in records:
        for grasp in record.grasps if record.graded else ():
            if grasp.digest and grasp.failure is None:
                holders[grasp.digest].append((record.fruit_id, grasp.grasp))
    return [_doubted(record, holders, folder) for record in records]


def _doubted(
    record: FruitRecord, holders: Mapping[str, list[tuple[str, str]]], folder: BatchFolder
) -> FruitRecord:
    """The record with a doubt for every recording that another fruit of the batch has too."""
    used = [grasp for grasp in record.grasps if grasp.failure is None]
    said = []
    for grasp in used if record.graded else ():
        others = [holder for holder in holders.get(grasp.digest, ()) if holder[0] != record.fruit_id]
        if others:
            said.append(in_two_fruit(grasp.grasp, (_file(folder, *other) for other in others)))
    marked = record.with_doubts("copied", said)
    if not said or record.modulus is None:
        return marked
    sd_MPa = E_OF_ANOTHER_FRUIT * len(said) / len(used) * record.modulus.E_MPa
    modulus = record.modulus.widened(DOUBTED, sd_MPa, shared=False)
    return marked.model_copy(update={"modulus": modulus})


def _file(folder: BatchFolder, fruit_id: str, grasp: str) -> str:
    """The file that a fruit's grasp was read from, as its place in the batch."""
    files = folder.fruit(fruit_id).recordings_by_name()
    path = next((path for name, path in files.items() if printable(name) == grasp), Path(grasp))
    return f"fruits/{fruit_id}/grasps/{printable(path.name)}"


NOT_SAID = frozenset({"", "unknown"})
"""Values of a recording that names no fruit or no category; `drupe convert` writes "unknown" if it is given
neither."""


@dataclass(frozen=True, kw_only=True)
class Owner:
    """The fruit in whose folder a recording lies.

    `batch_fruits`: every fruit_id of its batch; None without a batch, so that ids cannot be compared.
    `category`: None if recordings may name any, as those of a reference body may.
    """

    fruit_id: str
    category: str | None = None
    batch_fruits: Collection[str] | None = None


def stranger(named: str, owner: Owner) -> str | None:
    """The fruit that a recording names, if it is not its owner; None if it is, or if it names none.

    A fruit of the batch is returned by its own id, however the recording spells it.

    >>> owner = Owner(fruit_id="N02", batch_fruits=("N02", "N04"))
    >>> stranger("n-4", owner), stranger("N77", owner), stranger("n2 ", owner), stranger("", owner)
    ('N04', 'N77', None, None)
    """
    if owner.batch_fruits is None or named == owner.fruit_id or _plain(named) in NOT_SAID:
        return None
    row = named_row(named, owner.batch_fruits)
    return None if row == owner.fruit_id else row or named


def named_row(named: str, batch_fruits: Collection[str]) -> str | None:
    """The fruit of the batch that a recording names; None if it names none of them, or may name several.

    An exact match with an id of the batch counts first. Otherwise case, blanks and marks between letters and
    digits, and leading zeros are ignored, because spreadsheets and recorders change them.

    >>> named_row("2", ("02", "04")), named_row("2", ("02", "002")), named_row("02", ("02", "002"))
    ('02', None, '02')
    """
    if named in batch_fruits:
        return named
    same_id = [fruit for fruit in batch_fruits if _spelt_plainly(fruit) == _spelt_plainly(named)]
    return same_id[0] if len(same_id) == 1 else None


def owner_findings(named: str, category: str, owner: Owner, *, source: str, field: str) -> list[Finding]:
    """Doubts that a recording is its owner's: an id that the batch does not have, or another known category.

    `named`, `category`: the recording's values; `source`: its name; `field`: where it holds the id. Raises
    TactileFailure (foreign-recording) if it names another fruit of the batch.
    """
    other, findings = stranger(named, owner), []
    if other is not None:
        differs = f'{field}: found "{named}", expected "{owner.fruit_id}"'
        if other in (owner.batch_fruits or ()):
            raise TactileFailure(
                TactileProblem.FOREIGN_RECORDING,
                f"{source}: {differs}: the recording belongs to another fruit of this batch. Move the "
                f"file to fruits/{other}/grasps, or correct the {field} if the recording is of "
                f"{owner.fruit_id}.",
            )
        says = (
            f'{differs}, and fruits.csv has no "{named}". If the recording is of {owner.fruit_id}, '
            f"correct the {field}; otherwise remove the recording"
        )
        findings.append(_owner_doubt(FindingKind.OTHER_FRUIT, says, detail=other))
    if owner.category is not None and _both_known(category, owner.category):
        says = (
            f'category: found "{category}", expected "{owner.category}" as in batch.toml; correct the '
            "wrong one, or remove the recording if it is another fruit's"
        )
        findings.append(_owner_doubt(FindingKind.OTHER_CATEGORY, says, detail=category))
    return findings


def _owner_doubt(kind: FindingKind, says: str, *, detail: str) -> Finding:
    return Finding(kind=kind, says=says, detail=detail, relative_sd=E_OF_ANOTHER_FRUIT)


def _both_known(category: str, other: str) -> bool:
    """Whether these are two different categories of drupe; the user's own names may mean the same fruit."""
    names = {_plain(category), _plain(other)}
    return len(names) == 2 and names <= set(known_categories())


def _plain(text: str) -> str:
    return text.strip().casefold()


def _spelt_plainly(fruit_id: str) -> str:
    """An id without ignored differences: "n-7" of "N007" and of "N 7"."""
    apart = re.sub(r"(?<=[^\W\d_])(?=\d)|(?<=\d)(?=[^\W\d_])|[\s._-]+", "-", _plain(fruit_id))
    return re.sub(r"(?<!\d)0+(?=\d)", "", apart)
