"""A store's batches and conversions as rows of the tables, and back; every row is checked by its SHA-256."""

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, FromClause, TableClause, delete, insert, select

from pipeline.history.history_store import DamagedRow, HistoryStore
from pipeline.history.lot_tables import (
    CONVERSION,
    CONVERSION_KEY,
    FRUIT,
    GRASP,
    GRIPPER,
    KEY,
    LOT,
    REVISION,
    SENSOR,
    WHOLE,
)
from pipeline.history.revisions import KeptBatch, KeptRow, canonical
from pipeline.history.scale_conversion import ScaleConversion

JSON_COLUMNS = ("limits", "listed", "columns")
DESCRIBED = (LOT, GRIPPER, SENSOR)
_NOT_CONTENT = {
    "batch",
    "revision",
    "graded_utc",
    "sha256",
    "id",
    "position",
    *(f"{t.name}_id" for t in DESCRIBED),
}
"""Columns that a row's content, the fields of StoredBatch or StoredFruit, does not have."""
Cells = dict[str, Any]


def digest(*cells: object) -> str:
    """SHA-256 of cells as text."""
    return hashlib.sha256(json.dumps([str(cell) for cell in cells]).encode()).hexdigest()


def read_store(connection: Connection, path: Path | None) -> HistoryStore:
    """All sound rows, the others in `damaged`. Raises sqlalchemy.exc.DatabaseError."""
    stored, by_batch = HistoryStore(path=path), defaultdict[str, list[KeptRow]](list)
    digests = []
    for cells, grasps in _rows(connection):
        batch, fruit_id, revision = (cells.get(name, "") for name in KEY)
        digests.append(str(cells["sha256"]))
        content = _content(cells, grasps)
        if content and cells["sha256"] == digest(
            "row", batch, fruit_id, revision, cells["graded_utc"], content
        ):
            row = KeptRow(
                fruit_id=fruit_id, revision=revision, graded_utc=cells["graded_utc"], content=content
            )
            by_batch[batch].append(row)
        else:
            what = f"fruit {fruit_id}, revision {revision}" if fruit_id else f"revision {revision}"
            stored.damaged.append(DamagedRow(str(batch), str(fruit_id), f"batch {batch}, {what}"))
    for batch, rows in by_batch.items():
        if any(not row.fruit_id for row in rows):
            stored.kept[batch] = KeptBatch(key=batch, rows=tuple(rows))
    for line in connection.execute(select(CONVERSION)):
        cells = dict(line._mapping)
        digests.append(str(sha256 := cells.pop("sha256")))
        if sha256 == _conversion_digest(cells):
            stored.add_conversion(ScaleConversion(**cells))
        else:
            named = f"{cells['scale']}@{cells['version']} of {cells['group']}"
            words = f"the conversion {named} is damaged (its SHA-256 is another)"
            stored.damaged.append(DamagedRow("", "", words))
    whole = connection.execute(select(WHOLE)).scalars().all()
    if not stored.damaged and whole != [_whole(digests)]:
        words = "lacks rows that were written, or has others (the SHA-256 of all rows is another)"
        stored.damaged.append(DamagedRow("", "", words))
    return stored


def write_store(connection: Connection, stored: HistoryStore) -> None:
    """Adds the rows that the database lacks, and removes those that were forgotten."""
    wanted = {
        (key, row.fruit_id, row.revision): row for key, kept in stored.kept.items() for row in kept.rows
    }
    known = {tuple(cells.get(name, "") for name in KEY) for cells, _ in _rows(connection)}
    for batch, fruit_id, revision in known - wanted.keys():
        for table in (GRASP, FRUIT) if fruit_id else (REVISION,):
            cells = dict(zip(KEY, (batch, fruit_id, revision), strict=True))
            named = [table.c[name] == cells[name] for name in KEY if name in table.c]
            connection.execute(delete(table).where(*named))
    for key in sorted(wanted.keys() - known, key=lambda key: (key[2], key[0], key[1])):
        _add_row(connection, key[0], wanted[key])
    fitted = {
        tuple(line) for line in connection.execute(select(*(CONVERSION.c[name] for name in CONVERSION_KEY)))
    }
    for fit_key, fit in stored.fitted.items():
        if fit_key not in fitted:
            cells = asdict(fit)
            connection.execute(insert(CONVERSION).values({**cells, "sha256": _conversion_digest(cells)}))
    for table in DESCRIBED:
        used = select(REVISION.c[f"{table.name}_id"]).where(REVISION.c[f"{table.name}_id"].is_not(None))
        connection.execute(delete(table).where(table.c.id.not_in(used)))
    digests = [
        line for table in (REVISION, FRUIT, CONVERSION) for line in connection.scalars(select(table.c.sha256))
    ]
    connection.execute(delete(WHOLE))
    connection.execute(insert(WHOLE).values(sha256=_whole(digests)))


