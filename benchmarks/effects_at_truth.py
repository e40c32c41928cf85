"""What the model of each effect leaves at the effect's true parameters: its own error, without noise.

    python benchmarks/effects_at_truth.py FOLDER [--case open-26 --case ...] [--out CSV]

FOLDER holds cases of an independent simulator without noise, with exact surfaces: `case.toml`, `fruit.ply`,
`grasp-K.h5` and `truth.json` (E, effect, parameters, pit and pit_centre in mm). The true pit is put in place
of the prior's; for an effect of the pit that is all. Printed per case: E over the true E and the rms residual
of the markers (um), mean of the recordings, without and with the effect's full model. Each recording has its
own E and rigid motions, and nothing else is fitted. Large deformation of the plain flesh is included.
"""

import json
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import trimesh
from plain_model_verification import opened
from script import run
from threadpoolctl import threadpool_limits

from fem.estimation.compliance_fit import fit_compliance
from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Response
from fem.mismatch.evidence.beyond_small_strain import displacement_beyond
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.procedure import case_model

COLUMNS = ("case", "effect", "E_without", "residual_without_um", "E_with", "residual_with_um")
SCALE_SD = 1e-6
"""Relative error of markers' scales: none."""


def with_true_pit(folder: Path, truth: Mapping[str, Any]) -> CaseModel:
    """The plain model of a case about its true pit."""
    with tempfile.TemporaryDirectory() as work:
        pit = trimesh.creation.icosphere(subdivisions=4)
        pit.apply_scale(truth["pit"])
        pit.apply_translation(truth["pit_centre"])
        pit.export(Path(work) / "pit.ply")
        grasps = sorted(folder.glob("grasp-*.h5"))
        return case_model(
            opened(folder / "case.toml", folder / "fruit.ply", Path(work) / "pit.ply", *grasps)
        )[0]


def as_searched(truth: Mapping[str, Any]) -> dict[str, float]:
    """The true parameters by the names of a search."""
    known = truth["parameters"]
    if truth["effect"] == "skin":
        return {"Et_over_E_mm": known["Et_N_per_mm"] / truth["E"]}
    if truth["effect"] == "soft_spot":
        centre = {f"centre_mm.{axis}": float(x) for axis, x in enumerate(known["centre_mm"])}
        return centre | {"radius_mm": known["radius_mm"], "ratio": known["ratio"]}
    return {name: float(x) for name, x in known.items() if np.ndim(x) == 0 and not isinstance(x, str)}


def fitted(model: CaseModel, response: Response, true_MPa: float) -> tuple[float, float]:
    """E over the true E and the residual, um, mean of the recordings."""
    beyond = displacement_beyond(model)
    shares, residuals = [], []
    for k, recording in enumerate(model.grasps):
        shift = beyond[k] if response.shift_mm is None else beyond[k] + response.shift_mm[k]
        tracks = replace(
            recording.tracks,
            unit_displacement=response.unit[k],
            position_mm=recording.tracks.position_mm - shift,
        )
        fit = fit_compliance(tracks, scale_sd=SCALE_SD, fruit_moves=True)
        shares.append(model.modulus_scale / fit.compliance / true_MPa)
        residuals.append(1e3 * fit.residual_rms_mm)
    return float(np.mean(shares)), float(np.mean(residuals))


def row(folder: Path) -> tuple[str, ...]:
    """One case; of several ways of an effect the one that leaves least."""
    truth = json.loads((folder / "truth.json").read_text())
    model = with_true_pit(folder, truth)
    model = replace(model, compliance=model.modulus_scale / truth["E"])
    effect = next(effect for effect in EFFECTS if effect.spec.name == truth["effect"])
    without = fitted(model, Response.plain(model), truth["E"])
    tried = [without]
    if truth["effect"] not in ("pit_size", "pit_offset"):
        ways = {
            signature.variant.pit_turns: signature.variant
            for signature in effect.signatures(model)
            if signature.columns or effect.seen_directly
        }
        tried = [
            fitted(model, effect.respond(model, as_searched(truth), way), truth["E"]) for way in ways.values()
        ]
    best = min(tried, key=lambda pair: pair[1])
    return folder.name, truth["effect"], *(f"{x:.4g}" for x in (*without, *best))


def main(folder: Path, case: list[str] | None = None, out: Path | None = None) -> None:
    """A case after the other."""
    folders = [path.parent for path in sorted(folder.glob("*/truth.json"))]
    pd.DataFrame(columns=COLUMNS).to_csv(out or sys.stdout, index=False)
    for where in folders:
        if not case or where.name in case:
            pd.DataFrame([row(where)]).to_csv(out or sys.stdout, mode="a", header=False, index=False)
            sys.stdout.flush()


if __name__ == "__main__":
    with threadpool_limits(1):
        run(main)
