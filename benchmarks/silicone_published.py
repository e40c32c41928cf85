"""The laws that others published for silicone cylinders, at their published parameters, beside drupe's law.

    python benchmarks/silicone_published.py FOLDER PARAMETERS [--csv FILE]

FOLDER: as of silicone_cylinders.py. PARAMETERS: data/hyperelastic_parameters.json of the same repository, of
which only the mixtures of FOLDER are read: six families in eleven forms, each fitted once to engineering and
once to true stress of a mean curve. drupe's law is fitted to the first curve of a mixture. Every law then
predicts the force of the other curves, with their travel as recorded and nothing fitted again.

The repository states no end condition. Its parameters fit the recorded curves by the closed forms of an
incompressible cylinder that slides between the plates. True stress is engineering stress times the stretch,
so both kinds predict a force. Ogden's parameters are moduli first, then exponents: paired in turn, as the
repository's page labels them, they miss the curves by far. Writes for each mixture, form and kind of stress:

force_error  error of the force over its root mean square, mean over the curves
slope_kPa    of a line through the recorded origin over 0 to 10 % strain, by the law, mean over the curves
E_kPa        initial modulus: of a published law its initial slope, as its ends slide
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from script import run
from silicone_cylinders import DIAMETER_MM, HEIGHT_MM, NU, published_stress, read, relative_rms, slope_kPa

from fem.indentation.explain_trace import explain_trace
from fem.indentation.trace import IndenterTrace

SMALL = 1e-4
"""Strain of the central difference that gives the initial slope."""


def published_force_N(trace: IndenterTrace, family: str, parameters: np.ndarray) -> np.ndarray:
    """Positive when pressed."""
    stress_kPa = published_stress(family, parameters, 1 - trace.travel_mm / HEIGHT_MM)
    return np.asarray(-1e-3 * stress_kPa * np.pi / 4 * DIAMETER_MM**2)


def initial_slope_kPa(family: str, parameters: np.ndarray) -> float:
    """Of nominal stress over stretch."""
    less, more = published_stress(family, parameters, np.array([1 - SMALL, 1 + SMALL]))
    return float((more - less) / (2 * SMALL))


def errors(traces: list[IndenterTrace], forces_N: list[np.ndarray]) -> dict[str, float]:
    """Means over the curves."""
    pairs = list(zip(traces, forces_N, strict=True))
    return {
        "force_error": float(
            np.mean([relative_rms(force_N - trace.force_N, trace.force_N) for trace, force_N in pairs])
        ),
        "slope_kPa": float(np.mean([slope_kPa(*pair) for pair in pairs])),
    }


def of_mixture(paths: list[Path], laws: dict[str, dict[str, dict[str, Any]]]) -> pd.DataFrame:
    """A row for drupe's law and for each published form and kind of stress."""
    first, *others = [read(path) for path in paths]
    account = explain_trace(first, thickness_mm=None, poisson_ratio=NU, rng=np.random.default_rng(0))
    forces_N = [account.posterior.force_N(trace) for trace in others]
    E_kPa = 1e3 * account.explanation.after.value
    rows = [{"stress": "force", "law": "drupe", **errors(others, forces_N), "E_kPa": E_kPa}]
    for stress, forms in laws.items():
        for form, law in forms.items():
            family, parameters = form.split("_o")[0], np.array(law["parameters"])
            forces_N = [published_force_N(trace, family, parameters) for trace in others]
            E_kPa = initial_slope_kPa(family, parameters)
            rows.append({"stress": stress, "law": form, **errors(others, forces_N), "E_kPa": E_kPa})
    return pd.DataFrame(rows)


def main(folder: Path, parameters: Path, csv: Path | None = None) -> None:
    """Read, compare, print."""
    moduli = json.loads((folder / "published.json").read_text())["E"]
    published = json.loads(parameters.read_text())
    tables = []
    for mixture, (modulus_kPa, _) in moduli.items():
        laws = {stress: of_stress[mixture] for stress, of_stress in published.items()}
        table = of_mixture(sorted((folder / mixture).glob("*.csv")), laws)
        table.insert(0, "mixture", mixture)
        table.insert(1, "published_kPa", modulus_kPa)
        print(table.to_string(index=False, float_format="%.4g"), flush=True)
        tables.append(table)
    rows = pd.concat(tables, ignore_index=True)
    if csv is not None:
        rows.to_csv(csv, index=False, float_format="%.5g")
    rows["slope_ratio"] = rows["slope_kPa"] / rows["published_kPa"]
    rows["E_ratio"] = rows["E_kPa"] / rows["published_kPa"]
    medians = rows.groupby(["stress", "law"], sort=False)[["force_error", "slope_ratio", "E_ratio"]].median()
    print("medians over the mixtures:")
    print(medians.to_string(float_format="%.3f"))


if __name__ == "__main__":
    run(main)