def _rows(connection: Connection) -> list[tuple[Cells, list[Cells]]]:
    """Rows of revisions with what describes them, then of fruit with their grasps."""
    described: FromClause = REVISION
    for table in DESCRIBED:
        described = described.outerjoin(table, REVISION.c[f"{table.name}_id"] == table.c.id)
    columns = [*REVISION.c, *(column for table in DESCRIBED for column in table.c if column.name != "id")]
    revisions = connection.execute(select(*columns).select_from(described)).mappings()
    grasps = defaultdict[tuple[Any, ...], list[Cells]](list)
    for grasp in connection.execute(select(GRASP).order_by(GRASP.c.position)).mappings():
        grasps[tuple(grasp[name] for name in KEY)].append(dict(grasp))
    fruit = [dict(row) for row in connection.execute(select(FRUIT)).mappings()]
    return [
        *((dict(row), []) for row in revisions),
        *((row, grasps[tuple(row[name] for name in KEY)]) for row in fruit),
    ]


def _content(cells: Cells, grasps: list[Cells]) -> str:
    """A row's fields as it was written; empty where it cannot have been."""
    if "fruit_id" in cells and cells["E_MPa"] is None:
        return canonical(None)
    try:
        fields = {
            name: json.loads(cell) if name in JSON_COLUMNS and cell else cell for name, cell in cells.items()
        }
        fields["grasps"] = [_without_keys(grasp, {"fruit_id"}) for grasp in grasps]
        return canonical(_without_keys(fields, set()))
    except (TypeError, ValueError):
        return ""


def _without_keys(cells: Cells, also: set[str]) -> Cells:
    return {name: cell for name, cell in cells.items() if name not in _NOT_CONTENT | also}


def _add_row(connection: Connection, batch: str, row: KeptRow) -> None:
    fields = row.fields
    table = FRUIT if row.fruit_id else REVISION
    cells = {
        name: json.dumps(cell) if name in JSON_COLUMNS else cell
        for name, cell in fields.items()
        if name in table.c
    }
    cells |= {"batch": batch, "revision": row.revision, "graded_utc": row.graded_utc}
    cells["sha256"] = digest("row", batch, row.fruit_id, row.revision, row.graded_utc, row.content)
    if table is REVISION:
        cells |= {f"{t.name}_id": _described_id(connection, t, fields) for t in DESCRIBED}
    else:
        cells["fruit_id"] = row.fruit_id
    connection.execute(insert(table).values(cells))
    for position, grasp in enumerate(fields.get("grasps", ())):
        key = {name: cells[name] for name in KEY}
        connection.execute(insert(GRASP).values({**key, "position": position, **grasp}))


def _described_id(connection: Connection, table: TableClause, fields: Mapping[str, Any]) -> int | None:
    """Of the table's row that says the same, made where there is none; None where nothing is said."""
    cells = {column.name: fields.get(column.name, "") for column in table.c if column.name != "id"}
    if not any(cells.values()):
        return None
    known = select(table.c.id).where(*(table.c[name] == cell for name, cell in cells.items()))
    if (found_id := connection.execute(known).scalar()) is not None:
        return int(found_id)
    return int(connection.execute(insert(table).values(cells)).lastrowid)


def _conversion_digest(cells: Mapping[str, Any]) -> str:
    key = [cells[name] for name in CONVERSION_KEY]
    return digest("conversion", *key, canonical(dict(cells)))


def _whole(digests: list[str]) -> str:
    return digest("whole", *sorted(digests))
