"""A recording's sensor is a shipped model only where nothing but a serial number follows the model's name."""

import pytest

from tactile.io.sensor_model import model_named


@pytest.mark.parametrize(
    ("sensor", "key"),
    [
        ("DIGIT", "digit"),
        ("digit D20123", "digit"),
        ("DIGIT SN 20123", "digit"),
        ("DIGIT #7", "digit"),
        ("Tac3D A1-0040R", "tac3d"),
        ("gelsight-mini 28A1-XYZ", "gelsight-mini"),
        ("GelSight Mini, marked gel 28A1-XYZ", "gelsight-mini"),
        ("DIGIT 360", None),
        ("DIGIT Pinki", None),
        ("DIGIT 360 SN 7", None),
        ("DIGIT v2", None),
        ("Tac3D (own gel)", None),
        ("GelSight Mini, marked gel of ours", None),
    ],
)
def test_only_a_serial_number_may_follow_the_name(sensor: str, key: str | None) -> None:
    found = model_named(sensor)
    assert (None if found is None else found.key) == key
