"""Faults of the gels put into sound recordings, amounts drawn at random: which are seen, what becomes of E.

    python benchmarks/gel_fault_injected.py FOLDER CASE CASE CASE [--seed N]

FOLDER holds answers.json and sound cases. The faults are put into what the sensors said (markers' force and
displacement in pad axes), each at three sizes; at the end each case has a gel whose law truly bends and is
read rightly, which no fault may be named for. A line each: the fault, its true amounts and those that force
against displacement shows, the evidence and what the flesh's equations gain (fem.mismatch.gel_fault), E
before and with it (mean of the recordings' own fits) against the truth.
"""

import argparse
import json
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.gel_fault import GelFault
from fem.mismatch.mismatch_case import GraspCase, MismatchCase
from fem.mismatch.procedure import plain_forward_model
from fem.mismatch.selection.modulus_with import modulus_of
from fem.mismatch.signature_variant import ONE_WAY
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

SIZES = (0.03, 0.08, 0.2)
"""Of the faults, as shares: below, at and far above what sound recordings seem to have."""
COURSES = 6
"""Leading patterns of the recorded forces that stand for the true ones: the law bends these, not noise."""
LARGEST_OF_SCALES = 1.02
"""The largest of some 200 marker scales with 1 % of spread lies so much above one."""
BENT = "bent_gel"


def smooth(force_N: Float[np.ndarray, "t n 3"]) -> Float[np.ndarray, "t n 3"]:
    """The forces without most of their noise."""
    left, size, right = np.linalg.svd(force_N.reshape(len(force_N), -1), full_matrices=False)
    return np.asarray(((left[:, :COURSES] * size[:COURSES]) @ right[:COURSES]).reshape(force_N.shape))


def drawn(name: str, size: float, rng: np.random.Generator) -> dict[str, float]:
    """Amounts of one fault about a size."""
    sign, share = float(rng.choice([-1, 1])), size * float(rng.uniform(0.7, 1.3))
    if name == "sensor_nonlinear":
        return {"a": sign * share}
    if name == "gel_creep":
        return {"creep": share, "creep_tau_s": float(np.exp(rng.uniform(np.log(0.5), np.log(6.0))))}
    if name == "gel_hysteresis":
        return {"share": 0.6 * share}
    return {"strain_per_root_s": 0.006 * share, "N_per_root_s": 1.5 * share}


def altered_grasp(grasp: GraspCase, name: str, amounts: Mapping[str, float]) -> GraspCase:
    """One recording with the fault in it."""
    history = grasp.history
    turns = [motion.pose[:, :3, :3] for motion in grasp.pads]
    forces = [
        np.einsum("tji,tnj->tni", turn, pad.force_N) for turn, pad in zip(turns, history.pads, strict=True)
    ]
    largest = max(np.linalg.norm(smooth(own), axis=2).max() for own in forces) / LARGEST_OF_SCALES
    pads, motions = [], []
    for turn, pad, motion, force in zip(turns, history.pads, grasp.pads, forces, strict=True):
        moved = np.einsum("tji,tnj->tni", turn, pad.gel_displacement_mm)
        more_N, more_mm = np.zeros_like(force), np.zeros_like(moved)
        true = smooth(force)
        share = np.linalg.norm(true, axis=2, keepdims=True) / largest
        if name == "sensor_nonlinear":
            more_N = amounts["a"] * share * true
        elif name == BENT:
            more_mm = moved / (1 + amounts["a"] * share) - moved
        elif name == "gel_creep":
            memory = np.zeros_like(moved)
            for k, pause in enumerate(np.diff(history.time_s), 1):
                fading = np.exp(-pause / amounts["creep_tau_s"])
                memory[k] = fading * memory[k - 1] + (1 - fading) * moved[k]
            more_mm = amounts["creep"] * memory
        elif name == "gel_hysteresis":
            total = true[..., 2].sum(axis=1)
            peak = np.maximum.accumulate(np.maximum(total, 0.02 * total.max()))
            ratio = np.clip(total / peak, 0.0, 1.0)
            more_N = -(4 * amounts["share"] * ratio * (1 - ratio))[:, None, None] * true
        else:
            root = np.sqrt(history.time_s)
            loaded = np.flatnonzero(np.array(history.phase) != "air")[0]
            root = (root - root[: loaded - 1].mean())[:, None]
            more_mm = amounts["strain_per_root_s"] * root[..., None] * pad.rest_mm * [1.0, 1.0, 0.0]
            more_N[..., 2] = amounts["N_per_root_s"] / motion.markers * root
        shift = np.einsum("tij,tnj->tni", turn, more_mm)
        pads.append(
            replace(
                pad,
                force_N=pad.force_N + np.einsum("tij,tnj->tni", turn, more_N),
                gel_displacement_mm=pad.gel_displacement_mm + shift,
                position_mm=pad.position_mm if name == BENT else pad.position_mm + shift,
            )
        )
        motions.append(replace(motion, normal_N=motion.normal_N + more_N[..., 2].sum(axis=1)))
    return replace(grasp, history=replace(history, pads=tuple(pads)), pads=tuple(motions))


def line_of(case: MismatchCase, name: str, amounts: Mapping[str, float], true_E_MPa: float) -> str:
    """What is seen of one fault."""
    altered = replace(case, grasps=tuple(altered_grasp(grasp, name, amounts) for grasp in case.grasps))
    forward, _ = plain_forward_model(altered)
    error = modulus_of(forward).value / true_E_MPa - 1
    said = [f"{name} {_text(amounts)}", f"E {error:+.1%}"]
    for effect in EFFECTS:
        measured = effect.measured(forward) if isinstance(effect, GelFault) else None
        if not isinstance(effect, GelFault) or measured is None:
            continue
        seen = effect.direct_evidence(forward) > 0
        if not seen and effect.spec.name != name:
            continue
        after = modulus_of(forward, effect.respond(forward, measured.values, ONE_WAY)).value / true_E_MPa - 1
        said.append(
            f"{'SEEN' if seen else 'not seen'} {effect.spec.name} {_text(measured.values)}, evidence "
            f"{measured.evidence:.0f}, flesh {effect.flesh_gain(forward):+.0f}, E with it {after:+.1%}"
        )
    return "; ".join(said)


def _text(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in values.items())


def main() -> None:
    """Draw, inject, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("cases", nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    answers = json.loads((chosen.folder / "answers.json").read_text(encoding="utf-8"))
    rng = np.random.default_rng(chosen.seed)
    names = [effect.spec.name for effect in EFFECTS if isinstance(effect, GelFault)] + ["thermal_drift"]
    plan = [(name, drawn(name, size, rng)) for size in SIZES for name in dict.fromkeys(names)]
    plan += [(BENT, {"a": float(rng.choice([-1, 1]) * rng.uniform(0.15, 0.4))}) for _ in chosen.cases]
    with tempfile.TemporaryDirectory() as work, threadpool_limits(1):
        handed = {}
        for k, (name, amounts) in enumerate(plan):
            own = chosen.cases[k % len(chosen.cases)]
            if own not in handed:
                case = open_case(
                    chosen.folder.resolve() / own, fruit_id=None, work=Path(work) / own, out=None
                )
                handed[own] = mismatch_case(case, grasped_fruit(case.task, StageLog(str)))
            print(own, line_of(handed[own], name, amounts, float(answers[own]["E_MPa"])), flush=True)


if __name__ == "__main__":
    main()
