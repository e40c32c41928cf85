"""Later results of a batch, each with the number of fruit that then count; names of lots and their cells."""

from dataclasses import replace
from datetime import timedelta

from pipeline.history.stored_batch import StoredBatch


def _named(batch, new_id):
    fruit = tuple(replace(each, fruit_id=new_id(each.fruit_id)) for each in batch.fruit)
    return replace(batch, fruit=fruit, listed=tuple(map(new_id, batch.listed)))


def _with_a_fruit_more(batch):
    more = replace(batch.fruit[0], fruit_id="one-more", recordings=("of its own",))
    return replace(batch, fruit=(*batch.fruit, more), listed=(*batch.listed, "one-more"))


def _recalibrated(batch):
    fruit = (replace(f, E_MPa=1.1 * f.E_MPa, recordings=(f"anew {f.fruit_id}",)) for f in batch.fruit)
    return replace(batch, fruit=tuple(fruit))


def _first_renamed(batch):
    first = batch.fruit[0].fruit_id
    return _named(batch, lambda name: "renamed" if name == first else name)


REVISIONS = {
    "graded again": (lambda batch: batch, lambda n: n),
    "a fruit added": (_with_a_fruit_more, lambda n: n + 1),
    "recordings recalibrated": (_recalibrated, lambda n: n),
    "lot corrected": (lambda batch: replace(batch, lot=f"{batch.lot} corrected"), lambda n: n),
    "a fruit renamed": (_first_renamed, lambda n: n),
    "all fruit renamed": (lambda batch: _named(batch, lambda name: f"B-{name}"), lambda n: n),
    "a fruit removed": (lambda b: replace(b, fruit=b.fruit[1:], listed=b.listed[1:]), lambda n: n),
    "another day": (
        lambda batch: replace(_recalibrated(batch), measured=batch.measured + timedelta(2)),
        lambda n: 2 * n,
    ),
}
"""By name, the later results of a batch and how many fruit then count, of so many at first."""
LOTS = {
    ";=cmd|' /C calc'!A0": ";'=cmd|' /C calc'!A0",
    "=cmd|' /C calc'!A0": "'=cmd|' /C calc'!A0",
    "7;=cmd|' /C calc'!A0": "7;'=cmd|' /C calc'!A0",
    "7, -1+cmd|' /C calc'!A0": "7,' -1+cmd|' /C calc'!A0",
    "offset (0.1, -0.3) mm": "offset (0.1, -0.3) mm",
    "lot A,-7": "lot A,-7",
}
"""Names of lots, each with its cell in tables."""


def revised(batch: StoredBatch, revision: str) -> tuple[StoredBatch, int]:
    """The batch graded again later with that revision, and how many fruit should then count."""
    revise, expected = REVISIONS[revision]
    later = replace(revise(batch), key="later", graded_utc=f"{batch.graded_utc[:4]}-12-31T23:59:59Z")
    return later, expected(len(batch.fruit))
