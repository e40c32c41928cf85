"""The tables of results, fruit and grasps."""

from alembic import op

revision = "result_tables"
down_revision = None

FRUIT = (
    "id INTEGER NOT NULL PRIMARY KEY, result INTEGER NOT NULL REFERENCES result (id), "
    "fruit_id VARCHAR NOT NULL"
)
STATEMENTS = (
    "CREATE TABLE result (id INTEGER NOT NULL PRIMARY KEY, batch VARCHAR NOT NULL, revision INTEGER NOT "
    "NULL, graded_utc VARCHAR NOT NULL, category VARCHAR NOT NULL, cultivar VARCHAR, lot VARCHAR, "
    "orchard VARCHAR, operator VARCHAR, gripper VARCHAR, gripper_serial VARCHAR, sensor VARCHAR, "
    "sensor_serial VARCHAR, calibration VARCHAR, calibrated_on DATE, folder VARCHAR, measured DATE NOT NULL, "
    'dated BOOLEAN, harvest DATE, "temperature_C" FLOAT, limits JSON, lost JSON, listed JSON, '
    "sha256 VARCHAR NOT NULL)",
    f'CREATE TABLE fruit ({FRUIT}, "E_MPa" FLOAT, "E_sd_MPa" FLOAT, "E_known_MPa" FLOAT, "E_known_sd_MPa" '
    'FLOAT, shore_oo FLOAT, "penetrometer_N" FLOAT, doubted BOOLEAN, columns JSON)',
    f'CREATE TABLE grasp ({FRUIT}, grasp VARCHAR, recording VARCHAR, "E_MPa" FLOAT, "E_sd_MPa" FLOAT, '
    '"peak_force_N" FLOAT)',
)


def upgrade() -> None:
    """Creates the tables."""
    for statement in STATEMENTS:
        op.execute(statement)
