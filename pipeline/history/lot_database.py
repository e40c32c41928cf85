"""The file of `drupe history --store`: an SQLite database with the tables of `migrations`.

The user names the file. drupe refuses other files and databases of other programs. Alembic migrates a store
of an earlier version to the present tables. drupe only adds results; `--forget` alone removes rows. A run
locks the database from reading to writing, and other runs wait.
"""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, create_engine, event
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.pool import NullPool

from pipeline.files.plain_file import not_plain
from pipeline.history.history_store import HistoryStore, read_store
from pipeline.problem import BatchRefused, Problem, refused

APPLICATION = 0x44525550
"""SQLite's application_id of a store: "DRUP" in ASCII."""
WAIT_S = 20.0
"""Seconds that a run waits for the lock of another run of drupe."""


@contextmanager
def history_store(
    path: Path | None, *, damaged_too: bool = False, read_only: bool = False
) -> Iterator[HistoryStore]:
    """Yields the store at `path`, new if there is none; in memory if `path` is None.

    The end of the block commits its changes, unless it raises or `read_only` is set. Raises BatchRefused for
    a file that is no store of drupe, not writable or damaged. `damaged_too` allows damaged batches, so that
    `forget` can remove them.
    """
    new = path is None or not path.exists() or path.stat().st_size == 0
    if path is not None and (why := _no_place(path)):
        raise _unfit(path, why)
    place = ":memory:" if path is None else path
    opened = partial(sqlite3.connect, place, timeout=WAIT_S, isolation_level=None)
    engine = create_engine("sqlite://", creator=opened, poolclass=NullPool)
    event.listen(engine, "begin", lambda connection: connection.exec_driver_sql("BEGIN IMMEDIATE"))
    try:
        with engine.connect() as connection:
            _bring_up_to_date(connection, path, new=new)
            stored = _checked_store(connection, path, damaged_too=damaged_too)
            yield stored
            if not read_only:
                connection.commit()
    except OperationalError as error:
        raise _unfit(path, f"is not writable ({error.orig})") from None
    except DatabaseError as error:
        raise _unfit(path, f"is damaged ({error.orig})") from None


def _unfit(path: Path | None, sentence: str) -> BatchRefused:
    return refused(str(path), f"{sentence}; name another file with --store.")


def _no_place(path: Path) -> str:
    """The reason why `path` cannot hold a store; empty if it can."""
    if not path.parent.is_dir():
        return f"cannot be written: there is no folder {path.parent}"
    if path.is_symlink():
        return "is a link, and drupe does not write through links; name the target file"
    if not path.exists():
        return ""
    if why := not_plain(path):
        return f"{why}, expected a file that drupe history made"
    if path.stat().st_size and path.read_bytes()[:16] != b"SQLite format 3\x00":
        return "is not a store of drupe history; drupe does not overwrite it"
    return ""


def _bring_up_to_date(connection: Connection, path: Path | None, *, new: bool) -> None:
    """Creates the present tables, or migrates those of an earlier version. Raises BatchRefused."""
    application = connection.exec_driver_sql("PRAGMA application_id").scalar()
    if new and application == 0:
        connection.exec_driver_sql(f"PRAGMA application_id = {APPLICATION}")
    elif application != APPLICATION:
        raise _unfit(path, "belongs to another program; drupe does not write to it")
    verdict = connection.exec_driver_sql("PRAGMA quick_check(1)").scalar()
    if verdict != "ok":
        raise _unfit(path, f"is damaged ({verdict})")
    config = Config()
    config.set_main_option("script_location", "pipeline.history:migrations")
    config.attributes["connection"] = connection
    script = ScriptDirectory.from_config(config)
    stands_at = MigrationContext.configure(connection).get_current_revision()
    if not new and stands_at is None:
        raise _unfit(
            path, "comes from a development version of drupe; create a new store from the results folders"
        )
    if not new and stands_at not in {step.revision for step in script.walk_revisions()}:
        raise _unfit(
            path, f'comes from another version of drupe (its tables are "{stands_at}"); update drupe'
        )
    if stands_at != script.get_current_head():
        command.upgrade(config, "head")


def _checked_store(connection: Connection, path: Path | None, *, damaged_too: bool) -> HistoryStore:
    """The store. Raises BatchRefused with a problem for each damaged batch and the option that removes it."""
    try:
        stored = read_store(connection, path)
    except (ValueError, TypeError, KeyError) as error:
        raise _unfit(path, f"is damaged ({type(error).__name__})") from None
    if stored.damaged and not damaged_too:
        raise BatchRefused(
            Problem(
                str(path),
                f"batch {name} is damaged (its SHA-256 differs); remove it with --forget {name}, then add "
                "its results folder again.",
            )
            for name in sorted(stored.damaged)
        )
    return stored
