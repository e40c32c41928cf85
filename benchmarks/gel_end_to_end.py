"""Grade a batch twice, from its recordings and from rendered gel frames of them; print both beside the truth.

    python benchmarks/gel_end_to_end.py BATCH WORK [--fruits N01 --fruits N02 ...] [--jobs N]

BATCH is a sample batch with answers.json. WORK gets the batch in its raw form (photos or mesh as they are,
every recording as frames of two cameras with log.csv and grasp.toml), and the results of both.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
from script import run

import drupe
from samples.raw_frames import write_raw_grasp, write_sensor
from tactile.readers.recording import GelPad, read_recording


def write_raw_batch(batch: Path, raw: Path, fruits: list[str]) -> None:
    """The batch with frames in the place of recordings; a grasp that is there already is left alone."""
    raw.mkdir(parents=True, exist_ok=True)
    for name in ("batch.toml", "mat.json"):
        if (batch / name).is_file():
            shutil.copy(batch / name, raw / name)
    table = pd.read_csv(batch / "fruits.csv", dtype=str)
    table[table["fruit_id"].isin(fruits)].to_csv(raw / "fruits.csv", index=False)
    for fruit in fruits:
        fruit_folder = batch / "fruits" / fruit
        to = raw / "fruits" / fruit
        shutil.copytree(fruit_folder, to, ignore=shutil.ignore_patterns("*.h5"), dirs_exist_ok=True)
        for k, path in enumerate(sorted((fruit_folder / "grasps").glob("*.h5"))):
            recording = read_recording(path)
            pad = recording.pads[0]
            if isinstance(pad, GelPad) and not (raw / "sensor.toml").exists():
                write_sensor(raw, pad)
            folder = to / "grasps" / path.stem
            if not (folder / "grasp.toml").is_file():
                shutil.rmtree(folder, ignore_errors=True)
                rng = np.random.default_rng([2026, fruits.index(fruit), k])
                write_raw_grasp(folder, recording, rng=rng, progress=print)


def graded(batch: Path, out: Path, jobs: int) -> pd.Series:
    """E of every fruit by `drupe grade`."""
    return drupe.grade(batch, out=out, jobs=jobs).ranking.set_index("fruit_id")["E_MPa"]


def main(batch: Path, work: Path, fruits: list[str] | None = None, jobs: int = 1) -> None:
    """Print one row per fruit, then Kendall's tau and the largest error of the raw form."""
    truth = json.loads((batch / "answers.json").read_text())["fruits"]
    fruits = fruits or sorted(truth)
    write_raw_batch(batch, work / "batch", fruits)
    table = pd.DataFrame({"truth_MPa": {fruit: truth[fruit]["E_MPa"] for fruit in fruits}})
    for name, given in (("from_frames", work / "batch"), ("from_fields", batch)):
        print(f"grades the batch {name.replace('_', ' ')}", flush=True)
        table[name] = graded(given, work / name.replace("_", "-"), jobs)
        table[f"error_{name}"] = table[name] / table["truth_MPa"] - 1
    print(table.to_string(float_format="%.4g"))
    print(f"Kendall's tau {table['truth_MPa'].corr(table['from_frames'], method='kendall'):.3f}")
    print(f"largest error {table['error_from_frames'].abs().max():.3f}")


if __name__ == "__main__":
    run(main)
