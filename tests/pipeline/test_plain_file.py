"""Two rooms that never import each other read files by the same rules."""

import inspect
import time
import tomllib

import pytest

import recon.limited_memory
import recon.plain_file
import tactile.io.limited_process
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


@pytest.mark.parametrize("name", ["limited_memory", "_Blocks", "_limit", "_set_limit", "_addresses_in_use"])
def test_so_is_the_limit_on_memory(name):
    both = (recon.limited_memory, tactile.io.limited_process)
    theirs, ours = (inspect.getsource(getattr(room, name)) for room in both)
    assert theirs == ours


def test_so_are_the_limits():
    for name in ("DEEPEST", "_TOML_TOKEN", "_KINDS"):
        assert getattr(recon.plain_file, name) == getattr(tactile.io.named_file, name)


DEEP = (
    '"!".' * 20 + "a = 1",
    "'!' . " * 20 + "a = 1",
    "a-1.\t" * 20 + "a = 1",
    "[" + '"\\"".' * 20 + "a]",
    "[[" + "'='." * 20 + "a]]",
    "a = { " + '"!".' * 20 + "a = 1 }",
    'a = [1.5, "]", { x.y = 1, ' + "a." * 20 + "b = 1 }]",
    'a = """\n"" \\""" ""\n"""\n' + "a." * 20 + "b = 1",
    "a = '''\n'' \\'''\n" + "a." * 20 + "b = 1",
    "# a.b\n\n" + "a." * 20 + "b = 1",
)
"""TOML with a key of 21 parts."""
SHALLOW = (
    "# " + "a." * 90,
    'a = "' + "a." * 90 + '"',
    "a = '" + "a." * 90 + "'",
    'a = """\n' + "a." * 90 + '\n" "" \\""" ' + "a." * 90 + '"""""',
    "a = '''\n" + '"a".' * 90 + "'''''",
    "a = [" + "1.5, " * 90 + "]",
    "a = ['" + "x', '." * 90 + "']",
    "\n".join(f"a{k}.b.c = 1.5" for k in range(90)),
    "a." * 19 + "b = 1",
    '"' + "." * 90 + '" = 1',
)
"""TOML with many dots and a key of 20 parts at most."""


@pytest.mark.parametrize("text", DEEP)
def test_a_key_of_21_parts_is_refused_wherever_it_is_and_its_line_is_named(text):
    for room, fault in ((recon.plain_file, "NotReadable"), (tactile.io.named_file, "FileNotReadable")):
        line = text.count("\n") + 1
        with pytest.raises(getattr(room, fault), match=f"line {line} holds a key of more than 20 parts"):
            room.toml_of(text)


@pytest.mark.parametrize("text", SHALLOW)
def test_other_dots_are_read_as_the_standard_library_reads_them(text):
    for room in (recon.plain_file, tactile.io.named_file):
        assert room.toml_of(text) == tomllib.loads(text)


@pytest.mark.parametrize(
    "part", ['"', "'", "'''", '"""', '\\"""', "a.", '"a".', "a.\n", "[", "#", ". ", '"\\', "a.b=1\n"]
)
def test_the_search_for_deep_keys_takes_time_in_proportion_to_the_text(part):
    """300 kB in 2 s; with the square of the text it would be hours."""
    for before in ("", '"""', "'''"):
        began = time.process_time()
        recon.plain_file._line_of_deep_key(before + part * (300_000 // len(part)))
        assert time.process_time() - began < 2
