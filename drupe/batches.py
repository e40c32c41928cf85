"""Grades a batch on disk with the command `drupe grade`, and reads results as typed tables."""

import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from drupe.refusal import DrupeError, refusals
from pipeline.batch.layout import BatchFolder, Results
from pipeline.exit_status import DONE, DOUBTED, UNUSABLE
from pipeline.files.manifest import json_in
from recon.surface.mesh_file import read_mesh
from recon.surface.orientation import to_fruit_frame
from reports.tables import RANKING_COLUMNS

Triangles: TypeAlias = tuple[Float[np.ndarray, "_n 3"], Int[np.ndarray, "_m 3"]]
WHOLE = ("rank", "grasps", "rank_low", "rank_high")
REAL = (
    "E_MPa", "E_sd_MPa", "E_scale_sd_MPa", "E_uncorrected_MPa", "maturity_probability", "p_softer_than_next",
    "rank_probability", "height_mm", "volume_mm3", "shore_oo", "screen_p", "judged_E_MPa",
    "E_at_pulp_MPa", "E_at_pulp_sd_MPa",
)  # fmt: skip
COMMAND = (sys.executable, "-P", "-c", "from pipeline.start import main; main()")
"""The command `drupe` of this installation; -P excludes the current folder from its import path."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GradedBatch:
    """Results of `drupe grade` in `folder`.

    `ranking`: a row per fruit, softest first, with the columns of ranking.csv (docs/formats.md), then the
    user's columns. Whole numbers are Int64, others Float64, `reference` is bool, texts are string; unknown
    values are missing. `provenance`: batch.json, with versions, settings, SHA-256 of every input, and times.
    """

    folder: Path
    ranking: pd.DataFrame
    provenance: Mapping[str, Any]

    def record(self, fruit_id: str) -> Mapping[str, Any]:
        """The fruit's record.json. Raises DrupeError for an unknown fruit or an unreadable record."""
        if fruit_id not in set(self.ranking["fruit_id"]):
            known = ", ".join(self.ranking["fruit_id"][:6])
            raise DrupeError(f'fruit_id: found "{fruit_id}", expected a fruit of the batch: {known}')
        path = Results(self.folder).fruit(fruit_id).record
        held = json_in(path)
        if not isinstance(held, dict):
            raise DrupeError(f"{path}: found no readable record, expected that of drupe grade; grade again")
        return held

    def surfaces(
        self, fruit_id: str, *, frame: Literal["fruit", "mat"] = "fruit"
    ) -> tuple[Triangles, Triangles | Literal["none"]]:
        """The arguments `mesh` and `pit` of `modulus`: vertices (n, 3) in mm and triangles (m, 3) of the skin
        and of the pit, or "none" for a body without a pit.

        `frame`: that of the recordings' poses, the mat's if they name it. Raises DrupeError for an unknown
        fruit or frame, and for a fruit without a mesh.
        """
        if frame not in ("fruit", "mat"):
            raise DrupeError(f'frame: found "{frame}", expected "fruit" or "mat"')
        record, files = self.record(fruit_id), Results(self.folder).fruit(fruit_id)
        mesh = record.get("mesh")
        if mesh is None or not files.fruit_ply.is_file():
            raise DrupeError(f"{fruit_id}: found no mesh in {files.root}, expected a fruit graded with one")
        with refusals():
            skin = read_mesh(files.fruit_ply)
            pit = read_mesh(files.pit_ply) if record.get("pit") else None
        shift = np.zeros(3)
        if frame == "fruit" and mesh["source"] == "photos":
            shift = to_fruit_frame(skin[0])[1][:3, 3]
        return (skin[0] + shift, skin[1]), "none" if pit is None else (pit[0] + shift, pit[1])


def read(out: str | Path) -> GradedBatch:
    """The results in the folder `out`. Raises DrupeError if it has no readable results of `drupe grade`."""
    results = Results(Path(out))
    said, rows = json_in(results.provenance), json_in(results.ranking_json)
    if not isinstance(said, dict) or said.get("format") != "drupe-batch-result":
        inside = results.root / "results"
        hint = f"{inside}" if Results(inside).provenance.is_file() else "the folder that --out named"
        raise DrupeError(f"{out}: found no results of drupe grade (batch.json), expected them; give {hint}")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        advice = f"run `drupe report {out}`"
        raise DrupeError(f"{results.ranking_json}: found no readable table, expected the ranking; {advice}")
    added = [name for name in (rows[0] if rows else {}) if name not in RANKING_COLUMNS]
    table = pd.DataFrame(rows, columns=[*RANKING_COLUMNS, *added], dtype=object)
    kinds = {name: "string" for name in RANKING_COLUMNS if name != "reference"}
    kinds |= dict.fromkeys(WHOLE, "Int64") | dict.fromkeys(REAL, "Float64")
    try:
        ranking = table.assign(reference=table["reference"] == "true").astype(kinds)
        ranking[added] = table[added].convert_dtypes()
    except (TypeError, ValueError) as error:
        message = f"found a value of another kind ({error}), expected those of drupe grade"
        raise DrupeError(f"{results.ranking_json}: {message}; run `drupe report {out}`") from None
    return GradedBatch(folder=results.root, ranking=ranking, provenance=said)


def grade(
    batch: str | Path, *, out: str | Path | None = None, jobs: int | None = None, screen: bool = True
) -> GradedBatch:
    """Grades the batch in a folder with the command `drupe grade`, and reads the results.

    `out`: results folder, BATCH/results by default. `jobs`: fruit in parallel, one per core by default.
    `screen`: whether drupe tests each fruit for physics that the model misses. In the row of a fruit without
    E, `outcome` and `reason` state why. Raises DrupeError if drupe cannot grade the batch as a whole.
    """
    place = BatchFolder(Path(batch)).default_results if out is None else Path(out)
    options = ["--out", str(place), *([] if jobs is None else ["--jobs", str(jobs)])]
    options += ["--quiet", *([] if screen else ["--no-screen"])]
    command = [*COMMAND, "grade", *options, "--", str(batch)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (DONE, UNUSABLE, DOUBTED):
        raise DrupeError(done.stderr.strip() or f"drupe grade ended with status {done.returncode}")
    return read(place)
