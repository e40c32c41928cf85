"""Every command of `drupe` has a file of its own, and the reference's table names each."""

from pathlib import Path

import pytest

from pipeline.cli import app

ROOT = Path(__file__).parents[2]


def test_a_command_is_a_file_of_its_name():
    places = {c.callback.__name__: c.callback.__module__ for c in app.registered_commands}
    assert places
    assert places == {name: f"pipeline.commands.{name}" for name in places}


def test_the_reference_has_a_row_for_every_command():
    reference = (ROOT / "docs" / "reference" / "command-line.md").read_text(encoding="utf-8")
    rows = [line for line in reference.splitlines() if line.startswith("| `drupe ")]
    commands = {c.callback.__name__ for c in app.registered_commands}
    groups = {group.name for group in app.registered_groups}
    assert {row.split()[2].strip("`") for row in rows} == commands | groups


def test_a_group_of_commands_is_a_file_of_its_name():
    places = {
        group.name: {c.callback.__module__ for c in group.typer_instance.registered_commands}
        for group in app.registered_groups
    }
    assert places == {name: {f"pipeline.commands.{name}"} for name in places}


def test_every_command_states_its_exit_statuses_and_that_of_an_interruption():
    grouped = [c for group in app.registered_groups for c in group.typer_instance.registered_commands]
    for command in (*app.registered_commands, *grouped):
        statuses = " ".join(command.callback.__doc__.partition("Exit status")[2].split())
        for status in ("0 ", "1 ", "2 ", "130 "):
            assert f" {status}" in statuses, command.callback.__name__


@pytest.mark.parametrize("arguments", [("mat", "--paper", "a3"), ("convert", "a", "b", "--indenter", "a3")])
def test_a_wrong_choice_is_told_with_the_choices_alone(drupe, arguments):
    assert f"'{arguments[-2]}': 'a3' is not one of '" in drupe(*arguments, status=2).err
