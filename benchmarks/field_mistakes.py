"""Mistakes as they happen in the field, made on sound recordings: is each named, and what does it do to E?

    python benchmarks/field_mistakes.py FOLDER [...] [--half even|odd] [--sound] [--grade CACHE] [--csv OUT]

A FOLDER holds fruit.ply, perhaps pit.ply, grasp-*.h5 and truth.json (E_MPa, category), or such folders; a
mismatch case is one too, whose answers.json beside it holds the truth. Seeds are the folders' numbers: `even`
ones were worked with, `odd` ones scored once. `--sound` prints what the checks say of unchanged recordings,
`--cheap N` of N fruit drawn without a solver.
Without `--grade` only the checks run (seconds); with it every changed fruit goes through the pipeline.
"""

import argparse
import csv
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from field_changes import (
    Change,
    clipped,
    cut,
    dead,
    each,
    exchanged,
    force,
    frames,
    from_contact,
    gel,
    hole,
    in_order,
    late,
    mesh,
    noisy,
    offset,
    other_mesh,
    other_poses,
    other_recording,
    pads,
    permuted,
    pit,
    pose,
    rounded,
    scaled_place,
    shift,
    some,
    standing_still,
    transposed,
    until_peak,
    without_markers,
    zero_frames,
)
from field_changes import (
    about_the_middle as middled,
)
from field_fruit import Fruit, cheap_fruit, fruits_in, partner

from pipeline.batch import open_batch
from pipeline.doubts import of_a_given_pit
from pipeline.layout import Results
from pipeline.records import FruitRecord, read_record, write_record
from pipeline.stages import grade_fruit
from pipeline.task import fruit_task
from recon.mesh_file import write_mesh
from recon.priors import load_prior
from tactile.checks.of_recording import recording_findings
from tactile.failure import TactileFailure
from tactile.recording import write_recording


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """`words`: a sentence that holds one of these names the cause. `harmless`: E does not depend on it."""

    name: str
    change: Change
    words: tuple[str, ...]
    harmless: bool = False


TURN_90 = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
TILT_90 = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRROR = np.diag([-1.0, 1, 1])

