"""Every fifteenth broken input of the campaign, and all that state what they expect: none hangs, takes all
memory or shows a library's inside, and each stated value or message comes.
"""

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "benchmarks"))
from campaign import run, sound_digests
from campaign_inputs import cases
from campaign_sound import write_sound

STATED = [one for one in cases() if one.expects]
CHOSEN = [*[one for one in cases() if not one.expects][7::15], *STATED]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    root = tmp_path_factory.mktemp("sound") / "sound"
    write_sound(root)
    return root, sound_digests(root)


@pytest.mark.parametrize("broken", CHOSEN, ids=lambda one: f"{one.format}: {one.kind} ({one.seed})")
def test_a_broken_input_ends_in_a_clear_error_or_is_read_as_what_it_says(sound, broken):
    verdict, said, *_ = run(broken, *sound)
    assert verdict != "FAILED", said


def test_the_campaign_has_every_format_and_enough_of_each():
    drawn = [one for one in cases() if not one.expects]
    formats = {one.format for one in drawn}
    assert len(formats) == 18
    assert len(drawn) > 1000
    assert all(sum(one.format == name for one in drawn) >= 30 for name in formats)
