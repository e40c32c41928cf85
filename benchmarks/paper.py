"""Print the published experiments, what the paper reports, and what this estimator makes of the same ones.

    python benchmarks/paper.py [--only TEXT] [--csv FILE]

Zhao, Ding, Zhao, Hu, Ma, "Core-Agnostic Compliance Perception for Rigid-Deformable Coupled Objects using
Vision-Based Tactile Sensing". The truth is CalculiX's, from forward/; all
errors are of E against its 0.1 MPa, in percent. "ours" is the least-squares modulus, "energy" the
strain-energy ratio. Where two are compared, the number is the change between them.

A row with a target says whether |ours| keeps it. A contact has 11 x 11 markers, whatever its size (the
paper's contact nodes are those of its mesh, too); rows say so where they are 1 mm apart instead.

`--csv` writes the rows to this file; without it and without `--only`, they replace results/paper.csv.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
from paper_data import HERE, Forward, between_plates, forward, grasp_history
from paper_shapes import Core, box, core_surface
from script import run

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.finite_response import with_finite_strain
from fem.estimation.fruit_modulus import infer_modulus
from fem.estimation.grasp_model import GraspModel, grasp_model
from fem.estimation.modulus import ModulusEstimate, estimate_modulus
from fem.fem_failure import FemFailure
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh, tetrahedralise
from fem.solid.closed_forms import hertz_sphere_force_N, s368_parallel_plates_modulus_MPa
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from decoupled_neo_hookean import DecoupledNeoHookean

E_MPA, POISSON_RATIO = 0.1, 0.45
EXACT = ErrorBudget(gel_scale_sd=1e-6, force_scale_sd=1e-6, pose_sd_mm=0.0, surface_sd_mm=0.0)
CELLS = 10
"""Between the markers along an edge of a contact."""
FINE, COARSE = (4.0, 0.08, 70_000), (6.0, 0.1, 45_000)
"""Edges inside (mm), at the rim of a contact as a share of its own edge, and the most degrees of freedom.

Traction and strain are singular at the rim. Coarse: where eight percent are at stake.
"""
SQUARE_PUNCH = 1.012
"""F = 2 beta E* (A / pi)^(1/2) delta of a square punch: King, Int. J. Solids Structures 23 (1987) 1657."""


PaperRow: TypeAlias = dict[str, Any]
"""One line of the table; percent throughout, NaN where there is nothing to say."""


@dataclass(frozen=True, kw_only=True)
class FittedModulus:
    """Relative errors of E by least squares and by energy, with what they cost."""

    error: float
    energy: float = np.nan
    dofs: int = 0
    seconds: float = 0.0

    @staticmethod
    def of(estimate: ModulusEstimate, mesh: FleshMesh, start_s: float) -> "FittedModulus":
        """Errors of an estimate, and the processor time since `start_s`."""
        return FittedModulus(
            error=estimate.E_MPa / E_MPA - 1,
            energy=estimate.energy.E_MPa / E_MPA - 1 if estimate.energy else np.nan,
            dofs=mesh.nodes_mm.size,
            seconds=time.process_time() - start_s,
        )


def _mesh(
    data: Forward, core: Core | None, *histories: GraspHistory, size: tuple[float, float, int] = FINE
) -> FleshMesh:
    """The estimator's own mesh: tetrahedra of fem.mesh.flesh_mesh, finer along the rims of the contacts."""
    rims = []
    for history in histories:
        for pad in history.pads:
            flat = np.abs(pad.rest_mm[:, :2])
            rims.append(pad.surface_mm[(flat > flat.max() - 1e-6).any(axis=1)])
    inside_mm, rim_share, dof_limit = size
    rim_mm = rim_share * min(pad.edge_mm for pad in data.pads)
    pit = (None, None) if core is None else core_surface(core)
    return tetrahedralise(
        *box(data.low_mm, data.high_mm),
        *pit,
        edge_mm=inside_mm,
        refine_at_mm=np.vstack(rims),
        refine_radius_mm=rim_mm,
        refine_edge_mm=rim_mm,
        dof_limit=dof_limit,
    )


