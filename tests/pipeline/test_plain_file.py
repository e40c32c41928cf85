"""Dotted keys of TOML: those of too many parts are refused before the reader sees them."""

import time
import tomllib

import pytest

from pipeline.files.plain_file import NotReadable, _line_of_deep_key, toml_of

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
    line = text.count("\n") + 1
    with pytest.raises(NotReadable, match=f"line {line} holds a key of more than 20 parts"):
        toml_of(text)


@pytest.mark.parametrize("text", SHALLOW)
def test_other_dots_are_read_as_the_standard_library_reads_them(text):
    assert toml_of(text) == tomllib.loads(text)


@pytest.mark.parametrize(
    "part", ['"', "'", "'''", '"""', '\\"""', "a.", '"a".', "a.\n", "[", "#", ". ", '"\\', "a.b=1\n"]
)
def test_the_search_for_deep_keys_takes_time_in_proportion_to_the_text(part):
    """300 kB in 2 s; with the square of the text it would be hours."""
    for before in ("", '"""', "'''"):
        began = time.process_time()
        _line_of_deep_key(before + part * (300_000 // len(part)))
        assert time.process_time() - began < 2
