"""CalculiX decks: a specimen with a rigid bonded core, patches moved as a whole; reactions read back."""

import os
import re
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from calculix_mesh import Mesh, Specimen, solved_box


@dataclass(frozen=True, kw_only=True)
class Reactions:
    """Forces (N) of the pads on the flesh at the patches' nodes, level by level; seconds of the solver."""

    node: np.ndarray
    force_N: np.ndarray
    seconds: float


def write_deck(
    path: Path,
    specimen: Specimen,
    mesh: Mesh,
    *,
    E_MPa: float,
    poisson_ratio: float,
    moves_mm: np.ndarray,
    levels: tuple[float, ...],
    finite: bool,
) -> np.ndarray:
    """Write the deck; returns the patches' nodes. Patch p moves by level * moves_mm[p] in each step.

    The core's surface follows t + w x r, with those of its six motions that the mirrors leave. The equations
    are linear: with `finite` the mirrors must leave translations only.
    """
    x = mesh.nodes_mm
    low, _ = solved_box(specimen)
    pads = [np.flatnonzero(patch.holds(x)) for patch in specimen.patches]
    fixed = {(int(n), k): 0.0 for k in specimen.mirrors for n in np.flatnonzero(np.abs(x[:, k]) < 1e-6)}
    if specimen.base_fixed:
        fixed |= {(int(n), k): 0.0 for n in np.flatnonzero(x[:, 2] < low[2] + 1e-6) for k in range(3)}
    turns = [k for k in range(3) if not set(specimen.mirrors) & ({0, 1, 2} - {k})]
    shifts = [k for k in range(3) if k not in specimen.mirrors]
    if finite and turns:
        raise ValueError("finite strain needs mirrors that keep the core from turning")
    arm = x - np.array(specimen.core.centre_mm)
    first, second = len(x) + 1, len(x) + 2
    equations = []
    for node in mesh.core_nodes:
        for k in range(3):
            terms = [(first, k, -1.0)] if k in shifts else []
            for w in turns:
                rate = float(np.cross(np.eye(3)[w], arm[node])[k])
                if abs(rate) > 1e-9:
                    terms.append((second, w, -rate))
            if terms:
                fixed.pop((int(node), k), None)
                equations.append([(int(node) + 1, k, 1.0), *terms])
            else:
                fixed[int(node), k] = 0.0
    kind = "C3D20R" if mesh.elements.shape[1] == 20 else "C3D10"
    with path.open("w") as deck:
        deck.write("*NODE, NSET=NALL\n")
        for n, p in enumerate(np.vstack([x, specimen.core.centre_mm, specimen.core.centre_mm]), start=1):
            deck.write(f"{n}, {p[0]:.9g}, {p[1]:.9g}, {p[2]:.9g}\n")
        deck.write(f"*ELEMENT, TYPE={kind}, ELSET=FLESH\n")
        for n, element in enumerate(mesh.elements + 1, start=1):
            words = [str(n), *map(str, element)]
            deck.write(
                ",".join(words[:11]) + (",\n" + ",".join(words[11:]) if len(words) > 11 else "") + "\n"
            )
        deck.write("*MATERIAL, NAME=FLESH\n")
        if finite:
            mu, bulk = E_MPa / 2 / (1 + poisson_ratio), E_MPa / 3 / (1 - 2 * poisson_ratio)
            deck.write(f"*HYPERELASTIC, NEO HOOKE\n{mu / 2:.12g}, {2 / bulk:.12g}\n")
        else:
            deck.write(f"*ELASTIC\n{E_MPa:.12g}, {poisson_ratio:.12g}\n")
        deck.write("*SOLID SECTION, ELSET=FLESH, MATERIAL=FLESH\n")
        for terms in equations:
            deck.write(f"*EQUATION\n{len(terms)}\n")
            deck.write(",".join(f"{n},{k + 1},{c:.12g}" for n, k, c in terms) + "\n")
        everyone = np.unique(np.concatenate(pads))
        deck.write("*NSET, NSET=PADS\n" + "".join(f"{n + 1}\n" for n in everyone))
        on_pad = {int(n) for n in everyone}
        deck.write("*BOUNDARY\n")
        for (n, k), _ in sorted(fixed.items()):
            if n not in on_pad:
                deck.write(f"{n + 1},{k + 1},{k + 1}\n")
        idle = [k for k in range(3) if k not in turns]
        for k in idle:
            deck.write(f"{second},{k + 1},{k + 1}\n")
        for k in set(range(3)) - set(shifts):
            deck.write(f"{first},{k + 1},{k + 1}\n")
        for level in levels:
            deck.write("*STEP, NLGEOM, INC=60\n*STATIC\n1., 1.\n" if finite else "*STEP\n*STATIC\n")
            deck.write("*BOUNDARY\n")
            for pad, move in zip(pads, moves_mm, strict=True):
                for n in pad:
                    for k in range(3):
                        deck.write(f"{n + 1},{k + 1},{k + 1},{level * move[k]:.12g}\n")
            deck.write("*NODE PRINT, NSET=PADS, FREQUENCY=99\nRF\n*END STEP\n")
    return everyone


def solve(path: Path, nodes: np.ndarray, *, levels: int, threads: int = 1) -> Reactions:
    """Run ccx on the deck and read the reactions of each step's end."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(threads)}
    start = time.monotonic()
    run = subprocess.run(
        ["ccx", "-i", path.stem],
        cwd=path.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    seconds = time.monotonic() - start
    text = (path.parent / f"{path.stem}.dat").read_text()
    blocks = re.split(r"\n\s*forces.*\n", "\n" + text)[1:]
    if "*ERROR" in run.stdout or len(blocks) < levels:
        raise RuntimeError(f"ccx gave {len(blocks)} of {levels} levels:\n{run.stdout[-2000:]}")
    tables = [
        np.array([line.split() for line in block.strip().splitlines()], dtype=float) for block in blocks
    ]
    for table in tables:
        if not np.array_equal(table[:, 0], nodes + 1):
            raise RuntimeError("ccx printed other nodes than the patches'")
    return Reactions(
        node=nodes, force_N=np.stack([table[:, 1:4] for table in tables[-levels:]]), seconds=seconds
    )