def _solid(mesh: FleshMesh, base_fixed: bool, *histories: GraspHistory) -> UnitModulusSolid:
    return UnitModulusSolid.factorise(
        mesh,
        poisson_ratio=POISSON_RATIO,
        support="base" if base_fixed else "free",
        contact_nodes=contact_nodes(mesh, histories),
    )


def _modulus(
    history: GraspHistory, solid: UnitModulusSolid, budget: ErrorBudget = EXACT, *, finite: bool = False
) -> ModulusEstimate:
    """The one place where an estimate is made; `finite`: with the Neo-Hookean model."""
    model = grasp_model(history, solid)
    if finite:
        flesh = FiniteStrainSolid(solid=solid, law=DecoupledNeoHookean(poisson_ratio=POISSON_RATIO))
        model = with_finite_strain(
            model, history, flesh, recorded=history, force_sd_N=0.0, scale_sd=budget.gel_scale_sd
        )
    return estimate_modulus(history, model, budget=budget)


def _core(data: Forward, shift_mm: np.ndarray | tuple[float, ...] = (0.0, 0.0, 0.0)) -> Core:
    return Core(
        shape=data.core, size_mm=data.core_size_mm, centre_mm=tuple(data.core_centre_mm + np.array(shift_mm))
    )


@cache
def fitted_modulus(
    name: str,
    *,
    shift_mm: tuple[float, ...] = (0.0, 0.0, 0.0),
    homogeneous: bool = False,
    depth_mm: float = 1.0,
    finite: bool = False,
    cells: int = CELLS,
    size: tuple[float, float, int] = FINE,
) -> FittedModulus:
    """E from one forward solution; the estimator's core shifted against the true one, or left out."""
    start = time.process_time()
    data = forward(name)
    history = grasp_history(data, cells=cells, levels=data.levels <= depth_mm + 1e-9)
    mesh = _mesh(data, None if homogeneous else _core(data, shift_mm), history, size=size)
    solid = _solid(mesh, data.base_fixed, history)
    return FittedModulus.of(_modulus(history, solid, finite=finite), mesh, start)


def _row(
    experiment: str, case: str, paper: str, target: float | None, name: str, got: FittedModulus
) -> PaperRow:
    keeps = "" if target is None else "ok" if 100 * abs(got.error) <= target else "miss"
    return {
        "experiment": experiment,
        "case": case,
        "paper": paper,
        "target": target,
        "ours": 100 * got.error,
        "energy": 100 * got.energy,
        "verdict": keeps,
        "forward_dofs": FORWARD_DOFS[name],
        "dofs": got.dofs,
        "seconds": got.seconds,
    }


def _against(fitted: FittedModulus, other: FittedModulus) -> FittedModulus:
    """The change from `other` to `fitted`."""
    return replace(
        fitted,
        error=(1 + fitted.error) / (1 + other.error) - 1,
        energy=(1 + fitted.energy) / (1 + other.energy) - 1,
    )


def material() -> Iterator[PaperRow]:
    """Fig. 3c: the same linear estimator on linear and on Neo-Hookean truth, by depth of the press."""
    for kind in ("press", "grasp"):
        linear = fitted_modulus(f"{kind}-linear")
        yield _row("material", f"{kind}, linear truth", "", None, f"{kind}-linear", linear)
        for depth in (0.4, 1.0):
            got = fitted_modulus(f"{kind}-neo-hookean", depth_mm=depth)
            case = f"{kind}, Neo-Hookean against linear truth, {depth} mm"
            yield _row("material", case, "2.01", 1.0, f"{kind}-neo-hookean", _against(got, linear))
        case = f"{kind}, the same with the Neo-Hookean model, 1.0 mm"
        try:
            got = fitted_modulus(f"{kind}-neo-hookean", finite=True, size=COARSE)
        except FemFailure as failure:
            got = FittedModulus(error=np.nan)
            case += f" ({failure.problem.value})"
        linear = fitted_modulus(f"{kind}-linear", size=COARSE)
        yield _row("material", case, "", 0.3, f"{kind}-neo-hookean", _against(got, linear))


