"""Progress: fruit that are done, the stages of those at work, and the time left by the mean of all so far."""

import io

import pytest
from rich.console import Console

from pipeline.run.progress import BatchProgress


class Clock:
    """A clock that a test sets."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s


def ends(before=None, total=4):
    """What is said after fruit that end every 20 s."""
    clock, text = Clock(), io.StringIO()
    with BatchProgress(Console(file=text, width=200), total=total, before=before, clock=clock) as progress:
        for fruit in range(total):
            progress.stage(str(fruit), "mesh")
            clock.now_s += 20
            progress.done(str(fruit), "E = 1")
    return [line.split("E = 1 ")[1] for line in text.getvalue().splitlines() if "E = 1" in line]


def test_a_log_says_the_time_left_from_the_second_fruit_to_the_last_but_one():
    assert ends() == ["(1 of 4)", "(2 of 4, about 00:40 left)", "(3 of 4, about 00:20 left)", "(4 of 4)"]


def test_two_workers_share_the_fruit_that_are_left():
    clock, text = Clock(), io.StringIO()
    with BatchProgress(Console(file=text, width=200), total=6, clock=clock) as progress:
        progress.stage("0", "mesh")
        progress.stage("1", "mesh")
        for fruit in range(4):
            clock.now_s += 99 if fruit % 2 == 0 else 1  # fruit take 100 s, the second worker's 1 s later
            progress.done(str(fruit), "E = 1")
            progress.stage(str(fruit + 2), "mesh")
    notes = [line.split("E = 1 ")[1] for line in text.getvalue().splitlines() if "E = 1" in line]
    assert notes[0] == "(1 of 6)"
    assert notes[1] == "(2 of 6, about 03:18 left)"  # not the second between the first two ends
    assert notes[3] == "(4 of 6, about 01:39 left)"


def test_fruit_of_a_watched_batch_are_counted_among_those_that_have_come():
    assert ends(before=12, total=2) == ["(13 of 14 that have come)", "(14 of 14 that have come)"]


@pytest.mark.parametrize("width", [60, 80, 160])
def test_the_terminal_shows_the_stages_of_fruit_at_work(width):
    shown = io.StringIO()
    console = Console(file=shown, force_terminal=True, width=width, color_system=None)
    progress = BatchProgress(console, total=40, clock=Clock())

    def drawn():
        shown.seek(0)
        shown.truncate()
        progress._bar.refresh()
        return shown.getvalue()

    with progress:
        progress.stage("N01", "photos")
        progress.stage("N02", "contact: grasp-1")
        assert "N01: photos" in drawn()
        assert "N02: contact: grasp-1" in drawn()
        assert "0/40" in drawn()
        progress.done("N01", "E = 0.5 MPa")
        assert "1/40" in drawn()
        for number in range(3, 23):
            progress.stage(f"N{number:02d}", "photos")
        many = drawn()
        assert "N09: photos" in many
        assert "N10: photos" not in many
        assert "and 13 more fruit" in many
