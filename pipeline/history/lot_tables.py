"""The tables of a store: lots, grippers and sensors, and every revision of batches, fruit and their grasps.

`revision`, `fruit` and `conversion` have the SHA-256 of all that a row says, rows that it refers to included;
`whole` has the SHA-256 of all those, by which a lost row is noticed. Days are ISO 8601 text, as SQLite has
them. Columns in JSON: `limits`, `listed` and `columns`. A change here needs a step in `migrations/versions`.
"""

from sqlalchemy import (
    Boolean,
    Column,
    Float,
    ForeignKey,
    ForeignKeyConstraint,
    Integer,
    MetaData,
    String,
    Table,
    UniqueConstraint,
)

TABLES = MetaData()


def _described(name: str, *columns: str) -> Table:
    """A table of what batches have in common, each row once."""
    texts = [Column(column, String, nullable=False) for column in columns]
    return Table(name, TABLES, Column("id", Integer, primary_key=True), *texts, UniqueConstraint(*columns))


LOT = _described("lot", "category", "cultivar", "lot", "orchard")
GRIPPER = _described("gripper", "gripper", "gripper_serial")
SENSOR = _described("sensor", "sensor", "sensor_serial", "calibration", "calibrated_on")
REVISION = Table(
    "revision",
    TABLES,
    Column("batch", String, primary_key=True),
    Column("revision", Integer, primary_key=True),
    Column("graded_utc", String, nullable=False),
    *(Column(f"{table.name}_id", ForeignKey(table.c.id)) for table in (LOT, GRIPPER, SENSOR)),
    *(Column(name, String) for name in ("folder", "measured", "harvest", "operator", "limits", "listed")),
    Column("dated", Boolean),
    Column("temperature_C", Float),
    Column("sha256", String, nullable=False),
)
"""A batch as it was after each revision."""
FRUIT = Table(
    "fruit",
    TABLES,
    Column("batch", String, primary_key=True),
    Column("fruit_id", String, primary_key=True),
    Column("revision", Integer, primary_key=True),
    Column("graded_utc", String, nullable=False),
    *(Column(name, Float) for name in ("E_MPa", "E_sd_MPa", "E_known_MPa", "E_known_sd_MPa")),
    *(Column(name, Float) for name in ("shore_oo", "penetrometer_N")),
    Column("doubted", Boolean),
    Column("columns", String),
    Column("sha256", String, nullable=False),
    ForeignKeyConstraint(["batch", "revision"], ["revision.batch", "revision.revision"]),
)
"""Results of fruit; `E_MPa` is null of a fruit that was not graded."""
GRASP = Table(
    "grasp",
    TABLES,
    Column("batch", String, primary_key=True),
    Column("fruit_id", String, primary_key=True),
    Column("revision", Integer, primary_key=True),
    Column("position", Integer, primary_key=True),
    *(Column(name, String) for name in ("grasp", "recording")),
    *(Column(name, Float) for name in ("E_MPa", "E_sd_MPa", "peak_force_N")),
    ForeignKeyConstraint(
        ["batch", "fruit_id", "revision"], ["fruit.batch", "fruit.fruit_id", "fruit.revision"]
    ),
)
CONVERSION = Table(
    "conversion",
    TABLES,
    Column("scale", String, primary_key=True),
    Column("group", String, primary_key=True),
    Column("version", Integer, primary_key=True),
    Column("fitted_utc", String),
    Column("fruit", Integer),
    *(Column(name, Float) for name in ("intercept", "slope", "slope_sd", "residual_sd", "mean_ln_E")),
    *(Column(name, Float) for name in ("squares", "E_low_MPa", "E_high_MPa")),
    Column("sha256", String, nullable=False),
)
WHOLE = Table("whole", TABLES, Column("sha256", String, nullable=False))
