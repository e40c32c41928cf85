"""Two rooms that never import each other read files by the same rules."""

import inspect

import pytest

import recon.plain_file
import tactile.io.named_file

SHARED = [
    name
    for name, one in inspect.getmembers(tactile.io.named_file, inspect.isfunction)
    if one.__module__ == tactile.io.named_file.__name__
]


def test_the_rules_are_shared_but_for_json_which_only_one_room_reads():
    theirs = {
        name
        for name, one in inspect.getmembers(recon.plain_file, inspect.isfunction)
        if one.__module__ == recon.plain_file.__name__
    }
    assert theirs - set(SHARED) == {"json_of"}


@pytest.mark.parametrize("name", SHARED)
def test_a_rule_is_the_same_in_both_rooms(name):
    theirs = inspect.getsource(getattr(tactile.io.named_file, name))
    ours = inspect.getsource(getattr(recon.plain_file, name))
    assert theirs.replace("FileNotReadable", "NotReadable") == ours


def test_so_are_the_limits():
    for name in ("DEEPEST", "_LONG_KEY", "_KINDS"):
        assert getattr(recon.plain_file, name) == getattr(tactile.io.named_file, name)
