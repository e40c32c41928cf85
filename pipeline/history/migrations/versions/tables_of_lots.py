"""The tables of lots, grippers, sensors, revisions, fruit, grasps and conversions."""

from alembic import op

revision = "lot_tables"
down_revision = None

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


def upgrade() -> None:
    """Creates them."""
    for statement in STATEMENTS:
        op.execute(statement)
