"""An explanation as the finder gives it, all its parts filled, with an answer of the test's choosing."""

from dataclasses import replace

import numpy as np

from fem.mismatch.catalogue import SPECS
from fem.mismatch.result import (
    Candidate,
    Explanation,
    FruitMap,
    GraspTrace,
    HeldOut,
    Modulus,
    ModulusCell,
    Parameter,
    Where,
)
from recon.silhouettes.hull import ball


def candidate(effect, probability, **parameters):
    made = {}
    for name, value in parameters.items():
        if isinstance(value, str):
            made[name] = Parameter(value=value, sd=None, unit="")
        elif isinstance(value, tuple):
            made[name] = Parameter(value=value, sd=tuple(0.1 for _ in value), unit="mm")
        else:
            interval = (0.92 * value, 1.08 * value)
            known = (SPECS[part].parameter(name.rpartition(".")[2]) for part in effect.split("+"))
            unit = next(parameter.unit for parameter in known if parameter)
            made[name] = Parameter(value=value, sd=0.05 * abs(value), unit=unit, interval=interval)
    return Candidate(
        effect=effect,
        probability=probability,
        parameters=made,
        log_evidence=200.0 * probability,
        gain=410.0 * probability,
        heldout=(150.0 * probability, 12.0),
        refitted=True,
        modulus=Modulus(value=0.315, sd=0.006),
    )


VISCOELASTIC = candidate("viscoelastic", 0.97, g=0.31, tau_s=4.2)
GAIN = candidate("sensor_gain", 0.98, pad="left", gain=1.138)
OTHERS = (candidate("clock_lag", 0.02, lag_s=0.08), candidate("skin", 0.01, Et_N_per_mm=1.1))


def fake_map(rng):
    direction, triangles = ball(3)
    vertices = direction * [30, 29, 28] + [0, 0, 28]
    spot = np.exp(-((np.linalg.norm(direction - [0.96, 0.27, 0], axis=1) / 0.35) ** 2))
    seen = np.maximum(np.exp(-((np.arccos(abs(direction[:, 0]).clip(0, 1)) / 0.6) ** 2)) * 60, 0.1)
    score = -9 * spot + rng.normal(0, 0.4, len(direction))
    return FruitMap(vertices_mm=vertices, triangles=triangles, modulus_score=score, visible=seen)


def fake_explanation(**changes):
    rng = np.random.default_rng(5)
    cells, traces = [], []
    for grasp in ("grasp-1", "grasp-2", "grasp-3", "grasp-4"):
        t = np.linspace(1.0, 9.0, 60)
        phase = np.where(t < 3, "load", np.where(t < 7, "hold", "unload"))
        depth = np.interp(t, [1, 3, 7, 9], [0, 1.2, 1.2, 0])
        force = 14 * depth**1.5 * (1 - 0.3 * (1 - np.exp(-(t - 1) / 3)))
        for pad in ("left", "right"):
            for i in range(4, 58, 2):
                E = 0.33 * (1 - 0.3 * (1 - np.exp(-(t[i] - 1) / 3))) + rng.normal(0, 0.004)
                frame = {"time_s": float(t[i]), "phase": str(phase[i]), "E_MPa": float(E)}
                cells.append(ModulusCell(grasp=grasp, pad=pad, E_sd_MPa=0.004, **frame))
        recorded = {"time_s": t, "phase": tuple(map(str, phase)), "force_N": force}
        travel = {"given_mm": depth + rng.normal(0, 0.004, len(t)), "before_mm": 0.9 * depth}
        traces.append(GraspTrace(grasp=grasp, **recorded, **travel, after_mm=depth))
    explanation = Explanation(
        detected=True,
        p_value=0.002,
        statistics={"chi-square": 0.002, "blocks": 0.002, "lag 1": 0.004, "Moran's I": 0.2},
        where=Where(region="both"),
        when="hold",
        component="normal",
        ranking=(VISCOELASTIC, *OTHERS),
        verdict="viscoelastic",
        before=Modulus(value=0.262, sd=0.011),
        after=Modulus(value=0.315, sd=0.006),
        heldout=HeldOut(rms_before=2.61, rms_after=1.04, noise_rms=1.0),
        next_grasp="Hold one grasp for 30 s: relaxation goes on, a clock's lag does not.",
        cells=tuple(cells),
        traces=tuple(traces),
        maps=fake_map(rng),
        notes=("One remark of the finder.",),
        seconds={"detect": 3.1, "name": 20.4},
    )
    return replace(explanation, **changes)
