"""A store's batches and conversions as rows of the tables, and back; every row is checked by its SHA-256.

The steps in `migrations/versions` define the tables; a column holds the field of its name. `revision`,
`fruit` and `conversion` have the SHA-256 of all that a row says, rows that it refers to included; `whole` has
the SHA-256 of all those, by which a lost row is noticed. Days are ISO 8601 text, as SQLite has them.
"""

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, FromClause, MetaData, Table, delete, insert, select

from pipeline.history.history_store import DamagedRow, HistoryStore
from pipeline.history.revisions import KeptBatch, KeptRow, canonical
from pipeline.history.scale_conversion import ScaleConversion

KEY = ("batch", "fruit_id", "revision")
"""Of fruit; a batch has no `fruit_id`."""
CONVERSION_KEY = ("scale", "group", "version")
JSON_COLUMNS = ("limits", "listed", "columns")
DESCRIBED = ("lot", "gripper", "sensor")
"""Tables that a revision refers to."""
_OF_THE_ROW = ("batch", "revision", "graded_utc", "sha256", "id", "position")
_NOT_CONTENT = {*_OF_THE_ROW, *(f"{name}_id" for name in DESCRIBED)}
"""Columns that a row's content, the fields of StoredBatch or StoredFruit, does not have."""
Cells = dict[str, Any]
Tables = Mapping[str, Table]


def digest(*cells: object) -> str:
    """SHA-256 of cells as text."""
    return hashlib.sha256(json.dumps([str(cell) for cell in cells]).encode()).hexdigest()


def read_store(connection: Connection, path: Path | None) -> HistoryStore:
    """All sound rows, the others in `damaged`. Raises sqlalchemy.exc.DatabaseError."""
    stored, by_batch = HistoryStore(path=path), defaultdict[str, list[KeptRow]](list)
    tables, digests = _tables(connection), []
    for cells, grasps in _rows(connection, tables):
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
    for line in connection.execute(select(tables["conversion"])):
        cells = dict(line._mapping)
        digests.append(str(sha256 := cells.pop("sha256")))
        if sha256 == _conversion_digest(cells):
            stored.add_conversion(ScaleConversion(**cells))
        else:
            named = f"{cells['scale']}@{cells['version']} of {cells['group']}"
            words = f"the conversion {named} is damaged (its SHA-256 is another)"
            stored.damaged.append(DamagedRow("", "", words))
    whole = connection.execute(select(tables["whole"])).scalars().all()
    if not stored.damaged and whole != [_whole(digests)]:
        words = "lacks rows that were written, or has others (the SHA-256 of all rows is another)"
        stored.damaged.append(DamagedRow("", "", words))
    return stored


def write_store(connection: Connection, stored: HistoryStore) -> None:
    """Adds the rows that the database lacks, and removes those that were forgotten."""
    tables = _tables(connection)
    wanted = {
        (key, row.fruit_id, row.revision): row for key, kept in stored.kept.items() for row in kept.rows
    }
    known = {tuple(cells.get(name, "") for name in KEY) for cells, _ in _rows(connection, tables)}
    for batch, fruit_id, revision in known - wanted.keys():
        for table in (tables["grasp"], tables["fruit"]) if fruit_id else (tables["revision"],):
            cells = dict(zip(KEY, (batch, fruit_id, revision), strict=True))
            named = [table.c[name] == cells[name] for name in KEY if name in table.c]
            connection.execute(delete(table).where(*named))
    for key in sorted(wanted.keys() - known, key=lambda key: (key[2], key[0], key[1])):
        _add_row(connection, tables, key[0], wanted[key])
    conversion, revision = tables["conversion"], tables["revision"]
    keys = select(*(conversion.c[name] for name in CONVERSION_KEY))
    fitted = {tuple(line) for line in connection.execute(keys)}
    for fit_key, fit in stored.fitted.items():
        if fit_key not in fitted:
            cells = asdict(fit)
            connection.execute(insert(conversion).values({**cells, "sha256": _conversion_digest(cells)}))
    for name in DESCRIBED:
        used = select(revision.c[f"{name}_id"]).where(revision.c[f"{name}_id"].is_not(None))
        connection.execute(delete(tables[name]).where(tables[name].c.id.not_in(used)))
    hashed = (revision, tables["fruit"], conversion)
    digests = [line for table in hashed for line in connection.scalars(select(table.c.sha256))]
    connection.execute(delete(tables["whole"]))
    connection.execute(insert(tables["whole"]).values(sha256=_whole(digests)))


def _tables(connection: Connection) -> Tables:
    """The tables by name, as they are in the database."""
    metadata = MetaData()
    metadata.reflect(connection)
    return metadata.tables


def _rows(connection: Connection, tables: Tables) -> list[tuple[Cells, list[Cells]]]:
    """Rows of revisions with what describes them, then of fruit with their grasps."""
    revision, grasp_table = tables["revision"], tables["grasp"]
    described: FromClause = revision
    for name in DESCRIBED:
        described = described.outerjoin(tables[name], revision.c[f"{name}_id"] == tables[name].c.id)
    columns = [
        *revision.c,
        *(column for name in DESCRIBED for column in tables[name].c if column.name != "id"),
    ]
    revisions = connection.execute(select(*columns).select_from(described)).mappings()
    grasps = defaultdict[tuple[Any, ...], list[Cells]](list)
    for grasp in connection.execute(select(grasp_table).order_by(grasp_table.c.position)).mappings():
        grasps[tuple(grasp[name] for name in KEY)].append(dict(grasp))
    fruit = [dict(row) for row in connection.execute(select(tables["fruit"])).mappings()]
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


def _add_row(connection: Connection, tables: Tables, batch: str, row: KeptRow) -> None:
    fields = row.fields
    table = tables["fruit" if row.fruit_id else "revision"]
    cells = {
        name: json.dumps(cell) if name in JSON_COLUMNS else cell
        for name, cell in fields.items()
        if name in table.c
    }
    cells |= {"batch": batch, "revision": row.revision, "graded_utc": row.graded_utc}
    cells["sha256"] = digest("row", batch, row.fruit_id, row.revision, row.graded_utc, row.content)
    if row.fruit_id:
        cells["fruit_id"] = row.fruit_id
    else:
        cells |= {f"{name}_id": _described_id(connection, tables[name], fields) for name in DESCRIBED}
    connection.execute(insert(table).values(cells))
    for position, grasp in enumerate(fields.get("grasps", ())):
        key = {name: cells[name] for name in KEY}
        connection.execute(insert(tables["grasp"]).values({**key, "position": position, **grasp}))


def _described_id(connection: Connection, table: Table, fields: Mapping[str, Any]) -> int | None:
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
