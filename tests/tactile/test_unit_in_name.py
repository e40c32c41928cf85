"""Names of columns with a factor or a second unit are open; numbers of channels and cells are not factors."""

import numpy as np
import pytest

from tactile.io.load_cell import read_trace
from tactile.io.specimen import PressedSpecimen
from tactile.io.stated_unit import NoUnit, Unit, unit_of_name
from tactile.io.trace_columns import TraceWords
from tactile.tactile_failure import TactileFailure

OPEN = [
    "Force (N) x 10",
    "Load [N] *1000",
    "Force (N) (kN)",
    "Load (N) in kN",
    "Force (10^3 N)",
    "F/10 N",
    "Force (N)/mm",
    "Force (N) 1000",
    "Force x1000 (N)",
    "Force (N)/1000",
    "Force 10³ N",
    "F 1000 N",
    "F_kN [N]",
    "Force (1000) (N)",
    "Load (N) × 0.1",
    "Force (N·10)",
    "Load 1e3 N",
    "10x Load (N)",
    "Force (N) per mm",
]
READ = [
    "Load cell 2 (N)",
    "Kraft 1 [N]",
    "Force_N",
    "Channel 3 Force (N)",
    "Load_1_N",
    "Load_10_N",
    "Fx1 (N)",
    "F / N",
    "Force [N] max",
    "Kraft in [N]",
    "Kraft (N) / Force (N)",
    "Force 2 N",
    "Load x1 (N)",
    "Dev1/ai0 load (N)",
]


@pytest.mark.parametrize("name", OPEN)
def test_a_factor_or_a_second_unit_leaves_the_unit_open(name: str) -> None:
    found = unit_of_name(name, "force")
    assert isinstance(found, NoUnit)
    assert found.open


@pytest.mark.parametrize("name", READ)
def test_the_number_of_a_channel_is_no_factor(name: str) -> None:
    assert unit_of_name(name, "force") == Unit(text="N", factor=1.0)


def test_a_travel_has_the_same_rules() -> None:
    assert all(
        isinstance(one := unit_of_name(name, "travel"), NoUnit) and one.open
        for name in ("Travel (mm) (x1000)", "Travel (mm) (in)", "Travel 0,01 mm", "Weg (µm) (mm)")
    )
    assert unit_of_name("Travel in (mm)", "travel") == Unit(text="mm", factor=1.0)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        (
            "Time (s);Travel (mm);Force (N) x 10",
            r'"Force \(N\) x 10", which has a number behind it.*force=UNIT',
        ),
        ("Time (s);Travel (mm);Load x10\ns;mm;N", r'has a factor beside it \("x10"\).*force=UNIT'),
        ("Time (s);Travel (mm);Load (N)\ns;mm;x 10", r'has a factor beside it \("x 10"\).*force=UNIT'),
    ],
)
def test_an_open_unit_is_refused_until_the_user_states_it(tmp_path, header: str, said: str) -> None:
    path = tmp_path / "press.csv"
    rows = "\n".join(f"{k / 10};{k / 20};{0.02 * k**1.5:.6f}" for k in range(30))
    path.write_text(f"{header}\n{rows}\n")
    names = dict(zip(("time", "travel", "force"), header.split("\n")[0].split(";"), strict=True))

    def read(units: dict[str, str]):
        words = TraceWords(columns=names, units=units)
        wanted = {"fruit_id": "unknown", "category": "unknown", "indenter": "ball", "radius_mm": 5.0}
        return read_trace(path, **wanted, specimen=PressedSpecimen(), words=words)

    with pytest.raises(TactileFailure, match=said):
        read({})
    found = read({"force": "daN"})
    np.testing.assert_allclose(found.recording.pads[0].force_z_N[-1], 0.2 * 29**1.5, rtol=1e-5)
    assert any("read in daN" in note for note in found.notes)
