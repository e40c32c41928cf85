"""The plain model at finite strain against recordings of an independent simulator, with nothing unknown.

    python benchmarks/plain_model_verification.py FOLDER [--body ball --body ...] [--grasp 2 --grasp ...]
        [--dense]

FOLDER holds bodies without mismatch, noise-free, with exact surfaces (`truth.json`, `fruit.ply`, `pit.ply`,
`grasp-K.h5`, `dense/grasp-K.h5`). Each recording is read, placed and prepared as `drupe explain` does it;
with `--dense` those whose markers are 0.5 mm apart.
Printed for small and for finite strain: E over the true E, what the fit leaves of the markers' places (um rms
per component), and CPU seconds.
"""

import json
import shutil
import tempfile
import time
from pathlib import Path

from script import run
from threadpoolctl import threadpool_limits

from fem.estimation.compliance_fit import fit_compliance
from fem.estimation.finite_response import finite_response, neo_hookean_solid
from fem.estimation.grasp_model import grasp_model
from fem.estimation.prepared_grasp import prepared_grasp
from fem.estimation.unit_response import marker_tracks
from fem.mismatch.mismatch_case import MismatchCase
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import finer_mesh_of, mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

SURFACES = ("case.toml", "fruit.ply", "pit.ply")


def opened(*files: Path) -> MismatchCase:
    """A case of these files alone, as the finder is handed it."""
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work) / "case"
        folder.mkdir()
        for source in files:
            shutil.copy(source, folder / source.name)
        case = open_case(folder, fruit_id=None, work=Path(work) / "work", out=None)
        fruit = grasped_fruit(case.task, StageLog(lambda _: None), explains=True)
        return mismatch_case(case, fruit, finer_mesh=finer_mesh_of(case, fruit))


def line(case: MismatchCase, true_MPa: float) -> str:
    """A row of the table."""
    (grasp,) = case.grasps
    scale_sd = case.budget.gel_scale_sd
    solid = UnitModulusSolid.factorise(
        case.mesh,
        poisson_ratio=case.poisson_ratio,
        support="free",
        contact_nodes=contact_nodes(case.mesh, [grasp.history]),
    )
    prepared = prepared_grasp(grasp.history, grasp.turns)
    started = time.process_time()
    tracks, _ = marker_tracks(prepared.history, grasp_model(prepared.history, solid), prepared.used)
    small = fit_compliance(tracks, scale_sd=scale_sd, fruit_moves=True)
    small_s, started = time.process_time() - started, time.process_time()
    finite = finite_response(
        prepared.history,
        neo_hookean_solid(solid),
        recorded=grasp.history,
        force_sd_N=prepared.force_sd_N,
        modulus_MPa=1 / small.compliance,
        scale_sd=scale_sd,
    )
    finite_s = time.process_time() - started
    return (
        f"{1 / small.compliance / true_MPa:.4f} | {1e3 * small.residual_rms_mm:.1f} | {small_s:.0f} | "
        f"{finite.modulus_MPa / true_MPa:.4f} | {1e3 * finite.fit.residual_rms_mm:.2f} | {finite_s:.0f}"
    )


def main(
    folder: Path, body: list[str] | None = None, grasp: list[int] | None = None, dense: bool = False
) -> None:
    """A recording after the other."""
    print("| body | grasp | small strain: E / true | um | s | finite strain: E / true | um | s |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|", flush=True)
    for truth in sorted(folder.glob("*/truth.json")):
        place, true_MPa = truth.parent, float(json.loads(truth.read_text())["E"])
        for k in (grasp or (1, 2, 3, 4)) if not body or place.name in body else ():
            recording = (place / "dense" if dense else place) / f"grasp-{k}.h5"
            try:
                cells = line(opened(*(place / name for name in SURFACES), recording), true_MPa)
            except Exception as error:  # noqa: BLE001 - a row says it, the others follow
                cells = f"{type(error).__name__}: {error}"
            print(f"| {place.name} | {k} | {cells} |", flush=True)


if __name__ == "__main__":
    with threadpool_limits(1):
        run(main)
