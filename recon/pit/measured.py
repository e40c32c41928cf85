"""A pit that the user measured (STL, PLY or OBJ) in place of the category's superellipsoid."""

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from recon.pit.placement import require_closed
from recon.pit.priors import MeasuredPit, PitPrior, load_prior
from recon.recon_failure import ReconProblem
from recon.surface.mesh_file import SUFFIXES, read_mesh


def load_pit(named: str | Path, *, category: str) -> PitPrior:
    """The pit prior of a category, of a TOML file, or the category's with a measured pit's mesh.

    The mesh is in mm with z to the stem end and x to the suture; wherever it lies, its box's centre is put
    where the category's pits have theirs (in the middle, if it leaves them to the batch), in its own size.
    Spreads and Poisson's ratio stay the category's.
    Raises ReconFailure: no-prior, bad-prior (not of a pit's size), unreadable-mesh, not-watertight.
    """
    path = Path(named)
    if path.suffix.lower() not in SUFFIXES:
        return load_prior(named)
    prior = load_prior(category)
    if not path.is_file():
        raise ReconProblem.NO_PRIOR.failure(
            f"{path} is not a file; give the mesh of a measured pit ({', '.join(SUFFIXES)}), in mm."
        )
    vertices, faces = read_mesh(path)
    require_closed(vertices, faces, what=path.name)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    longest, (least, most) = float((high - low).max()), prior.body.pit_mm
    if not least <= longest <= most:
        raise ReconProblem.BAD_PRIOR.failure(
            f"{path}: the pit is {longest:.3g} long, expected {least:g} to {most:g} mm; export it in mm."
        )
    digest = hashlib.sha256(np.ascontiguousarray(vertices).tobytes())
    digest.update(faces.astype(np.int64).tobytes())
    return replace(
        prior,
        measured=MeasuredPit(vertices=vertices - (low + high) / 2, faces=faces, digest=digest.hexdigest()),
        sources=prior.sources | {"measured": f"mesh of a measured pit, {path.name}"},
    )
