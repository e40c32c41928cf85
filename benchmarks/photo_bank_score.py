"""Photos to mesh over a bank of drawn scenes (benchmarks/photo_bank.py): errors per set, and per factor.

    python benchmarks/photo_bank_score.py BANK --half work|scored [--jobs 2] [--only set-004]...
        [--without-model] --out CSV

Each set is reconstructed in a process of its own from its photos as `drupe grade` does it: photos are
checked, cameras come from the mat, the surface from outlines and relief. Errors are those of
benchmarks/recon_score.py: `seen` is the true surface in free sight of a camera. A set counts as missed where
its mesh is off by more than MISSED_RMS_MM or MISSED_VOLUME and nothing was said of the mesh, as a false
warning where it is off by less than half of both and something was. Sentences about photos that were left
out do not count as warnings.
"""

import json
import multiprocessing
import resource
import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import pandas as pd
import typer
from script import run

MISSED_RMS_MM, MISSED_VOLUME = 0.3, 0.02
"""RMS error and relative volume error from which on a mesh must not pass unsaid."""
VERDICTS = ("missed", "false warning", "warned", "refused")
FACTORS = ("shape", "colour", "gloss", "light", "ground", "mat", "pipeline")


def scored_set(folder: Path, *, with_model: bool = True) -> dict[str, Any]:
    """One reconstruction, its error, and what was said of it."""
    from recon_score import read_truth, scored

    from recon.cameras.photos import read_photos
    from recon.cameras.printed_mat import parse_mat
    from recon.checks.photo_check import checked_photos
    from recon.checks.quality import require_seen, shape_doubts
    from recon.fruit_mesh import ReconOptions, reconstruct
    from recon.recon_failure import ReconFailure

    scene = json.loads((folder / "scene.json").read_text())
    out: dict[str, Any] = {"set": folder.name, "half": scene["half"], "photos": len(scene["photos"])}
    out |= {
        "shape": scene["fruit"]["kind"], "colour": scene["skin"]["colour"], "gloss": scene["skin"]["gloss"],
        "light": scene["light"]["kind"], "ground": scene["ground"]["kind"], "mat": scene["mat"]["state"],
        "pipeline": scene["pipeline"]["kind"],
    }  # fmt: skip
    cpu, start = time.process_time(), time.perf_counter()
    try:
        photos = read_photos(folder / "photos")
        mat = parse_mat(json.loads((folder / "mat.json").read_text()), source=str(folder / "mat.json"))
        options = ReconOptions() if with_model else ReconOptions(fruit_model=None)
        made = reconstruct(checked_photos(photos, mat).photos, mat=mat, height_mm=None, options=options)
        require_seen(made.quality)
    except ReconFailure as refusal:
        return out | {"refused": str(refusal)}
    said = [*made.warnings, *shape_doubts(made.vertices, made.faces)]
    out |= {
        "cpu_s": time.process_time() - cpu,
        "seconds": time.perf_counter() - start,
        "peak_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    truth = read_truth(folder)
    return out | {
        "used": made.quality.views_used,
        **scored(truth, [c.name for c in made.cameras], made.vertices, made.faces),
        "surface_sd_mm": made.surface_sd_mm,
        "relief_share": made.quality.relief_share,
        "said": " ".join(said),
    }


def verdict(row: dict[str, Any]) -> str:
    """right, warned, refused, false warning or missed."""
    if pd.isna(row.get("rms_seen_mm")):
        return "refused"
    rms, volume = float(row["rms_seen_mm"]), abs(float(row["volume_error"]))
    wrong = rms > MISSED_RMS_MM or volume > MISSED_VOLUME
    sound = rms < MISSED_RMS_MM / 2 and volume < MISSED_VOLUME / 2
    if row["said"]:
        return "false warning" if sound else "warned"
    return "missed" if wrong else "right"


def table(rows: pd.DataFrame) -> pd.DataFrame:
    """Median, 95 % and worst of the sets' errors, and verdicts, of all and of each value of each factor."""
    columns = rows.columns.union(["rms_seen_mm", "volume_error"], sort=False)
    rows = rows.reindex(columns=columns).assign(verdict=[verdict(row) for row in rows.to_dict("records")])
    groups = {"all": rows}
    for factor in FACTORS:
        groups |= {f"{factor}: {name}": group for name, group in rows.groupby(factor)}
    lines = {}
    for name, group in groups.items():
        rms, volume = group["rms_seen_mm"], 100 * group["volume_error"].abs()
        numbers = {"RMS median": rms.median(), "95 %": rms.quantile(0.95), "worst": rms.max()}
        numbers |= {"volume median, %": volume.median(), "worst, %": volume.max()}
        counts = {said: int((group["verdict"] == said).sum()) for said in VERDICTS}
        lines[name] = {"sets": len(group), **numbers, **counts}
    return pd.DataFrame.from_dict(lines, orient="index")


def main(
    bank: Path,
    half: Annotated[Literal["work", "scored"], typer.Option()],
    out: Annotated[Path, typer.Option()],
    jobs: int = 2,
    only: list[str] | None = None,
    without_model: bool = False,
) -> None:
    """Prints a line a set and the table; writes the rows."""
    folders = [
        folder
        for folder in sorted(bank.iterdir())
        if (folder / "scene.json").is_file()
        and json.loads((folder / "scene.json").read_text())["half"] == half
        and (not only or folder.name in only)
    ]
    rows = []
    with multiprocessing.get_context("spawn").Pool(jobs, maxtasksperchild=1) as pool:
        score = partial(scored_set, with_model=not without_model)
        for row in pool.imap(score, folders, chunksize=1):
            rows.append(row)
            numbers = (
                f"RMS {row['rms_seen_mm']:.3f} 95 % {row['p95_seen_mm']:.3f} mm, volume"
                f" {100 * row['volume_error']:+.2f} %, sd {row['surface_sd_mm']:.3f} mm,"
                f" {row['cpu_s']:.0f} CPU s"
                if "rms_seen_mm" in row
                else row["refused"]
            )
            print(f"{row['set']} {verdict(row):13} {numbers}  {row.get('said', '')}", flush=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(out, index=False, float_format="%.5g")
    print(table(pd.DataFrame(rows)).to_string(float_format="%.3f"))


if __name__ == "__main__":
    run(main)
