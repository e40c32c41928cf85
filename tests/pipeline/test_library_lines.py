"""Lines that a process adds to a file are read once, as they come, and the file does not grow for ever."""

import pytest

from pipeline.run.runner import MOST_BYTES, LinesOf


@pytest.fixture
def added(tmp_path):
    """A function that adds bytes to the file, and the reader of its lines."""
    lines = LinesOf(tmp_path / "log")

    def add(data):
        with lines.path.open("ab") as file:
            file.write(data)

    return add, lines


def test_whole_lines_are_read_once(added):
    add, lines = added
    assert lines.new() == []
    add(b"a\nb")
    assert lines.new() == ["a"]
    assert lines.new() == []
    add(b"c\r\n\xff\rd\n")
    assert lines.new() == ["bc", "\ufffd", "d"]


def test_what_was_read_is_not_read_again(added, monkeypatch):
    """After the first call the file's beginning may be anything."""
    add, lines = added
    add(b"first\n")
    assert lines.new() == ["first"]
    with lines.path.open("r+b") as file:
        file.write(b"\n\n\n\n\n\n")
    add(b"second\n")
    assert lines.new() == ["second"]


def test_of_much_the_last_is_read_and_the_file_is_emptied(added):
    add, lines = added
    add(b"x" * 3 * MOST_BYTES + b"\nlast\n")
    assert lines.new()[-1] == "last"
    assert lines.path.stat().st_size == 0
    add(b"next\n")
    assert lines.new() == ["next"]


def test_a_line_without_end_does_not_stay(added):
    add, lines = added
    for _ in range(8):
        add(b"x" * MOST_BYTES)
        assert lines.new() == []
        assert lines.path.stat().st_size <= 2 * MOST_BYTES
    add(b"\nlast\n")
    assert lines.new()[-1] == "last"
