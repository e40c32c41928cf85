"""Print how much the modulus changes with mesh, surface, pit and pose, each computed anew.

It checks by brute force what fem.estimation.sensitivity gets from derivatives.

    python benchmarks/modulus_sensitivity.py FOLDER CASE [CASE ...] [--grasps 1 2] [--only TEXT]

Each row changes one thing of a case and prints, per grasp, E over the E of the unchanged case, in percent.
"""

import argparse
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import grasp_model
from fem.estimation.modulus import estimate_modulus
from fem.estimation.prepared_grasp import prepared_grasp
from fem.fem_failure import FemFailure
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes
from pipeline.fruit.placed_grasp import grasp_case, place_grasp
from recon.surface.mesh_file import read_mesh

Surface = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Setting:
    """One way to compute a case."""

    outer: Surface
    pit: Surface
    edge_mm: float = 5.0
    pad_edge_mm: float = 2.0
    fruit_from_fruit: Callable[[np.ndarray], np.ndarray] = lambda points: points


def moduli(setting: Setting, files: list[Path], *, poisson_ratio: float) -> np.ndarray:
    """E of every grasp, one mesh for all."""
    outer = (setting.fruit_from_fruit(setting.outer[0]), setting.outer[1])
    pit = (setting.fruit_from_fruit(setting.pit[0]), setting.pit[1])
    grasps = [place_grasp(file, *outer) for file in files]
    touched = np.vstack([points for grasp in grasps for points in grasp.touched_mm.values()])
    mesh = tetrahedralise(
        *outer, *pit, edge_mm=setting.edge_mm, refine_at_mm=touched, refine_edge_mm=setting.pad_edge_mm
    )
    histories = [prepared_grasp(one.history, one.turns).history for one in map(grasp_case, grasps)]
    solid = UnitModulusSolid.factorise(
        mesh, poisson_ratio=poisson_ratio, support="free", contact_nodes=contact_nodes(mesh, histories)
    )
    models = [grasp_model(one, solid) for one in histories]
    found = [estimate_modulus(*pair, budget=ErrorBudget()) for pair in zip(histories, models, strict=True)]
    return np.array([one.E_MPa for one in found])


def waved(surface: Surface, sd_mm: float, rng: np.random.Generator, *, waves: int = 12) -> Surface:
    """The surface moved along its radius by a smooth random field of that spread, about 15 mm long."""
    vertices, faces = surface
    centre = vertices.mean(axis=0)
    radial = (vertices - centre) / np.linalg.norm(vertices - centre, axis=1)[:, None]
    k = rng.normal(size=(waves, 3)) * 0.3
    field = np.cos(vertices @ k.T + rng.uniform(0, 2 * np.pi, waves)).sum(axis=1) * np.sqrt(2 / waves)
    return vertices + sd_mm * field[:, None] * radial, faces


def turned(angle_deg: float, axis: int) -> Callable[[np.ndarray], np.ndarray]:
    """Fruit and pit turned about one axis against the poses."""
    a = np.radians(angle_deg)
    i, j = [k for k in range(3) if k != axis]
    rotation = np.eye(3)
    rotation[i, i] = rotation[j, j] = np.cos(a)
    rotation[i, j], rotation[j, i] = -np.sin(a), np.sin(a)
    return lambda points: points @ rotation.T


def variations(base: Setting) -> dict[str, Setting]:
    """What is changed, by name."""
    rng = np.random.default_rng(5)
    centre = base.pit[0].mean(axis=0)
    rows = {f"edge at pads {h} mm": replace(base, pad_edge_mm=h) for h in (3.0, 1.5)}
    rows |= {f"edge inside {h} mm": replace(base, edge_mm=h) for h in (6.5, 4.0)}
    rows |= {
        f"pit moved 0.5 mm along {axis}": replace(base, pit=(base.pit[0] + 0.5 * np.eye(3)[k], base.pit[1]))
        for k, axis in enumerate("xyz")
    }
    rows |= {
        f"pit scaled {s}": replace(base, pit=(centre + s * (base.pit[0] - centre), base.pit[1]))
        for s in (0.97, 1.03, 0.9)
    }
    rows |= {
        f"surface waved {sd} mm": replace(base, outer=waved(base.outer, sd, rng)) for sd in (0.1, 0.15, 0.3)
    }
    rows |= {
        "surface 0.15 mm out": replace(base, outer=(base.outer[0] * (1 + 0.15 / 29), base.outer[1])),
        "fruit and pit 1 % larger": replace(base, fruit_from_fruit=lambda points: 1.01 * points),
        "fruit moved 1 mm along x": replace(
            base, fruit_from_fruit=lambda points: points + np.array([1.0, 0, 0])
        ),
        "fruit moved 1 mm along y": replace(
            base, fruit_from_fruit=lambda points: points + np.array([0, 1.0, 0])
        ),
        "fruit turned 3 degrees about x": replace(base, fruit_from_fruit=turned(3, 0)),
        "fruit turned 3 degrees about z": replace(base, fruit_from_fruit=turned(3, 2)),
    }
    return rows


def main() -> None:
    """All rows of the named cases."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="+")
    parser.add_argument("--grasps", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--only", default="")
    args = parser.parse_args()
    for name in args.cases:
        case = args.folder / name
        nu = float(tomllib.loads((case / "case.toml").read_text())["poisson_ratio"])
        base = Setting(outer=read_mesh(case / "fruit.ply"), pit=read_mesh(case / "pit.ply"))
        files = [case / f"grasp-{g}.h5" for g in args.grasps]
        reference = moduli(base, files, poisson_ratio=nu)
        print(name, "E", reference.round(4), "MPa", flush=True)
        for title, setting in variations(base).items():
            if args.only in title:
                try:
                    change = 100 * (moduli(setting, files, poisson_ratio=nu) / reference - 1)
                except FemFailure as failure:
                    print(f"  {title:32s} {failure}", flush=True)
                    continue
                print(f"  {title:32s}", "  ".join(f"{c:+6.2f} %" for c in change), flush=True)
        for nu_other in (nu - 0.02, nu + 0.02):
            if args.only in "nu":
                change = 100 * (moduli(base, files, poisson_ratio=nu_other) / reference - 1)
                print(f"  {f'nu {nu_other:.2f}':32s}", "  ".join(f"{c:+6.2f} %" for c in change), flush=True)


if __name__ == "__main__":
    main()
