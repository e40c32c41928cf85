"""Mistakes as they happen in the field, made on sound recordings: is each named, and what does it do to E?

    python benchmarks/field_mistakes.py FOLDER [...] [--half even|odd] [--sound] [--grade CACHE] [--csv OUT]
        [--only TEXT] [--grasps 2] [--limit N] [--verbose]

A FOLDER holds fruit.ply, perhaps pit.ply, grasp-*.h5 and truth.json (E_MPa, category), or such folders; a
mismatch case is one too, whose answers.json beside it holds the truth. Seeds are the folders' numbers: `even`
ones were worked with, `odd` ones scored once. `--sound` prints what the checks say of unchanged recordings,
`--cheap N` of N fruit drawn without a solver.
Without `--grade` only the checks run (seconds); with it every changed fruit goes through the pipeline.
`--only` takes the mistakes with this text in their names, `--grasps` the first recordings of a fruit, and
`--limit` the first fruit. `--verbose` prints what the checks say where a mistake is not named.
What the checks say first is scored by its kind (field_list.py): *named* where it is this mistake's, *among
several* where its sentence lists the mistake among other causes (a gain: force, displacement or stiffness).
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer
from field_fruit import Fruit, cheap_fruit, fruits_in, partner
from field_list import MISTAKES, Mistake, naming
from script import Half, run

from pipeline.batch.layout import Results
from pipeline.batch.opening import open_batch
from pipeline.batch.records import FruitRecord, read_record, write_record
from pipeline.batch.settings import Settings
from pipeline.batch.task import fruit_task
from pipeline.fruit.category_doubts import of_category, of_poisson_ratio, shipped_categories
from pipeline.fruit.input_doubts import Doubt, of_a_given_pit
from pipeline.fruit.sensor_scale import known_gels
from pipeline.fruit.stages import grade_fruit
from recon.pit.priors import load_prior
from recon.surface.mesh_file import write_mesh
from tactile.consistency.finding import Finding
from tactile.consistency.of_recording import recording_findings
from tactile.readers.recording import write_recording


def E_range_MPa(category: str) -> tuple[float, float] | None:
    """What flesh of the category can have, as the product has it."""
    plausible = load_prior(category).plausible
    return None if plausible is None else plausible.E_MPa


def category_doubts(fruit: Fruit) -> list[Doubt]:
    """What the category says of Poisson's ratio, and of the mesh where the pit is the category's."""
    prior = load_prior(fruit.category)
    settings = Settings(category=fruit.category, poisson_ratio=fruit.poisson_ratio)
    doubts = of_poisson_ratio(settings, prior)
    if fruit.pit is not None:
        return doubts
    return doubts + of_category(np.ptp(fruit.vertices, axis=0).tolist(), prior, others=shipped_categories())


def findings_of(fruit: Fruit) -> list[Finding]:
    """What the checks say of its recordings, one after the other."""
    return [
        finding
        for recording in fruit.recordings
        for finding in recording_findings(
            recording,
            fruit.vertices,
            fruit.faces,
            E_range_MPa=E_range_MPa(fruit.category),
            gels=known_gels(recording.sensor, None),
        )
    ]


def checked(fruit: Fruit) -> list[Doubt | Finding]:
    """What the checks alone say of a given pit and of every recording; remarks last."""
    doubts = category_doubts(fruit)
    if fruit.pit is not None:
        doubts = of_a_given_pit(fruit.vertices, *fruit.pit, load_prior(fruit.category)) + doubts
    findings = sorted(findings_of(fruit), key=lambda finding: finding.remark)
    return [*(doubt for doubt in doubts if doubt.kind is not None), *findings]


COVERED_SD = 2.0
"""Standard deviations within which E must be after a mistake that no check needs to name."""
SETTINGS = """\
category = "{category}"
poisson_ratio = {poisson_ratio}
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
    task = fruit_task(open_batch(as_batch(fruit, folder / "batch")), "F", Results(folder / "out"))
    record = grade_fruit(task, lambda stage: None)
    write_record(kept, record)
    return record


def as_batch(fruit: Fruit, folder: Path) -> Path:
    """The folder, written as a batch of this fruit alone, "F"."""
    where = folder / "fruits" / "F"
    (where / "grasps").mkdir(parents=True, exist_ok=True)
    settings = SETTINGS.format(category=fruit.category, poisson_ratio=fruit.poisson_ratio) + (
        PHANTOM if fruit.category == "phantom" else ""
    )
    (folder / "batch.toml").write_text(settings, encoding="utf-8")
    (folder / "fruits.csv").write_text("fruit_id\nF\n", encoding="utf-8")
    write_mesh(where / "fruit.ply", fruit.vertices, fruit.faces)
    if fruit.pit is not None:
        write_mesh(where / "pit.ply", *fruit.pit)
    for k, recording in enumerate(fruit.recordings):
        write_recording(where / "grasps" / f"grasp-{k + 1}.h5", replace(recording, fruit_id="F"))
    return folder


