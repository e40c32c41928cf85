"""Drawn traces of a press, sound or with what loggers do to them, and whether preparation puts them right.

    python benchmarks/trace_faults.py [--first N] [--seeds N] [--kind NAME]

Each seed draws one press (law, rates, noise, offsets, sign, hold, unloading) and one fault, writes the table
as a logger would, and reads it with `drupe convert`'s reader. The score: the stiffness by a fit of the known
law over that of the same press without the fault (within LIMIT), the note that names the fault, and no other
correction. Of a sound press every row must come out as it was written. Every second seed is drawn:
those of development from `--first 0` on (the default), held-out ones from `--first 1` on.
"""

import re
import sys
import tempfile
from collections import Counter
from itertools import product
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from script import run

from tactile.readers.load_cell import read_trace
from tactile.readers.trace_columns import TraceWords
from tactile.tactile_failure import TactileFailure

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "tactile"))
from drawn_sound import SOUND
from drawn_traces import FAULTS, Press, even_press, press

LIMIT = 0.03
CORRECTED = r"left out|used|removed|interpolated"


def stiffness(travel, force, exponent: float) -> float:
    """Of force = k (travel - onset)^exponent + zero, by least squares."""
    lo, hi = travel.min(), travel.max()
    best = np.inf, 0.0
    for share in (0.15, 0.45):

        def gap(x):
            return x[0] * np.maximum(travel - x[1], 0) ** exponent + x[2] - force

        start = [np.ptp(force) / (hi - lo) ** exponent, lo + share * (hi - lo), force[0]]
        fit = least_squares(gap, start, x_scale=[max(start[0], 1e-9), hi - lo, np.ptp(force)], loss="linear")
        best = min(best, (float(fit.cost), float(fit.x[0])))
    return best[1]


def read(p: Press, folder: Path):
    """The recording's columns and the notes; a refusal as a note."""
    p.write(folder / "t.csv")
    try:
        converted = read_trace(
            folder / "t.csv",
            fruit_id="f",
            category="plum",
            indenter="ball",
            radius_mm=5.0,
            words=TraceWords(),
        )
    except TactileFailure as failure:
        return None, [f"REFUSED {failure.detail}"]
    recording = converted.recording
    return (recording.time_s, recording.aperture_mm, recording.pads[0].force_z_N), list(converted.notes)


def corrections(notes: list[str]) -> list[str]:
    """Notes on what was corrected."""
    return [note for note in notes if re.search(CORRECTED, note) and "thinned" not in note]


def outcome(kind: str, seed: int, folder: Path) -> str:
    """Empty where all is right, else what is wrong."""
    rng = np.random.default_rng([seed, *kind.encode()])
    if kind in SOUND:
        p = SOUND[kind](rng)
        columns, notes = read(p, folder)
        said = corrections(notes)
        return f"{said or notes}" if said or columns is None else ""
    sound = even_press(rng) if kind == "stale even" else press(rng)
    broken, words = FAULTS[kind](sound, rng)
    columns, notes = read(broken, folder)
    text = " ".join(notes)
    if not re.search(words, text):
        return f"no note {words!r}: {notes[1:]}"
    if columns is None:
        return "" if words.startswith("REFUSED") else text
    others = [
        correction
        for correction in corrections(notes)
        if not re.search(words.replace("(?=.*", "(").replace(")(", ")|("), correction)
    ]
    true = stiffness(sound.travel_mm, sound.force_N, sound.exponent)
    ratio = stiffness(*columns[1:], sound.exponent) / true
    if abs(ratio - 1) > LIMIT:
        return f"stiffness {ratio:.3f}: {notes[1:]}"
    return f"other corrections: {others}" if others else ""


def main(first: int = 0, seeds: int = 30, kind: str = "") -> None:
    """Prints every failure and the table."""
    right, total = Counter(), Counter()
    with tempfile.TemporaryDirectory() as folder:
        for name, seed in product([kind] if kind else [*FAULTS, *SOUND], range(first, first + 2 * seeds, 2)):
            said = outcome(name, seed, Path(folder))
            total[name] += 1
            right[name] += not said
            if said:
                print(f"{name} {seed}: {said[:420]}")
    print("| kind | right | of |\n|---|---:|---:|")
    for name, count in total.items():
        print(f"| {name} | {right[name]} | {count} |")


if __name__ == "__main__":
    run(main)
