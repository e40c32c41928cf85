"""Batches of a few fruit, and commands run in the test's own process."""

import hashlib
import shutil
import subprocess
import sys
import time
from pathlib import Path

import h5py
from typer.testing import CliRunner

from pipeline.cli import app
from pipeline.problem import BatchRefused
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh

DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"
NECTARINE = 'category = "nectarine"\n'
CLASSES = (
    f'{NECTARINE}[[grading.classes]]\nname = "soft"\nE_max_MPa = 0.5\n[[grading.classes]]\nname = "firm"\n'
)
"""Settings with two classes of maturity."""


def wait_until(happened, seconds=60):
    end = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < end
        time.sleep(0.05)


def run(*words: object) -> tuple[int, str]:
    """A command's exit status, and what it says; a fault of drupe's own is raised."""
    done = CliRunner().invoke(app, [*map(str, words)])
    if done.exception is None or isinstance(done.exception, SystemExit):
        return done.exit_code, done.output
    if isinstance(done.exception, BatchRefused):
        return done.exit_code, done.output + str(done.exception)
    raise done.exception


def said_with(status: int, *words: object) -> str:
    """What a command says that ends with this exit status."""
    ended_with, text = run(*words)
    assert ended_with == status, text
    return text


def python(code: str, **how: object) -> subprocess.CompletedProcess[str]:
    """What a Python of its own says of the code."""
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False, **how)


def contents(root: Path) -> dict[str, str]:
    """Every file and link under `root`, by what it holds."""
    return {
        str(path.relative_to(root)): str(path.readlink())
        if path.is_symlink()
        else hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


def write_ball(path: Path, *, radius_mm: float = 28.0, finer: int = 2) -> None:
    """The mesh of a ball."""
    directions, faces = ball(finer)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_mesh(path, radius_mm * directions, faces)


def batch_of_balls(root: Path, *names: str, table: str | None = None, settings: str = NECTARINE) -> Path:
    """Balls of 56 mm without recordings; `table`: fruits.csv, their ids alone where it is None."""
    for name in names:
        write_ball(root / "fruits" / name / "fruit.ply")
    return empty_batch(root, *names, table=table, settings=settings)


def batch_of_nectarines(root: Path, *names: str, pit: bool = False, settings: str = NECTARINE) -> Path:
    """The same nectarine with its recording each, which names it; forces grow a little from one to the next.

    `pit`: whether it has a pit.ply.
    """
    empty_batch(root, *names, settings=settings)
    for k, name in enumerate(names):
        grasps = root / "fruits" / name / "grasps"
        for file in ("fruit.ply", "pit.ply")[: 1 + pit]:
            shutil.copyfile(DATA / file, grasps.parent / file)
        shutil.copyfile(DATA / "grasp.h5", grasps / "grasp-1.h5")
        with h5py.File(grasps / "grasp-1.h5", "r+") as recording:
            recording.attrs["fruit_id"] = name
            times_force(recording, 1.0 + 0.002 * k)
    return root


def times_force(recording: h5py.File, factor: float) -> None:
    """The forces of both pads times a factor."""
    for pad in ("left", "right"):
        recording[f"pads/{pad}/force_N"][...] *= factor


def empty_batch(root: Path, *names: str, table: str | None = None, settings: str = NECTARINE) -> Path:
    """Fruit with a folder for grasps and nothing in it; `table` as in `batch_of_balls`."""
    for name in names:
        (root / "fruits" / name / "grasps").mkdir(parents=True, exist_ok=True)
    (root / "batch.toml").write_text(settings)
    (root / "fruits.csv").write_text("\n".join(["fruit_id", *names, ""]) if table is None else table)
    return root
