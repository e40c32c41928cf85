"""Alembic's entry point: runs the steps on the connection that `pipeline.history.lot_database` opened."""

from alembic import context

context.configure(connection=context.config.attributes["connection"])
context.run_migrations()
