"""Whether results that are read belong to a batch that the store knows: its own, graded again."""

from pipeline.history.stored_batch import StoredBatch, StoredFruit


def is_same_batch(one: StoredBatch, other: StoredBatch) -> bool:
    """Whether both are results of one batch. Either

    - a fruit of the same id has a recording in both (fruit added, another lot name or folder of results), or
    - all recordings of a fruit are those of one of another id in the other (a fruit renamed), or
    - folder, day and label are the same, and a fruit id (recordings that were calibrated again), or
    - the folder is the same and a fruit's E to the last digit, where one of both kept no recordings.
    """
    pairs = _common(one, other)
    if (
        any({*a.recordings} & {*b.recordings} for a, b in pairs)
        or _renamed(one, other)
        or _renamed(other, one)
    ):
        return True
    if one.folder != other.folder:
        return False
    if one.measured == other.measured and one.label == other.label:
        return bool(pairs or {*one.lost, *_ids(one)} & {*other.lost, *_ids(other)})
    return any(
        (a.E_MPa, a.E_sd_MPa) == (b.E_MPa, b.E_sd_MPa)
        for a, b in pairs
        if not (a.recordings and b.recordings)
    )


def _common(one: StoredBatch, other: StoredBatch) -> list[tuple[StoredFruit, StoredFruit]]:
    """Fruit of the same id, but no reference bodies: these are in many batches."""
    by_id = {fruit.fruit_id: fruit for fruit in other.fruit if fruit.E_known_MPa is None}
    return [
        (fruit, by_id[fruit.fruit_id])
        for fruit in one.fruit
        if fruit.E_known_MPa is None and fruit.fruit_id in by_id
    ]


def _renamed(one: StoredBatch, other: StoredBatch) -> bool:
    """Whether all recordings of a fruit of `one`, no reference body, are those of a fruit of `other`."""
    return any(
        {*a.recordings} <= {*b.recordings}
        for a in one.fruit
        for b in other.fruit
        if a.recordings and a.E_known_MPa is None and b.E_known_MPa is None
    )


def _ids(batch: StoredBatch) -> set[str]:
    return {fruit.fruit_id for fruit in batch.fruit}
