"""The time left is steady: it falls as time goes by, whatever order fruit end in."""

import io
import itertools
import random

import pytest
from rich.console import Console

from pipeline.run.progress import BatchProgress, TimeLeft

STAGES = {"mesh": 22.0, "flesh": 4.0, "modulus": 10.0, "picture": 1.0}
WHOLE_S = sum(STAGES.values())


class Clock:
    """A clock that a test sets."""

    def __init__(self):
        self.now_s = 1000.0

    def __call__(self):
        return self.now_s


def course(total, jobs, *, scatter=0.0, refused=()):
    """What `jobs` processes tell of `total` fruit: (moment, fruit, stage or None at the end, whole).

    Stages scatter by a share; a fruit of `refused` ends a second into its first stage.
    """
    rng = random.Random(1)
    free, events = [0.0] * jobs, []
    for fruit in range(total):
        slot = free.index(min(free))
        now = free[slot]
        for stage, takes in STAGES.items():
            events.append((now, str(fruit), stage, True))
            now += 1.0 if fruit in refused else takes * (1 + scatter * rng.uniform(-1, 1))
            if fruit in refused:
                break
        events.append((now, str(fruit), None, fruit not in refused))
        free[slot] = now
    return sorted(events, key=lambda event: event[0]), max(free)


def said(total, jobs, **options):
    """(moment, time left that is said), after every event from the first that it is known; and the end."""
    events, end_s = course(total, jobs, **options)
    clock = Clock()
    left, predictions = TimeLeft(total=total, jobs=jobs, clock=clock), []
    start_s = clock.now_s
    for moment_s, fruit, stage, whole in events:
        clock.now_s = start_s + moment_s
        if stage is None:
            left.done(fruit, whole=whole)
        else:
            left.begun(fruit)
        if left.seconds() is not None:
            predictions.append((moment_s, left.seconds()))
    return predictions, end_s


@pytest.mark.parametrize("jobs", [1, 2, 3])
def test_fruit_that_take_alike_are_predicted_exactly(jobs):
    predictions, end_s = said(7, jobs)
    assert predictions[0][0] == WHOLE_S
    for moment_s, left_s in predictions:
        assert left_s == pytest.approx(end_s - moment_s)


@pytest.mark.parametrize("jobs", [1, 2])
def test_the_end_that_is_predicted_moves_little_where_stages_scatter(jobs):
    predictions, end_s = said(30, jobs, scatter=0.2)
    ends = [moment_s + left_s for moment_s, left_s in predictions]
    steps = [abs(b - a) for a, b in itertools.pairwise(ends)]
    assert max(abs(end - end_s) for end in ends) < 0.2 * end_s
    assert max(steps) < 0.06 * end_s


def test_a_fruit_refused_at_once_does_not_make_the_others_look_short():
    predictions, _ = said(10, 1, refused={0, 2})
    at = dict(predictions)
    assert at[1.0 + WHOLE_S] == pytest.approx(8 * WHOLE_S)  # the first whole fruit has ended
    assert at[2.0 + WHOLE_S] == pytest.approx(7 * WHOLE_S)  # and then a refused one


def test_nothing_is_said_before_a_fruit_has_ended_and_nothing_is_left_at_the_end():
    left = TimeLeft(total=1, jobs=2, clock=Clock())
    left.begun("a")
    assert left.seconds() is None
    left.done("a", whole=True)
    assert left.seconds() == 0.0


def test_a_log_says_the_time_left_after_each_fruit_but_the_last():
    clock, text = Clock(), io.StringIO()
    progress = BatchProgress(Console(file=text, width=200), total=4, jobs=2, clock=clock)
    course = [
        (0, "a", "mesh"), (0, "b", "mesh"), (40, "a", ""), (40, "c", "mesh"), (42, "b", ""),
        (42, "d", "mesh"), (80, "c", ""), (82, "d", ""),
    ]  # fmt: skip
    with progress:
        for moment_s, fruit, stage in course:
            clock.now_s = 1000.0 + moment_s
            if stage:
                progress.stage(fruit, stage)
            else:
                progress.done(fruit, "E = 1", whole=True)
    ends = [line.split("E = 1 ")[1] for line in text.getvalue().splitlines() if "E = 1" in line]
    assert ends == [
        "(1 of 4, about 00:40 left)",  # c and d, side by side
        "(2 of 4, about 00:41 left)",  # d; a fruit takes 41 s on average
        "(3 of 4, about 00:03 left)",
        "(4 of 4)",
    ]


def test_fruit_of_a_watched_batch_are_counted_among_those_that_have_come():
    clock, text = Clock(), io.StringIO()
    with BatchProgress(Console(file=text, width=200), total=2, jobs=1, before=12, clock=clock) as progress:
        progress.stage("a", "mesh")
        clock.now_s += 40
        progress.done("a", "E = 1", whole=True)
        progress.done("b", "E = 1", whole=True)
    ends = [line.split("E = 1 ")[1] for line in text.getvalue().splitlines() if "E = 1" in line]
    assert ends == ["(13 of 14 that have come, about 00:40 left)", "(14 of 14 that have come)"]


def test_a_fruit_that_dies_before_its_first_stage_tells_nothing():
    left = TimeLeft(total=3, jobs=1, clock=Clock())
    left.done("a", whole=False)
    assert left.seconds() is None


@pytest.mark.parametrize("width", [60, 80, 160])
def test_the_terminal_shows_stages_and_the_time_left_as_the_log_does(width):
    now_s, shown = 0.0, io.StringIO()
    console = Console(file=shown, force_terminal=True, width=width, color_system=None)
    progress = BatchProgress(console, total=4, jobs=2, clock=lambda: now_s)

    def drawn():
        shown.seek(0)
        shown.truncate()
        progress._bar.refresh()
        return shown.getvalue()

    with progress:
        progress.stage("N01", "photos")
        progress.stage("N02", "contact: grasp-1, frame 20 of 80")
        first = drawn()
        assert "N01: photos" in first
        assert "N02: contact: grasp-1, frame 20 of 80" in first
        assert "0/4 00:00, time remaining unknown" in first
        now_s = 60.0
        progress.stage("N01", "modulus")
        now_s = 70.0
        progress.done("N01", "E = 0.5 MPa", whole=True)
        progress.stage("N03", "photos")
        assert "1/4 01:10, about 01:10 left" in drawn()
        now_s = 100.0
        assert "1/4 01:40, about 01:10 left" in drawn()
        for number in range(4, 23):
            progress.stage(f"N{number:02d}", "photos")
        many = drawn()
        assert "N09: photos" in many
        assert "N10: photos" not in many
        assert "and 13 more fruit" in many
