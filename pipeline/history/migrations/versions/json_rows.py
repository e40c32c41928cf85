"""The tables of store version 2: a row per batch, fruit and revision, each with its content as JSON."""

from alembic import op

revision = "json_rows"
down_revision = None

STATEMENTS = (
    "CREATE TABLE row (batch TEXT, fruit TEXT, revision INTEGER, graded TEXT, content TEXT, sha256 TEXT, "
    "PRIMARY KEY (batch, fruit, revision))",
    "CREATE TABLE conversion (scale TEXT, cultivar TEXT, version INTEGER, content TEXT, sha256 TEXT, "
    "PRIMARY KEY (scale, cultivar, version))",
    "CREATE TABLE whole (sha256 TEXT)",
)


def upgrade() -> None:
    """Creates them."""
    for statement in STATEMENTS:
        op.execute(statement)
