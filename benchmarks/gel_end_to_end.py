"""Grade a batch twice, from its recordings and from rendered gel frames of them; print both beside the truth.

    python benchmarks/gel_end_to_end.py BATCH WORK [--fruits N01 N02 ...] [--jobs N]

BATCH is a sample batch with answers.json. WORK gets the batch in its raw form (photos or mesh as they are,
every recording as frames of two cameras with log.csv and grasp.toml), and the results of both.
"""

import argparse
import csv
import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

from samples.raw_frames import write_raw_grasp, write_sensor
from tactile.io.recording import GelPad, read_recording


def write_raw_batch(batch: Path, raw: Path, fruits: list[str]) -> None:
    """The batch with frames in the place of recordings; a grasp that is there already is left alone."""
    raw.mkdir(parents=True, exist_ok=True)
    for name in ("batch.toml", "mat.json"):
        if (batch / name).is_file():
            shutil.copy(batch / name, raw / name)
    rows = list(csv.DictReader((batch / "fruits.csv").open(encoding="utf-8")))
    with (raw / "fruits.csv").open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(row for row in rows if row["fruit_id"] in fruits)
    for fruit in fruits:
        own = batch / "fruits" / fruit
        to = raw / "fruits" / fruit
        for name in ("photos", "fruit.ply"):
            if (own / name).is_dir() and not (to / name).exists():
                shutil.copytree(own / name, to / name)
            elif (own / name).is_file():
                to.mkdir(parents=True, exist_ok=True)
                shutil.copy(own / name, to / name)
        for k, path in enumerate(sorted((own / "grasps").glob("*.h5"))):
            recording = read_recording(path)
            pad = recording.pads[0]
            if isinstance(pad, GelPad) and not (raw / "sensor.toml").exists():
                write_sensor(raw, pad)
            folder = to / "grasps" / path.stem
            if not (folder / "grasp.toml").is_file():
                shutil.rmtree(folder, ignore_errors=True)
                rng = np.random.default_rng([2026, fruits.index(fruit), k])
                write_raw_grasp(folder, recording, rng=rng, progress=print)


def graded(batch: Path, out: Path, jobs: int) -> dict[str, float]:
    """E of every fruit by `drupe grade`."""
    command = [sys.executable, "-c", "from pipeline.cli import main; main()", "grade", str(batch)]
    subprocess.run([*command, "--out", str(out), "--jobs", str(jobs)], check=False)
    with (out / "ranking.csv").open(encoding="utf-8") as file:
        return {row["fruit_id"]: float(row["E_MPa"] or "nan") for row in csv.DictReader(file)}


def main() -> None:
    """Print one row per fruit, then Kendall's tau and the largest error of the raw form."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("batch", type=Path)
    parser.add_argument("work", type=Path)
    parser.add_argument("--fruits", nargs="*")
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    truth = json.loads((chosen.batch / "answers.json").read_text())["fruits"]
    fruits = chosen.fruits or sorted(truth)
    write_raw_batch(chosen.batch, chosen.work / "batch", fruits)
    raw = graded(chosen.work / "batch", chosen.work / "from-frames", chosen.jobs)
    fields = graded(chosen.batch, chosen.work / "from-fields", chosen.jobs)
    print("fruit  truth_MPa  from_frames  error  from_fields  error")
    for fruit in fruits:
        true = truth[fruit]["E_MPa"]
        errors = raw[fruit] / true - 1, fields[fruit] / true - 1
        print(
            f"{fruit} {true:10.4g} {raw[fruit]:12.4g} {errors[0]:+.3f} {fields[fruit]:12.4g} {errors[1]:+.3f}"
        )
    true = [truth[fruit]["E_MPa"] for fruit in fruits]
    found = [raw[fruit] for fruit in fruits]
    print(f"Kendall's tau {kendalltau(true, found).statistic:.3f}")
    print(f"largest error {max(abs(f / t - 1) for f, t in zip(found, true, strict=True)):.3f}")


if __name__ == "__main__":
    main()