def area() -> Iterator[PaperRow]:
    """Fig. 3d: the size of the contact."""
    sizes = ((1, "27.70", 3.0), (9, "", 2.0), (25, "8.66", 2.0), (100, "< 5", 1.0), (225, "< 5", 1.0))
    for mm2, paper, target in sizes:
        name = f"press-{mm2}mm2"
        yield _row("contact area", f"{mm2} mm2", paper, target, name, fitted_modulus(name))
    for mm2, cells in ((9, 3), (25, 5)):
        name, case = f"press-{mm2}mm2", f"{mm2} mm2, markers 1 mm apart"
        yield _row("contact area", case, "", None, name, fitted_modulus(name, cells=cells))


def wrong_core() -> Iterator[PaperRow]:
    """Fig. 4: the estimator's core is not where the true one is."""
    ways = (
        ("grasp", "grasp", "tangential", 1, 1.0),
        ("grasp", "grasp", "normal", 0, 1.0),
        ("press-100mm2", "press", "tangential", 0, 1.0),
        ("press-100mm2", "press", "normal", 2, 1.0),
        ("press-100mm2", "press", "normal", 2, -1.0),
    )
    for (name, title, word, axis, sign), steps in product(ways, (1, 2, 3, 4)):
        shift = tuple(sign * steps * float(k == axis) for k in range(3))
        got = fitted_modulus(name, shift_mm=shift, size=COARSE)
        yield _row("core misplaced", f"{title}, {word} {sign * steps:+.0f} mm", "8", 8.0, name, got)


def inferred_core() -> Iterator[PaperRow]:
    """The core 4 mm off the prior along an axis; two grasps of the same specimen say where it is."""
    for axis in "xy":
        yield _from_two("grasp along x and y", f"grasp-x-core-{axis}", f"grasp-y-core-{axis}", axis)
    for axis in "zx":
        yield _from_two("press on top and side", f"press-top-core-{axis}", f"press-side-core-{axis}", axis)


def _from_two(title: str, first: str, second: str, axis: str) -> PaperRow:
    start = time.process_time()
    data = forward(first)
    histories = [grasp_history(d, cells=CELLS) for d in (data, forward(second))]
    budget = replace(EXACT, pit_offset_sd_mm=3.0, pit_size_sd=1e-4)
    mesh = _mesh(data, _core(data, -data.core_centre_mm), *histories, size=COARSE)
    models = partial(_models, histories, base_fixed=data.base_fixed)
    fruit = infer_modulus(histories, mesh, models, budget=budget).modulus
    found_at = fruit.pit.offset_mm if fruit.pit else np.zeros(3)
    off = ", ".join(f"{x:+.1f}" for x in found_at)
    got = FittedModulus(
        error=fruit.E_MPa / E_MPA - 1,
        dofs=mesh.nodes_mm.size,
        seconds=time.process_time() - start,
    )
    return _row("core inferred", f"{title}, core +4 mm in {axis}, found ({off})", "", 3.0, first, got)


def _models(histories: list[GraspHistory], mesh: FleshMesh, *, base_fixed: bool) -> list[GraspModel]:
    solid = _solid(mesh, base_fixed, *histories)
    return [grasp_model(history, solid) for history in histories]


def position() -> Iterator[PaperRow]:
    """Fig. 5a: where on the face one presses."""
    middle = fitted_modulus("press-100mm2", size=COARSE)
    for at in (2, 4, 6, 8):
        name = f"press-at-{at}mm"
        change = _against(fitted_modulus(name, size=COARSE), middle)
        yield _row("position", f"{at} mm off the middle", "2.97", 1.5, name, change)


def shape() -> Iterator[PaperRow]:
    """Fig. 5b: cores of one volume and several shapes, known to the estimator."""
    ball = fitted_modulus("press-ball")
    yield _row("core shape", "ball, error", "", None, "press-ball", ball)
    for kind in ("cube", "star", "tetrahedron"):
        name = f"press-{kind}"
        change = _against(fitted_modulus(name), ball)
        yield _row("core shape", f"{kind} against ball", "0.57", 0.5, name, change)