def judged(fruit: Fruit, changed: Fruit, mistake: Mistake, cache: Path | None) -> dict[str, object]:
    """One row: how the checks name the mistake, and with `cache` what E becomes."""
    said = checked(changed)
    how = naming(said[0] if said else None, mistake)
    row: dict[str, object] = {
        "mistake": mistake.name,
        "fruit": fruit.name,
        "category": fruit.category,
        "harmless": mistake.harmless,
        "covered": mistake.covered,
        "refused": any(answer.refused for answer in said),
        "named": how == "named",
        "among several": how == "among several",
        "kind": said[0].kind.value if said else "",
        "said": said[0].sentence if said else "",
    }
    if cache is None:
        return row
    slug = re.sub(r"[^a-z0-9]+", "-", mistake.name.lower())
    record = graded(changed, cache / slug / fruit.name)
    E, sd = (None, None) if record.modulus is None else (record.modulus.E_MPa, record.modulus.E_sd_MPa)
    sentences = list(record.doubts or record.warnings) if record.graded else [record.reason]
    return row | {
        "refused": not record.graded,
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

    said = [bool(row["refused"] or row["named"] or row["among several"]) for row in rows]
    wrong = [row for row, answered in zip(rows, said, strict=True) if not answered and _far(row)]
    bare = [row for row in rows if row["covered"] and float(str(row.get("sds") or 0.0)) > COVERED_SD]
    return (
        f"{name:32s} {len(rows):3d}  named {share('named'):4.0%}  among several "
        f"{share('among several'):4.0%}  refused {share('refused'):4.0%}  E/true {middle('ratio')}  "
        f"sd {middle('sd')}  |error|/sd {middle('sds')}  wrong and not named {len(wrong)}  "
        f"not covered {len(bare)}"
    )


def _far(row: dict[str, object]) -> bool:
    """E off by more than 5 % and 3 of its standard deviations."""
    ratio, sds = row.get("ratio"), row.get("sds")
    return ratio is not None and abs(float(str(ratio)) - 1) > 0.05 and float(str(sds)) > 3


SOUND = Mistake("none", lambda fruit, other, rng: fruit, set())


def main(
    folders: Annotated[list[Path] | None, typer.Argument()] = None,
    half: Half = "all",
    sound: bool = False,
    cheap: int = 0,
    grade: Path | None = None,
    csv: Path | None = None,
    only: str = "",
    grasps: int = 2,
    limit: int | None = None,
    verbose: bool = False,
) -> None:
    """Prints the table."""
    if cheap:
        print_findings([cheap_fruit(seed) for seed in range(cheap)])
        return
    fruits = [
        replace(given, recordings=given.recordings[:grasps])
        for given in fruits_in(folders or [], half).values()
    ]
    if sound:
        print_findings(fruits)
        return
    rows: list[dict[str, object]] = []
    for mistake in (SOUND, *MISTAKES):
        if only not in mistake.name:
            continue
        judgements = []
        for k, fruit in enumerate(fruits[:limit]):
            rng = np.random.default_rng([11, fruit.number])
            changed = mistake.change(fruit, partner(fruits, k), rng)
            judgements.append(judged(fruit, changed, mistake, grade))
            if verbose and mistake is not SOUND and not judgements[-1]["named"]:
                print(f"  {mistake.name} | {fruit.name} | {str(judgements[-1]['said'])[:200]}")
        print(in_a_line(mistake.name, judgements), flush=True)
        rows += judgements
    if csv:
        pd.DataFrame(rows).to_csv(csv, index=False)


def print_findings(fruits: Sequence[Fruit]) -> None:
    """What the checks say of unchanged recordings."""
    count = wrong = 0
    for fruit in fruits:
        for recording in fruit.recordings:
            findings = findings_of(replace(fruit, recordings=(recording,)))
            count += 1
            wrong += bool(findings)
            for finding in findings:
                how = "refused" if finding.refused else "said"
                print(f"{fruit.name} ({how}): {finding.sentence}")
    print(f"{count} recordings of {len(fruits)} fruit, {wrong} with a sentence")


if __name__ == "__main__":
    run(main)
