"""From placed grasps and the flesh's mesh to the modulus; the dense responses are kept on disk."""

import hashlib
from collections.abc import Sequence

import numpy as np

from fem.assembly import assemble
from fem.failure import FemFailure
from fem.forward import UnitModulusSolid
from fem.fruit_modulus import FruitInference, infer_modulus
from fem.grasp_model import GraspModel, grasp_model
from fem.grasp_sensitivity import POISSON_RATIO, Sensitivity
from fem.mesh import FleshMesh
from fem.modulus_budget import ErrorBudget
from fem.modulus_joint import FruitModulus
from fem.pad_link import contact_nodes
from pipeline.cache import Artifact, cached, stage_key
from pipeline.grasp import PlacedGrasp, history
from pipeline.records import ModulusRecord, PitFoundRecord
from pipeline.task import FruitTask


def on_skin(grasps: Sequence[PlacedGrasp], mesh: FleshMesh) -> tuple[list[PlacedGrasp], dict[str, str]]:
    """The grasps whose markers sit on the mesh's skin, and why each of the others does not."""
    found, failures = [], {}
    for grasp in grasps:
        try:
            contact_nodes(mesh, [history(grasp)])
            found.append(grasp)
        except FemFailure as failure:
            failures[grasp.name] = failure.detail
    return found, failures


def fruit_modulus(
    task: FruitTask,
    grasps: Sequence[PlacedGrasp],
    mesh: FleshMesh,
    *,
    poisson_ratio: float,
    budget: ErrorBudget,
) -> FruitInference:
    """The fruit's modulus, and the pit's place where several grasps tell; raises FemFailure."""
    return infer_modulus(
        [history(grasp) for grasp in grasps],
        mesh,
        lambda moved: responses(task, grasps, moved, poisson_ratio=poisson_ratio),
        budget=budget,
    )


def modulus_record(found: FruitModulus) -> ModulusRecord:
    """What the fruit's record says of its modulus and of the pit that came with it."""
    pit = found.pit
    return ModulusRecord(
        E_MPa=found.E_MPa,
        E_sd_MPa=found.E_sd_MPa,
        common_sd_MPa=found.parts_sd_MPa.get(POISSON_RATIO, 0.0),
        parts_sd_MPa=found.parts_sd_MPa,
        pit_found=None
        if pit is None
        else PitFoundRecord(
            offset_mm=tuple(pit.offset_mm.tolist()),
            offset_sd_mm=tuple(pit.sd[:3].tolist()),
            offset_prior_sd_mm=tuple(pit.prior_sd[:3].tolist()),
            size=float(np.exp(pit.ln_size)),
            size_sd=float(np.exp(pit.ln_size) * pit.sd[3]),
            size_prior_sd=float(pit.prior_sd[3]),
            moved=tuple(pit.moved.tolist()),
        ),
    )


def responses(
    task: FruitTask, grasps: Sequence[PlacedGrasp], mesh: FleshMesh, *, poisson_ratio: float
) -> list[GraspModel]:
    """The models of all grasps on one mesh: one factorisation per support; kept by content."""
    histories = [history(grasp) for grasp in grasps]
    digest = hashlib.sha256()
    for array in (mesh.nodes_mm, mesh.tets, mesh.outer_faces, mesh.pit_nodes):
        digest.update(np.ascontiguousarray(array).tobytes())
    for pad in (pad for one in histories for pad in one.pads):
        for array in (pad.rest_mm, pad.surface_mm, pad.force_N, pad.episode):
            digest.update(np.ascontiguousarray(array).tobytes())
    supports = [grasp.recording.support for grasp in grasps]
    names = [grasp.name for grasp in grasps]
    key = stage_key(
        "response",
        files=[],
        settings=[digest.hexdigest(), supports, names, poisson_ratio],
        rooms=("pipeline", "fem"),
    )

    def compute() -> Artifact:
        parts = assemble(mesh.nodes_mm, mesh.tets)
        models: dict[int, GraspModel] = {}
        for support in dict.fromkeys(supports):
            held = [k for k, one in enumerate(supports) if one == support]
            solid = UnitModulusSolid.factorise(
                mesh,
                poisson_ratio=poisson_ratio,
                support=support,
                parts=parts,
                contact_nodes=contact_nodes(mesh, [histories[k] for k in held]),
            )
            models |= {k: grasp_model(histories[k], solid) for k in held}
        return _packed([models[k] for k in range(len(grasps))])

    return _unpacked(cached(task.results.cache, "response", key, compute))


def _packed(models: Sequence[GraspModel]) -> Artifact:
    """C is symmetric and known to a thousandth: one triangle of it in single precision."""
    arrays: dict[str, np.ndarray] = {}
    for k, model in enumerate(models):
        rows = np.tril_indices(len(model.compliance))
        arrays |= {
            f"{k} place_mm": model.place_mm,
            f"{k} normal": model.normal,
            f"{k} compliance": model.compliance[rows].astype(np.float32),
            f"{k} sensitivity": model.sensitivity.values.astype(np.float32),
        }
    facts = [
        {
            "causes": model.sensitivity.causes,
            "discretisation": model.discretisation,
            "fruit_moves": model.fruit_moves,
        }
        for model in models
    ]
    return Artifact(arrays=arrays, facts={"models": facts})


def _unpacked(artifact: Artifact) -> list[GraspModel]:
    models = []
    for k, facts in enumerate(artifact.facts["models"]):
        place_mm = artifact.arrays[f"{k} place_mm"]
        size = 3 * len(place_mm)
        compliance = np.zeros((size, size))
        compliance[np.tril_indices(size)] = artifact.arrays[f"{k} compliance"]
        compliance += np.tril(compliance, -1).T
        models.append(
            GraspModel(
                place_mm=place_mm,
                normal=artifact.arrays[f"{k} normal"],
                compliance=compliance,
                sensitivity=Sensitivity(
                    causes=tuple(facts["causes"]),
                    values=artifact.arrays[f"{k} sensitivity"].astype(float),
                ),
                discretisation=facts["discretisation"],
                fruit_moves=facts["fruit_moves"],
            )
        )
    return models