def without_core() -> Iterator[PaperRow]:
    """The same data, by the same estimator without a core, and by a half-space under a square punch."""
    for name in ("grasp", *(f"press-{mm2}mm2" for mm2 in (1, 9, 25, 100, 225))):
        got = fitted_modulus(name, homogeneous=True, size=COARSE)
        yield _row("no core", f"{name}, same estimator", "", None, name, got)
        data = forward(name)
        pad = data.pads[0]
        force = abs(float(pad.force_N[-1].sum(axis=0) @ pad.move_mm))
        punch = 2 * SQUARE_PUNCH * pad.edge_mm / np.sqrt(np.pi)
        modulus = force / (data.levels[-1] * punch) * (1 - POISSON_RATIO**2)
        closed = FittedModulus(error=modulus / E_MPA - 1)
        yield _row("no core", f"{name}, half-space", "", None, name, closed)


def limits() -> Iterator[PaperRow]:
    """A ball without a core between plates, contact radius up to 0.02 of its own: where closed forms hold."""
    start = time.process_time()
    data = between_plates(cells=10)
    hertz = data.force_N / hertz_sphere_force_N(
        E_MPa=1.0,
        poisson_ratio=POISSON_RATIO,
        radius_mm=data.radius_mm,
        indentation_mm=data.approach_mm,
    )
    plates = s368_parallel_plates_modulus_MPa(
        force_N=data.force_N,
        deformation_mm=2 * data.approach_mm,
        poisson_ratio=POISSON_RATIO,
        radius_mm=data.radius_mm,
        other_radius_mm=data.radius_mm,
    )
    name = "ball-between-plates"
    for title, modulus in (("Hertz", hertz), ("ASABE S368, parallel plates", plates)):
        closed = FittedModulus(error=modulus / E_MPA - 1)
        yield _row("small press", f"ball between plates, {title}", "", 1.0, name, closed)
    mesh = tetrahedralise(
        *core_surface(Core(shape="ball", size_mm=data.radius_mm)),
        None,
        None,
        edge_mm=data.radius_mm / 4,
        refine_at_mm=np.array([[0, 0, data.radius_mm], [0, 0, -data.radius_mm]]),
        refine_radius_mm=data.contact_mm,
        refine_edge_mm=data.contact_mm / 8,
        dof_limit=FINE[2],
    )
    estimate = _modulus(data.history, _solid(mesh, False, data.history))
    got = FittedModulus.of(estimate, mesh, start)
    yield _row("small press", "ball between plates", "", 1.0, name, got)


EXPERIMENTS = (limits, material, area, wrong_core, inferred_core, position, shape, without_core)


FORWARD_DOFS = {"ball-between-plates": 31002, **pd.read_csv(HERE / "solved.csv").set_index("case")["dofs"]}


def main(only: str = "", csv: Path | None = None) -> None:
    """All rows, or those of some experiments; printed as they come."""
    print(
        f"{'experiment':<15} {'case':<66} {'paper':>6} {'target':>6} {'ours':>7} {'energy':>7}      "
        f"{'forward':>8} {'dofs':>6} {'CPU s':>5}"
    )
    rows = []
    for experiment in EXPERIMENTS:
        if only not in experiment.__name__:
            continue
        for row in experiment():
            rows.append(row)
            target = "" if row["target"] is None else f"{row['target']:g}"
            energy = "" if np.isnan(row["energy"]) else f"{row['energy']:+.2f}"
            print(
                "{experiment:<15} {case:<66} {paper:>6} {0:>6} {ours:>+7.2f} {1:>7} {verdict:<4} "
                "{forward_dofs:>8} {dofs:>6} {seconds:>5.1f}".format(target, energy, **row),
                flush=True,
            )
    path = csv or (None if only else Path(__file__).parent / "results" / "paper.csv")
    if path is not None:
        pd.DataFrame(rows).to_csv(path, index=False, float_format="%.3f")


if __name__ == "__main__":
    run(main)
