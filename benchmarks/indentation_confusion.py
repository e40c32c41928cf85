"""Presses with a known hidden effect, explained: confusion matrix, parameters, coverage, false alarms.

    python benchmarks/indentation_confusion.py [--traces N] [--nulls N] [--only NAME ...]

The presses are those of tests/fem/injected_presses.py: force-depth curves from axisymmetric finite elements,
memory by Ting's own integrals; modulus, speed, onset, noise (white or coloured) and air time are drawn.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

from fem.indentation.account import account_for
from fem.indentation.ball import Ball
from fem.indentation.trace import IndenterTrace

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fem"))
from injected_presses import NU, RADIUS_MM, THICK_MM, Press, injected

#: a machine's give (mm/N) times E (MPa): half a millimetre at the deepest point
GIVE = 0.04
#: a load cell's drift (N/s) over E (MPa)
DRIFT = 0.02
KINDS: dict[str, dict[str, object]] = {
    "none": {},
    "viscoelastic": {"relaxes": True},
    "stiffening b=8": {"law": "stiffening b=8"},
    "stiffening b=2": {"law": "stiffening b=2"},
    "damage .5 .01": {"law": "damage dmax=0.5 W0_over_E=0.01"},
    "damage .4 .03": {"law": "damage dmax=0.4 W0_over_E=0.03"},
    "plastic_set .1": {"law": "plastic_set yield_over_E=0.1"},
    "plastic_set .05": {"law": "plastic_set yield_over_E=0.05"},
    "gripper_compliance": {"give": True},
    "sensor_drift": {"drift": True},
    "stiffening+viscoelastic": {"law": "stiffening b=8", "relaxes": True},
    "sensor_drift+viscoelastic": {"drift": True, "relaxes": True},
    "gripper_compliance+viscoelastic": {"give": True, "relaxes": True},
    "unknown": {"puncture": 0.3},
}


def draw(kind: str, rng: np.random.Generator) -> tuple[IndenterTrace, dict[str, float]]:
    """A trace and the parameters behind it."""
    wanted = dict(KINDS[kind])
    E = float(np.exp(rng.uniform(np.log(0.1), np.log(1.0))))
    truth = {"E_MPa": E}
    if wanted.pop("relaxes", False):
        truth |= {"g": rng.uniform(0.15, 0.55), "tau_s": float(np.exp(rng.uniform(np.log(0.6), np.log(20))))}
        wanted |= {"g": (truth["g"],), "tau_s": (truth["tau_s"],)}
    if wanted.pop("give", False):
        truth["mm_per_N"] = wanted["mm_per_N"] = GIVE / E * rng.uniform(0.6, 1.5)
    if wanted.pop("drift", False):
        truth["newton_per_s"] = wanted["newton_per_s"] = DRIFT * E * rng.choice([-1, 1]) * rng.uniform(0.5, 2)
    for word, name in (("stiffening b=", "b"), ("plastic_set yield_over_E=", "yield_over_E")):
        if str(wanted.get("law", "")).startswith(word):
            truth[name] = float(str(wanted["law"]).removeprefix(word))
    if str(wanted.get("law", "")).startswith("damage"):
        truth["dmax"], truth["W0_over_E"] = (
            float(part.split("=")[1]) for part in str(wanted["law"]).split()[1:]
        )
    press = Press(
        air_s=rng.choice([1.0, 3.0, 5.0]),
        ramp_s=rng.choice([2.0, 4.0, 8.0]),
        onset_mm=rng.choice([0.05, 0.2, 1.0]),
    )
    truth["onset_mm"] = press.onset_mm
    noise = 12 * E / rng.choice([300, 1000, 3000])
    time_s, force, travel = injected(
        rng, E_MPa=E, noise_N=noise, fade=rng.choice([0.0, 0.5]), press=press, **wanted
    )
    return IndenterTrace(
        time_s=time_s, force_N=force, travel_mm=travel, geometry=Ball(radius_mm=RADIUS_MM)
    ), truth


def main() -> None:
    """Draw, explain, count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--traces", type=int, default=3)
    parser.add_argument("--nulls", type=int, default=20)
    parser.add_argument("--only", nargs="*", default=list(KINDS))
    chosen = parser.parse_args()
    off: dict[str, list[tuple[float, bool]]] = {}
    seconds, right, first_two, covered, sizes, ratios = [], [], [], [], [], []
    for kind in chosen.only:
        name = kind.split(" ")[0]
        said = Counter()
        for k in range(chosen.nulls if kind == "none" else chosen.traces):
            rng = np.random.default_rng([k, list(KINDS).index(kind)])
            trace, truth = draw(kind, rng)
            start = time.process_time()
            account = account_for(trace, thickness_mm=THICK_MM, poisson_ratio=NU, rng=rng)
            seconds.append(time.process_time() - start)
            explanation = account.explanation
            verdict = explanation.verdict
            names = (verdict,) if isinstance(verdict, str) else verdict
            said[" | ".join(names)] += 1
            if kind == "none":
                continue
            order = [c.effect for c in explanation.ranking]
            if name != "unknown":
                right.append(order[0] == name and verdict != "none")
                first_two.append(name in order[:2] and verdict != "none")
            covered.append(name in names)
            sizes.append(len(names))
            if name in names and name in order:
                candidate = explanation.ranking[order.index(name)]
                parameters = dict(candidate.parameters)
                E = candidate.modulus
                off.setdefault(f"E_MPa of {name}", []).append(
                    (E.value / truth["E_MPa"] - 1, abs(E.value - truth["E_MPa"]) < 1.645 * E.sd)
                )
                for parameter, true in truth.items():
                    if parameter in parameters:
                        found = parameters[parameter]
                        low, high = found.interval
                        off.setdefault(f"{parameter} of {name}", []).append(
                            (found.value / true - 1, low <= true <= high)
                        )
                ratios.append(account.end.rms(account.trace.force_N))
        print(f"{kind:34s}", "  ".join(f"{n} x {v}" for v, n in said.most_common()), flush=True)
    print("\nparameter: median error, share of 90 % intervals that hold the truth, traces")
    for name, rows in off.items():
        error, inside = zip(*rows, strict=True)
        print(f"{name:46s} {np.median(np.abs(error)):8.3f} {np.mean(inside):6.2f} {len(rows):4d}")
    if right:
        print(
            f"\nright name first {np.mean(right):.2f}, in the first two {np.mean(first_two):.2f}, "
            f"verdict holds it {np.mean(covered):.2f}, mean size {np.mean(sizes):.2f}"
        )
        before, after = np.array(ratios).T
        print(f"held-out error cut {np.median(before / after):.1f} times (median)")
    print(f"CPU {np.median(seconds):.1f} s a trace (median)")


if __name__ == "__main__":
    main()