MISTAKES: tuple[Mistake, ...] = (
    Mistake(name="force in grams", change=force(101.97), words=("grams",)),
    Mistake(name="force in kN", change=force(1e-3), words=("kilonewtons",)),
    Mistake(name="force in mN", change=force(1e3), words=("millinewtons",)),
    Mistake(name="force in pounds", change=force(0.22481), words=("pounds",)),
    Mistake(name="force x 1.3", change=force(1.3), words=("forces are", "gain")),
    Mistake(name="force sign", change=force(-1.0), words=("sign",)),
    Mistake(name="one pad's force in grams", change=force(101.97, only=0), words=("grams",)),
    Mistake(name="one pad's force x 0.5", change=force(0.5, only=1), words=("forces are", "gain")),
    Mistake(
        name="force x and z exchanged",
        change=pads(lambda p, r: replace(p, force_N=in_order(p.force_N, (2, 1, 0)))),
        words=("axes",),
    ),
    Mistake(name="force 5 frames late", change=late("force", 5), words=("late", "early")),
    Mistake(name="force 2 frames early", change=late("force", -2), words=("late", "early")),
    Mistake(name="force clipped at half", change=clipped("force", 0.5), words=("clipped",)),
    Mistake(name="force clipped at 80 %", change=clipped("force", 0.8), words=("clipped",)),
    Mistake(name="force offset, no tare", change=offset(0.3), words=("offset", "tare"), harmless=True),
    Mistake(name="force in 6 steps", change=rounded(6), words=("quantised",)),
    Mistake(name="displacement in metres", change=shift(1e-3), words=("metres",)),
    Mistake(name="displacement in micrometres", change=shift(1e3), words=("micrometres",)),
    Mistake(name="displacement sign", change=shift(-1.0), words=("sign",)),
    Mistake(name="displacement x 0.5", change=shift(0.5), words=("scale of the displacement", "scaled")),
    Mistake(
        name="displacement x and z exchanged",
        change=pads(lambda p, r: replace(p, displacement_mm=in_order(p.displacement_mm, (2, 1, 0)))),
        words=("axes",),
    ),
    Mistake(
        name="displacement as increments",
        change=pads(
            lambda p, r: replace(
                p, displacement_mm=np.diff(p.displacement_mm, axis=0, prepend=p.displacement_mm[:1])
            )
        ),
        words=("increments",),
    ),
    Mistake(name="one pad's displacement dead", change=shift(0.0, only=0), words=("dead", "zero")),
    Mistake(name="displacement clipped at half", change=clipped("displacement", 0.5), words=("clipped",)),
    Mistake(name="displacement's markers permuted", change=permuted("displacement"), words=("permuted",)),
    Mistake(name="force's markers permuted", change=permuted("force"), words=("permuted",)),
    Mistake(name="rest places permuted", change=permuted("rest"), words=("permuted",)),
    Mistake(
        name="rest places in metres",
        change=pads(lambda p, r: replace(p, rest_mm=p.rest_mm * 1e-3)),
        words=("rest_mm",),
    ),
    Mistake(
        name="30 % of markers missing",
        change=without_markers(lambda p, r: some(len(p.rest_mm), 0.3, r)),
        words=("holes", "missing"),
    ),
    Mistake(name="a hole in the markers", change=without_markers(hole), words=("holes", "missing")),
    Mistake(
        name="half of the markers missing",
        change=without_markers(lambda p, r: p.rest_mm[:, 0] > 0.2),
        words=("missing",),
    ),
    Mistake(name="30 % zero throughout", change=dead(0.3, "zero"), words=("dead", "zero")),
    Mistake(name="30 % zero from the middle", change=dead(0.3, "zero-late"), words=("dead", "zero")),
    Mistake(name="30 % frozen from the middle", change=dead(0.3, "frozen"), words=("frozen", "dead")),
    Mistake(name="10 % frozen in force", change=dead(0.1, "frozen", "force"), words=("frozen", "dead")),
    Mistake(name="noise x 10", change=noisy(10.0), words=("noise",), harmless=True),
    Mistake(name="one frame of zeros", change=zero_frames(1), words=("zero",)),
    Mistake(name="three frames of zeros", change=zero_frames(3), words=("zero",)),
    Mistake(
        name="gel frames shuffled",
        change=frames(lambda n, r: r.permutation(n), log=False),
        words=("shuffled",),
    ),
    Mistake(
        name="all frames shuffled",
        change=frames(lambda n, r: r.permutation(n), log=True),
        words=("shuffled",),
    ),
    Mistake(
        name="every second frame a copy",
        change=frames(lambda n, r: np.arange(n) // 2 * 2, log=False),
        words=("duplicated",),
        harmless=True,
    ),
    Mistake(
        name="every third frame dropped",
        change=cut(lambda one: np.flatnonzero(np.arange(len(one.time_s)) % 3 != 2)),
        words=("dropped",),
        harmless=True,
    ),
    Mistake(name="no first touch", change=cut(from_contact), words=("starts in contact",)),
    Mistake(name="no unloading", change=cut(until_peak), words=("unload",), harmless=True),
    Mistake(name="gel 5 frames late on jaws", change=late("both", 5), words=("late", "lag")),
    Mistake(name="time in ms", change=each(lambda o, r: replace(o, time_s=o.time_s * 1e3)),
            words=("milliseconds",), harmless=True),
    Mistake(name="aperture in cm", change=each(lambda o, r: replace(o, aperture_mm=o.aperture_mm / 10)),
            words=("centimetres",), harmless=True),
    Mistake(name="stiffness in kPa/mm", change=gel(1e3), words=("kPa",), harmless=True),
    Mistake(name="stiffness of another gel", change=gel(2.2), words=("another gel",), harmless=True),
    Mistake(name="poses in metres", change=pose(scaled_place(1e-3)), words=("metres", "units (mm)")),
    Mistake(name="rotations transposed", change=pose(transposed), words=("transposed",)),
    Mistake(name="poses of one instant", change=pose(standing_still), words=("stand still", "one instant")),
    Mistake(name="poses of another day", change=other_poses,
            words=("another day", "another recording", "another fruit", "poses are wrong")),
    Mistake(name="pads' signals exchanged", change=exchanged("signals"),
            words=("other pad", "exchanged"), harmless=True),
    Mistake(name="pads' poses exchanged", change=exchanged("poses"), words=("exchanged", "other pad")),
    Mistake(name="another fruit's recording", change=other_recording, words=("another fruit",)),
    Mistake(name="another fruit's mesh", change=other_mesh, words=("another fruit",)),
    Mistake(name="mesh turned by 90 degrees", change=mesh(middled(lambda v: v @ TURN_90)), words=("turned",)),
    Mistake(name="mesh lying on its side", change=mesh(middled(lambda v: v @ TILT_90)), words=("turned",)),
    Mistake(name="mesh mirrored", change=mesh(middled(lambda v: v @ MIRROR), turn_faces=True),
            words=("mirrored", "turned"), harmless=True),
    Mistake(name="mesh x 1.1", change=mesh(middled(lambda v: 1.1 * v)), words=("scaled", "another fruit")),
    Mistake(name="mesh x 0.95", change=mesh(middled(lambda v: 0.95 * v)), words=("scaled", "another fruit")),
    Mistake(name="pit moved 10 mm", change=pit(lambda v: v + np.array([7.0, 0.0, -7.0])), words=("pit",)),
    Mistake(name="pit moved 6 mm", change=pit(lambda v: v + np.array([6.0, 0.0, 0.0])), words=("pit",)),
    Mistake(name="pit x 1.4", change=pit(middled(lambda v: 1.4 * v)), words=("pit",)),
    Mistake(name="pit x 0.6", change=pit(middled(lambda v: 0.6 * v)), words=("pit",)),
    Mistake(name="pit turned by 90 degrees", change=pit(middled(lambda v: v @ TURN_90)), words=("pit",)),
)  # fmt: skip


RANGE_MPA = {"nectarine": (0.005, 20.0), "plum": (0.005, 12.0), "phantom": (0.0005, 60.0)}


def checked(fruit: Fruit) -> list[tuple[str, bool, float]]:
    """(sentence, refused, relative sd) of every recording, and of a given pit, by the checks alone."""
    said: list[tuple[str, bool, float]] = []
    for one in fruit.recordings:
        try:
            found = recording_findings(
                one, fruit.vertices, fruit.faces, E_range_MPa=RANGE_MPA.get(fruit.category)
            )
            said += [(f.sentence, f.refused, f.relative_sd) for f in found]
        except TactileFailure as failure:
            said.append((failure.detail, True, 0.0))
    if fruit.pit is not None:
        doubts = of_a_given_pit(fruit.vertices, *fruit.pit, load_prior(fruit.category))
        said = [(one.sentence, one.refused, one.relative_sd) for one in doubts] + said
    return said


SETTINGS = """\
category = "{category}"
poisson_ratio = 0.45
[mesh]
edge_mm = 8.0
pad_edge_mm = 3.0
"""
PHANTOM = """\
[pit]
offset_sd_mm = 0.3
size_sd = 0.02
"""


def graded(fruit: Fruit, folder: Path) -> FruitRecord:
    """The fruit's record by the pipeline, as a batch of its own in `folder`; kept there."""
    kept = folder / "record.json"
    if kept.is_file() and (record := read_record(kept)) is not None:
        return record
    where = folder / "batch" / "fruits" / "F"
    (where / "grasps").mkdir(parents=True, exist_ok=True)
    settings = SETTINGS.format(category=fruit.category) + (PHANTOM if fruit.category == "phantom" else "")
    (folder / "batch" / "batch.toml").write_text(settings, encoding="utf-8")
    (folder / "batch" / "fruits.csv").write_text("fruit_id\nF\n", encoding="utf-8")
    write_mesh(where / "fruit.ply", fruit.vertices, fruit.faces)
    if fruit.pit is not None:
        write_mesh(where / "pit.ply", *fruit.pit)
    for k, one in enumerate(fruit.recordings):
        write_recording(where / "grasps" / f"grasp-{k + 1}.h5", replace(one, fruit_id="F"))
    task = fruit_task(open_batch(folder / "batch"), "F", Results(folder / "out"))
    record = grade_fruit(task, lambda stage: None)
    write_record(kept, record)
    return record


def named(said: Sequence[str], words: Sequence[str]) -> bool:
    """Whether the first sentence holds a word that names the cause."""
    return bool(said) and any(word in said[0] for word in words)


def judged(fruit: Fruit, changed: Fruit, mistake: Mistake, cache: Path | None) -> dict[str, object]:
    """One row: what is said of the mistake, and with `cache` what E becomes."""
    row: dict[str, object] = {
        "mistake": mistake.name,
        "fruit": fruit.name,
        "category": fruit.category,
        "harmless": mistake.harmless,
    }
    if cache is None:
        said = checked(changed)
        refused = any(r for _, r, _ in said)
        sentences = [s for s, _, _ in said]
        return row | {
            "refused": refused,
            "named": named(sentences, mistake.words),
            "said": sentences[0] if said else "",
        }
    slug = re.sub(r"[^a-z0-9]+", "-", mistake.name.lower())
    record = graded(changed, cache / slug / fruit.name)
    E, sd = (None, None) if record.modulus is None else (record.modulus.E_MPa, record.modulus.E_sd_MPa)
    sentences = list(record.doubts or record.warnings) if record.graded else [record.reason]
    return row | {
        "refused": not record.graded,
        "named": named(sentences, mistake.words),
        "doubted": bool(record.doubts),
        "ratio": None if E is None or not record.graded else E / fruit.E_MPa,
        "sd": None if E is None or sd is None else sd / E,
        "sds": None if E is None or sd is None or not record.graded else abs(E - fruit.E_MPa) / sd,
        "said": sentences[0] if sentences else "",
    }


def in_a_line(name: str, rows: Sequence[dict[str, object]]) -> str:
    """One mistake's row of the table."""

    def share(key: str) -> float:
        return float(np.mean([bool(row.get(key)) for row in rows]))

    def middle(key: str) -> str:
        values = [float(str(row[key])) for row in rows if row.get(key) is not None]
        return f"{np.median(values):6.3f}" if values else "     -"

    wrong = [row for row in rows if not row["refused"] and not row["named"] and _far(row)]
    return (
        f"{name:32s} {len(rows):3d}  named {share('named'):4.0%}  refused {share('refused'):4.0%}  "
        f"E/true {middle('ratio')}  sd {middle('sd')}  |error|/sd {middle('sds')}  "
        f"wrong and not named {len(wrong)}"
    )


def _far(row: dict[str, object]) -> bool:
    """E off by more than 5 % and 3 of its standard deviations."""
    ratio, sds = row.get("ratio"), row.get("sds")
    return ratio is not None and abs(float(str(ratio)) - 1) > 0.05 and float(str(sds)) > 3


SOUND = Mistake(name="none", change=lambda fruit, other, rng: fruit, words=())


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--half", choices=("even", "odd", "all"), default="all")
    parser.add_argument("--sound", action="store_true")
    parser.add_argument("--cheap", type=int, default=0, help="sound fruit drawn without a solver")
    parser.add_argument("--grade", type=Path)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--grasps", type=int, default=2, help="recordings of each fruit that are used")
    parser.add_argument("--limit", type=int, help="judge so many fruit; the rest lend theirs")
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    if options.cheap:
        sound([cheap_fruit(seed) for seed in range(options.cheap)])
        return
    fruits = [
        replace(one, recordings=one.recordings[: options.grasps])
        for one in fruits_in(options.folders, options.half)
    ]
    if options.sound:
        sound(fruits)
        return
    rows: list[dict[str, object]] = []
    for mistake in (SOUND, *MISTAKES):
        if options.only not in mistake.name:
            continue
        own = []
        for k, fruit in enumerate(fruits[: options.limit]):
            rng = np.random.default_rng([11, fruit.number])
            changed = mistake.change(fruit, partner(fruits, k), rng)
            own.append(judged(fruit, changed, mistake, options.grade))
            if options.verbose and mistake.words and not own[-1]["named"]:
                sys.stdout.write(f"  {mistake.name} | {fruit.name} | {str(own[-1]['said'])[:200]}\n")
        sys.stdout.write(in_a_line(mistake.name, own) + "\n")
        sys.stdout.flush()
        rows += own
    if options.csv:
        with options.csv.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, fieldnames=list(rows[0]))
            table.writeheader()
            table.writerows(rows)


def sound(fruits: Sequence[Fruit]) -> None:
    """What the checks say of unchanged recordings."""
    count = wrong = 0
    for fruit in fruits:
        for one in fruit.recordings:
            found = recording_findings(
                one, fruit.vertices, fruit.faces, E_range_MPa=RANGE_MPA.get(fruit.category)
            )
            count += 1
            wrong += bool(found)
            for f in found:
                sys.stdout.write(f"{fruit.name} ({'refused' if f.refused else 'said'}): {f.sentence}\n")
    sys.stdout.write(f"{count} recordings of {len(fruits)} fruit, {wrong} with a sentence\n")


if __name__ == "__main__":
    main()
