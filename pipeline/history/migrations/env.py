"""Alembic's entry point: runs the migrations on the connection of `pipeline.history.lot_database`."""

from alembic import context

context.configure(connection=context.config.attributes["connection"])
context.run_migrations()
