"""Small batches from the shipped sample: ready meshes and one recording each, so that they grade fast."""

import csv
import json
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from unittest import mock

import h5py
import pandas as pd

from pipeline.cli import main
from pipeline.exit_status import DONE, DOUBTED
from recon.surface.mesh_file import write_mesh
from samples.fruit import MESH_ERROR_MM, fruits_of_seed, scanned_mesh

SHIPPED = Path(__file__).parents[2] / "samples" / "data" / "nectarines"
SETTINGS = """
category = "nectarine"
poisson_ratio = 0.45
[mesh]
edge_mm = 12.0
pad_edge_mm = 4.0
"""
QUICK = SETTINGS.replace("[mesh]", '[flesh]\nmodel = "linear"\n[mesh]')


@dataclass(frozen=True)
class Ran:
    """What a run of the command gave."""

    status: int
    out: str
    err: str

    def one_line_error(self) -> str:
        """The only line on standard error, which must not be a traceback."""
        lines = self.err.strip().splitlines()
        assert "Traceback" not in self.err, self.err
        assert len(lines) == 1, self.err
        return lines[0]

    def last_line_error(self) -> str:
        """The only line of drupe itself on standard error, which must be the last one."""
        *stages, last = self.err.strip().splitlines()
        assert last.startswith("drupe:"), self.err
        assert not [line for line in stages if line.startswith(("drupe:", "Traceback"))], self.err
        return last


def drupe(*arguments: object, status: int | None = None) -> Ran:
    """Runs the command in this process, its fruit too (in_this_process); `status`: how it must end."""
    out, err = StringIO(), StringIO()
    ended_with = 0
    with mock.patch.object(sys, "argv", ["drupe", *map(str, arguments)]):
        try:
            with redirect_stdout(out), redirect_stderr(err):
                main()
        except SystemExit as ended:
            ended_with = int(ended.code or 0)
    assert status in (None, ended_with), err.getvalue()
    return Ran(ended_with, out.getvalue(), err.getvalue())


def drupe_alone(*arguments: object, timeout: float = 600) -> Ran:
    """Runs the command as a user does: it and every fruit have processes of their own."""
    command = [sys.executable, "-c", "from pipeline.cli import main; main()", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=timeout, check=False)
    return Ran(done.returncode, done.stdout, done.stderr)


def ready_batch(folder: Path, count: int) -> Path:
    """A batch of `count` shipped nectarines as ready meshes with their first recording, at small strain."""
    seed = json.loads((SHIPPED / "answers.json").read_text())["seed"]
    with (SHIPPED / "fruits.csv").open() as file:
        shipped = len(list(csv.DictReader(file)))
    folder.mkdir(parents=True)
    (folder / "batch.toml").write_text(QUICK)
    rows = ["fruit_id,shore_oo"]
    for fruit in fruits_of_seed(shipped, seed=seed)[:count]:
        where = folder / "fruits" / fruit.fruit_id
        (where / "grasps").mkdir(parents=True)
        # coarser than the shipped scans: graded in two thirds of the time
        write_mesh(where / "fruit.ply", *scanned_mesh(fruit, cells=16, error_mm=MESH_ERROR_MM))
        source = SHIPPED / "fruits" / fruit.fruit_id / "grasps" / "grasp-1.h5"
        shutil.copyfile(source, where / "grasps" / "grasp-1.h5")
        rows.append(f"{fruit.fruit_id},{40 + len(rows)}")
    (folder / "fruits.csv").write_text("\n".join(rows) + "\n")
    return folder


def scale_force(path: Path, times: float, *pads: str) -> None:
    """The forces of a recording's pads times a factor; of both where none is named."""
    with h5py.File(path, "r+") as file:
        for pad in pads or ("left", "right"):
            force = file[f"pads/{pad}/force_N"]
            force[...] = times * force[...].astype(float)


def graded_alone(batch: Path, out: Path, *options: str) -> tuple[pd.Series, dict]:
    """A batch of one fruit is graded, in doubt or not: its row of the ranking, and its record."""
    ran = drupe("grade", batch, "--out", out, "--jobs", 1, *options)
    assert ran.status in {DONE, DOUBTED}, ran.err
    row = pd.read_csv(out / "ranking.csv").iloc[0]
    return row, record_of(out, row.fruit_id)


def record_of(results: Path, fruit_id: str) -> dict:
    """What record.json says of a fruit."""
    return json.loads((results / "fruits" / fruit_id / "record.json").read_text())


def first_fruit(batch: Path) -> Path:
    """The folder of the batch's first fruit."""
    return sorted((batch / "fruits").iterdir())[0]
