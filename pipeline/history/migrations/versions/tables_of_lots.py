"""Tables of lots, grippers, sensors, revisions, fruit and grasps take the place of rows in JSON."""

import hashlib
import json
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "lot_tables"
down_revision = "json_rows"

KEY = "batch VARCHAR NOT NULL, fruit_id VARCHAR NOT NULL, revision INTEGER NOT NULL"
STATEMENTS = (
    "CREATE TABLE lot (id INTEGER NOT NULL PRIMARY KEY, category VARCHAR NOT NULL, cultivar VARCHAR NOT "
    "NULL, lot VARCHAR NOT NULL, orchard VARCHAR NOT NULL, UNIQUE (category, cultivar, lot, orchard))",
    "CREATE TABLE gripper (id INTEGER NOT NULL PRIMARY KEY, gripper VARCHAR NOT NULL, gripper_serial VARCHAR "
    "NOT NULL, UNIQUE (gripper, gripper_serial))",
    "CREATE TABLE sensor (id INTEGER NOT NULL PRIMARY KEY, sensor VARCHAR NOT NULL, sensor_serial VARCHAR "
    "NOT NULL, calibration VARCHAR NOT NULL, calibrated_on VARCHAR NOT NULL, "
    "UNIQUE (sensor, sensor_serial, calibration, calibrated_on))",
    "CREATE TABLE revision (batch VARCHAR NOT NULL, revision INTEGER NOT NULL, graded_utc VARCHAR NOT NULL, "
    "lot_id INTEGER REFERENCES lot (id), gripper_id INTEGER REFERENCES gripper (id), sensor_id INTEGER "
    "REFERENCES sensor (id), folder VARCHAR, measured VARCHAR, harvest VARCHAR, operator VARCHAR, limits "
    'VARCHAR, listed VARCHAR, dated BOOLEAN, "temperature_C" FLOAT, sha256 VARCHAR NOT NULL, '
    "PRIMARY KEY (batch, revision))",
    f'CREATE TABLE fruit ({KEY}, graded_utc VARCHAR NOT NULL, "E_MPa" FLOAT, "E_sd_MPa" FLOAT, '
    '"E_known_MPa" FLOAT, "E_known_sd_MPa" FLOAT, shore_oo FLOAT, "penetrometer_N" FLOAT, doubted BOOLEAN, '
    "columns VARCHAR, sha256 VARCHAR NOT NULL, PRIMARY KEY (batch, fruit_id, revision), "
    "FOREIGN KEY(batch, revision) REFERENCES revision (batch, revision))",
    f"CREATE TABLE grasp ({KEY}, position INTEGER NOT NULL, grasp VARCHAR, recording VARCHAR, "
    '"E_MPa" FLOAT, "E_sd_MPa" FLOAT, "peak_force_N" FLOAT, '
    "PRIMARY KEY (batch, fruit_id, revision, position), "
    "FOREIGN KEY(batch, fruit_id, revision) REFERENCES fruit (batch, fruit_id, revision))",
    'CREATE TABLE conversion (scale VARCHAR NOT NULL, "group" VARCHAR NOT NULL, version INTEGER NOT NULL, '
    "fitted_utc VARCHAR, fruit INTEGER, intercept FLOAT, slope FLOAT, slope_sd FLOAT, residual_sd FLOAT, "
    '"mean_ln_E" FLOAT, squares FLOAT, "E_low_MPa" FLOAT, "E_high_MPa" FLOAT, sha256 VARCHAR NOT NULL, '
    'PRIMARY KEY (scale, "group", version))',
    "CREATE TABLE whole (sha256 VARCHAR NOT NULL)",
)
FRUIT_COLUMNS = (
    "E_MPa",
    "E_sd_MPa",
    "E_known_MPa",
    "E_known_sd_MPa",
    "shore_oo",
    "penetrometer_N",
    "doubted",
)
REVISION_COLUMNS = ("folder", "measured", "harvest", "dated", "temperature_C")


def upgrade() -> None:
    """Creates the tables and moves all rows, whose SHA-256 the caller compared."""
    connection = op.get_bind()
    rows = connection.exec_driver_sql("SELECT batch, fruit, revision, graded, content FROM row").fetchall()
    conversions = connection.exec_driver_sql("SELECT content FROM conversion").fetchall()
    for table in ("row", "conversion", "whole"):
        op.drop_table(table)
    for statement in STATEMENTS:
        op.execute(statement)
    digests = []
    for batch, fruit_id, number, graded, text in sorted(rows, key=lambda row: row[1]):
        fields = json.loads(text)
        key = {"batch": batch, "revision": number, "graded_utc": graded}
        if fruit_id:
            digests.append(_add_fruit(connection, {**key, "fruit_id": fruit_id}, fields))
        else:
            digests.append(_add_revision(connection, key, fields))
    for (text,) in conversions:
        fit = json.loads(text)
        digest = _sha256("conversion", fit["scale"], fit["group"], fit["version"], _canonical(fit))
        digests.append(digest)
        _insert(connection, "conversion", {**fit, "sha256": digest})
    _insert(connection, "whole", {"sha256": _sha256("whole", *sorted(digests))})


def _add_revision(connection: sa.Connection, key: dict[str, Any], fields: dict[str, Any]) -> str:
    lot = {name: fields[name] for name in ("category", "cultivar", "lot")}
    known = connection.execute(
        sa.text("SELECT id FROM lot WHERE category = :category AND cultivar = :cultivar AND lot = :lot"), lot
    ).scalar()
    if known is None:
        _insert(connection, "lot", {**lot, "orchard": ""})
        known = connection.exec_driver_sql("SELECT last_insert_rowid()").scalar()
    digest = _sha256("row", key["batch"], "", key["revision"], key["graded_utc"], _canonical(fields))
    lists = {name: json.dumps(fields[name]) for name in ("limits", "listed") if fields[name]}
    cells = {name: fields[name] for name in REVISION_COLUMNS}
    _insert(connection, "revision", {**key, "lot_id": known, **cells, **lists, "sha256": digest})
    return digest


def _add_fruit(connection: sa.Connection, key: dict[str, Any], fields: dict[str, Any] | None) -> str:
    content, grasps = "null", []
    if fields is not None:
        grasps = [{"recording": recording} for recording in fields.pop("recordings")]
        content = _canonical({**fields, "grasps": grasps})
    digest = _sha256("row", key["batch"], key["fruit_id"], key["revision"], key["graded_utc"], content)
    cells = {name: fields[name] for name in FRUIT_COLUMNS} if fields else {}
    _insert(connection, "fruit", {**key, **cells, "sha256": digest})
    place = {name: key[name] for name in ("batch", "fruit_id", "revision")}
    for position, grasp in enumerate(grasps):
        _insert(connection, "grasp", {**place, "position": position, **grasp})
    return digest


def _insert(connection: sa.Connection, table: str, cells: dict[str, Any]) -> None:
    columns = ", ".join(f'"{name}"' for name in cells)
    places = ", ".join(f":{name}" for name in cells)
    connection.execute(sa.text(f"INSERT INTO {table} ({columns}) VALUES ({places})"), cells)


def _canonical(fields: dict[str, Any]) -> str:
    stated = {
        name: cell for name, cell in fields.items() if cell is not False and cell not in (None, "", [], {})
    }
    return json.dumps(stated, sort_keys=True)


def _sha256(*cells: object) -> str:
    return hashlib.sha256(json.dumps([str(cell) for cell in cells]).encode()).hexdigest()
