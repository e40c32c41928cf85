"""Every fifteenth broken input, and all that state what they expect: none hangs, takes all memory or shows a
library's inside, and each stated value or message comes.

`--every 1 --junitxml FILE` runs every input; FILE has each verdict, with its processor time and memory.
"""

import pytest
from damage_outcome import run, sound_digests
from damaged_inputs import cases
from sound_inputs import write_sound

STATED = [case for case in cases() if case.expects]
DRAWN = [case for case in cases() if not case.expects]


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    root = tmp_path_factory.mktemp("sound") / "sound"
    write_sound(root)
    return root, sound_digests(root)


def pytest_generate_tests(metafunc):
    if "broken" in metafunc.fixturenames:
        every = metafunc.config.getoption("every")
        chosen = [*DRAWN[every // 2 :: every], *STATED]
        metafunc.parametrize(
            "broken", chosen, ids=[f"{case.format}: {case.kind} ({case.seed})" for case in chosen]
        )


def test_a_broken_input_ends_in_a_clear_error_or_is_read_as_what_it_says(sound, broken, record_property):
    verdict, said, cpu_s, memory_MB = run(broken, *sound)
    for name, value in (("verdict", verdict), ("cpu_s", cpu_s), ("memory_MB", memory_MB)):
        record_property(name, value)
    assert verdict != "FAILED", said


def test_the_campaign_has_every_format_and_enough_of_each():
    formats = {case.format for case in DRAWN}
    assert len(formats) == 18
    assert len(DRAWN) > 1000
    assert all(sum(case.format == name for case in DRAWN) >= 30 for name in formats)
