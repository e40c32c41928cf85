"""Batches of a few fruit, and commands run in the test's own process."""

import shutil
from pathlib import Path

import h5py
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.problem import BatchRefused
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh

DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"
NECTARINE = 'category = "nectarine"\n'


def run(*words: object) -> tuple[int, str]:
    """A command's exit status, and what it says; a fault of drupe's own is raised."""
    done = CliRunner().invoke(app, [*map(str, words)])
    if done.exception is None or isinstance(done.exception, SystemExit):
        return done.exit_code, done.output
    if isinstance(done.exception, BatchRefused):
        return done.exit_code, done.output + str(done.exception)
    raise done.exception


def write_ball(path: Path, *, radius_mm: float = 28.0, finer: int = 2) -> None:
    """The mesh of a ball."""
    directions, faces = ball(finer)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_mesh(path, radius_mm * directions, faces)


def batch_of_balls(root: Path, *names: str, table: str | None = None, settings: str = NECTARINE) -> Path:
    """Balls of 56 mm without recordings; `table`: fruits.csv, their ids alone where it is None."""
    for name in names:
        write_ball(root / "fruits" / name / "fruit.ply")
        (root / "fruits" / name / "grasps").mkdir()
    return _with_table(root, names, table, settings)


def batch_of_nectarines(root: Path, *names: str, pit: bool = False, settings: str = NECTARINE) -> Path:
    """The same nectarine with its recording each, which names it; forces grow a little from one to the next.

    `pit`: whether it has a pit.ply.
    """
    for k, name in enumerate(names):
        grasps = root / "fruits" / name / "grasps"
        grasps.mkdir(parents=True)
        for file in ("fruit.ply", "pit.ply")[: 1 + pit]:
            shutil.copyfile(DATA / file, grasps.parent / file)
        shutil.copyfile(DATA / "grasp.h5", grasps / "grasp-1.h5")
        with h5py.File(grasps / "grasp-1.h5", "r+") as recording:
            recording.attrs["fruit_id"] = name
            for pad in ("left", "right"):
                recording[f"pads/{pad}/force_N"][...] *= 1.0 + 0.002 * k
    return _with_table(root, names, None, settings)


def _with_table(root: Path, names: tuple[str, ...], table: str | None, settings: str) -> Path:
    (root / "batch.toml").write_text(settings)
    (root / "fruits.csv").write_text("\n".join(["fruit_id", *names, ""]) if table is None else table)
    return root
