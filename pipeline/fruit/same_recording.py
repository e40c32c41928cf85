"""One recording in two places: within a fruit it counts once; of two fruit, one has the other's."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pipeline.batch.layout import BatchFolder
from pipeline.batch.records import FruitRecord
from pipeline.files.plain_file import printable
from pipeline.fruit.input_doubts import DOUBTED
from tactile.consistency.finding import E_OF_ANOTHER_FRUIT
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
