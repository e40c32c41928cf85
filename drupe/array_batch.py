"""Writes the arrays of one fruit as a temporary batch, so that the code of `drupe grade` reads them."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from drupe.numbers import numbers
from drupe.refusal import DrupeError, refusals
from pipeline.batch.layout import BatchFolder, Results
from pipeline.batch.opening import open_batch
from pipeline.batch.scratch import scratch
from pipeline.batch.task import FruitTask, fruit_task
from pipeline.files.toml_text import as_toml
from pipeline.problem import refused
from pipeline.run.checking import implausible
from recon.surface.mesh_file import write_mesh
from tactile.readers.recording import Recording, write_recording

Surface: TypeAlias = tuple[ArrayLike, ArrayLike]
"""A closed triangle mesh: vertices (n, 3) in mm, faces (m, 3) as indices with outward normals."""
Pit: TypeAlias = Surface | Literal["none", "prior"]
FRUIT_ID = "fruit"
ARGUMENTS = {"category": "category", "poisson_ratio": "nu"}
"""The argument of a function that replaces each of these keys of batch.toml."""
ANY_CATEGORY = "phantom"
"""This category has neither a prior of the pit nor a Poisson's ratio, and the widest plausible range of E."""


def silent(_: str) -> None:
    """Reports no progress."""


@contextmanager
def array_batch(
    mesh: Surface,
    recordings: Recording | Sequence[Recording],
    *,
    pit: Pit,
    nu: float | None,
    category: str | None,
    settings: Mapping[str, Any] | None,
) -> Iterator[Path]:
    """Yields the batch's folder and deletes it at the end of the block. Raises DrupeError for unusable
    arguments. Failures of drupe's packages in the block become DrupeError.
    """
    given = list(recordings) if isinstance(recordings, Iterable) else [recordings]
    wrong = [type(held).__name__ for held in given if not isinstance(held, Recording)]
    if wrong or not given:
        kind = wrong[0] if wrong else "none"
        raise DrupeError(f"recordings: found {kind}, expected one or more of this fruit")
    if nu is None and category is None:
        raise DrupeError("nu: found None without a category, expected Poisson's ratio, for example 0.45")
    named = sorted({held.fruit_id for held in given} - {"unknown", ""})
    if len(named) > 1:
        raise DrupeError(f"recordings: found fruit {', '.join(named)}, expected one fruit")
    stated: dict[str, Any] = {"category": category or ANY_CATEGORY}
    if nu is not None:
        stated["poisson_ratio"] = float(numbers("nu", nu, ()))
    further = _plain({} if settings is None else settings)
    for key in sorted(stated.keys() & further.keys()):
        raise DrupeError(f'settings: found "{key}", expected it as the argument {ARGUMENTS[key]} alone')
    stated |= further
    if isinstance(pit, str):
        if pit not in ("none", "prior"):
            raise DrupeError(f'pit: found "{pit}", expected a mesh, "none" or "prior"')
        if pit == "none":
            stated["pit"] = {**stated.get("pit", {}), "prior": "none"}
        elif category is None:
            raise DrupeError(
                'pit: found "prior" without a category, expected category="nectarine" or another'
            )
    with refusals(), scratch() as root:
        folder = BatchFolder(root)
        fruit = folder.fruit(FRUIT_ID)
        fruit.root.mkdir(parents=True)
        fruit.grasps.mkdir()
        folder.settings.write_text(as_toml(stated), encoding="utf-8")
        folder.table.write_text(f"fruit_id\n{FRUIT_ID}\n", encoding="utf-8")
        write_mesh(fruit.root / "fruit.ply", *_surface("mesh", mesh))
        if not isinstance(pit, str):
            write_mesh(fruit.root / "pit.ply", *_surface("pit", pit))
        digits = len(str(len(given)))  # files are read in the order of their names
        for k, held in enumerate(given, start=1):
            known = replace(held, fruit_id=FRUIT_ID, category=stated["category"])
            write_recording(fruit.grasps / f"recording-{k:0{digits}}.h5", known)
        with refusals(root):
            yield root


def array_task(root: Path) -> FruitTask:
    """The task of the batch's fruit. Raises BatchRefused for invalid settings and implausible sizes."""
    batch = open_batch(root)
    if said := implausible(batch, batch.row_of[FRUIT_ID]):
        raise refused("mesh", said)
    task = fruit_task(batch, FRUIT_ID, Results(root / "results"), screen=False)
    task.results.claim()
    return task


def _surface(name: str, surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) and faces (m, 3). Raises DrupeError for wrong shapes or indices out of range."""
    if not isinstance(surface, tuple | list) or len(surface) != 2:
        raise DrupeError(f"{name}: found {type(surface).__name__}, expected the pair (vertices, faces)")
    vertices = numbers(f"{name} vertices", surface[0], (None, 3))
    faces = numbers(f"{name} faces", surface[1], (None, 3), whole=True)
    if faces.min() < 0 or faces.max() >= len(vertices):
        face_range = f"indices from {faces.min()} to {faces.max()}"
        raise DrupeError(f"{name} faces: found {face_range}, expected 0 to {len(vertices) - 1}")
    return vertices, faces


def _plain(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The settings in Python's types instead of NumPy's, without None. Raises DrupeError for other types."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.generic | np.ndarray):
            return value.tolist()
        if isinstance(value, Path | date):
            return str(value)
        raise DrupeError(f"settings: found {value!r}, expected a number, text, date, list or table")

    if not isinstance(settings, Mapping):
        raise DrupeError(f"settings: found {type(settings).__name__}, expected a table of keys and values")
    text = json.dumps(dict(settings), default=plain)
    return dict(json.loads(text, object_hook=lambda table: {k: v for k, v in table.items() if v is not None}))
