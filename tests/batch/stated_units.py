"""Presses with units in their headers; each with what it must come to."""

from collections.abc import Iterator

from file_damage import Change, put
from sound_inputs import PRESS

SAME = "same"
S, MM, N = ("Time (s)", 1.0), ("Travel (mm)", 1.0), ("Force (N)", 1.0)
GRAVITY, POUND_KG, INCH_MM = 9.80665, 0.45359237, 25.4
"""m/s2 (CGPM 1901); the avoirdupois pound and the inch (international agreement of 1959): exact."""
HEADERS: tuple[tuple[tuple[str, float], tuple[str, float], tuple[str, float], str], ...] = (
    (S, MM, ("Load (kN)", 1e3), SAME),
    (S, MM, ("Load [KN]", 1e3), SAME),
    (S, MM, ("Compressive load / lbf", POUND_KG * GRAVITY), SAME),
    (S, MM, ("Load {lbs}", POUND_KG * GRAVITY), SAME),
    (S, MM, ("Load (oz)", POUND_KG / 16 * GRAVITY), SAME),
    (S, MM, ("load_kgf", GRAVITY), SAME),
    (S, MM, ("Peso (kg)", GRAVITY), SAME),
    (S, MM, ("Force_g", 1e-3 * GRAVITY), SAME),
    (S, MM, ("Force (gf)", 1e-3 * GRAVITY), SAME),
    (S, MM, ("Standardkraft in cN", 1e-2), SAME),
    (S, MM, ("Force (daN)", 10.0), SAME),
    (S, MM, ("Fz, mN", 1e-3), SAME),
    (("Zeit / min", 60.0), ("Weg in µm", 1e-3), ("Kraft [N]", 1.0), SAME),
    (("Time (sec)", 1.0), ("Position (in)", INCH_MM), N, SAME),
    (("t_ms", 1e-3), ('Position (")', INCH_MM), N, SAME),
    (("Time [S]", 1.0), ("Extension (inch)", INCH_MM), N, SAME),
    (S, ("Position (mil)", INCH_MM / 1e3), N, SAME),
    (S, ("Position_thou", INCH_MM / 1e3), N, SAME),
    (S, ("Weg (μm)", 1e-3), N, SAME),
    (S, ("Allongement (cm)", 10.0), N, SAME),
    (S, ("travel_m", 1e3), N, SAME),
    (S, MM, ("Stress (MPa)", 1.0), r"press\.csv: .*Stress \(MPa\).* is a pressure or stress, not a force"),
    (S, MM, ("Load [V]", 1.0), r"press\.csv: .*Load \[V\].* is a voltage, not a force"),
    (S, MM, ("load (counts)", 1.0), r"press\.csv: .*load \(counts\).* count, not a force"),
    (S, ("Strain (%)", 1.0), N, r"press\.csv: .*Strain \(%\).* a ratio.*, not a length"),
    (S, ("Time of travel (s)", 1.0), N, r"press\.csv: .* is a time, not a length"),
    (S, MM, ("Load (klumps)", 1.0), r'press\.csv: .*"klumps", which is no unit.*--units force=UNIT'),
    (S, MM, ("Load (MN)", 1.0), r"press\.csv: .*would be 1e\+06 N, which no press has.*--units force=UNIT"),
    (S, MM, ("Force (N) x 10", 1.0), r"press\.csv: .* has more than its unit.*--units force=UNIT"),
    (S, MM, ("Load (N) in kN", 1.0), r"press\.csv: .* has more than its unit.*--units force=UNIT"),
    (S, ("Travel (mm) (x1000)", 1.0), N, r"press\.csv: .* has more than its unit.*--units travel=UNIT"),
    (S, MM, ("Load", 1.0), r"press\.csv: found no unit of force .*--units force=N"),
)  # fmt: skip
"""Names of time, travel and force with their units in s, mm and N, and what is expected."""
ROWS_OF_UNITS = (
    ("(sec)", "(in)", "(lbf)", (1.0, INCH_MM, POUND_KG * GRAVITY)),
    ("ms", "µm", "kN", (1e-3, 1e-3, 1e3)),
    ("[min]", "[cm]", "[kg]", (60.0, 10.0, GRAVITY)),
)


def stated_units() -> Iterator[tuple[str, Change, str]]:
    """Each header, the table that has it, and what is expected."""
    for columns in HEADERS:
        names, factors = zip(*columns[:3], strict=True)
        yield "; ".join(names), _table([";".join(names)], factors), columns[3]
    for *units, factors in ROWS_OF_UNITS:
        yield f"row of units {units}", _table(["Time;Travel;Force", ";".join(units)], factors), SAME
    times_10 = _table(["Time;Travel;Load (N)", "s;mm;x10"], (1.0, 1.0, 1.0))
    yield "row of units with a factor", times_10, r"press\.csv: .* has a factor beside it"
    contradicting = ["Time;Travel;Load (kN)", "s;mm;N"]
    said = r"press\.csv: found force \(.*\) in N by the row of units and in kN by its name"
    yield "row of units against the name", _table(contradicting, (1.0, 1.0, 1.0)), said


def _table(header: list[str], factors: tuple[float, ...]) -> Change:
    rows = [";".join(f"{v / f:.15g}" for v, f in zip(row, factors, strict=True)) for row in PRESS]
    return lambda path, _: put(path, ("\n".join([*header, *rows]) + "\n").encode())
