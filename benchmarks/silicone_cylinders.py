"""Silicone cylinders of known modulus, pressed between plates: what drupe makes of them.

    python benchmarks/silicone_cylinders.py FOLDER [--csv FILE] [--curves FILE]
        [--part development|last|all] [--together FILE] [--jobs 2]

FOLDER: a folder of tables for each mixture, and published.json, of
github.com/abubakardawood/tissue-phantom-material-database (A. B. Dawood et al. 2026, data CC BY 4.0):
cylinders of 50 mm diameter and 30 mm height, 10 mm/min, to 67 % strain; the end condition is not stated. The
published E is the slope of a line through the recorded origin over 0 to 10 % strain, an apparent modulus.
`development` are the mixtures that laws and priors were chosen on; `last` were scored after that, but the
temperature of curves was chosen on all. Prints
a line for each curve and mixture, and totals:

slope       of such a line: the curve's, and by the laws fitted to the whole curve with first touch and ends
E           initial modulus of the material, with its standard deviation
ends        log evidence of held, and of any, over sliding ends
verdict     none or stiffening; sensor_drift alone or in a list
last fifth  error of the force predicted from the first four fifths, over its root mean square; beside it the
            best of six published laws (sliding ends, zero as recorded), refitted to the same part

--csv writes the mixtures and --curves the curves, a row each.
--together fits all curves of a mixture with one law instead, and writes for each mixture: E, the scatter of
its curves, the curves that do not belong, and the slope by the law of the others.
"""

import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.special import logsumexp
from scipy.stats import kendalltau
from script import run

from fem.indentation.compressed_cylinder import Cylinder, Ends
from fem.indentation.contact_law import linear_law
from fem.indentation.explain_trace import explain_trace
from fem.indentation.explanations import candidate_fits, forms_of
from fem.indentation.no_contact import pooled_noise
from fem.indentation.strangers import own_moduli, scatter
from fem.indentation.trace import DRIFT_SHARE_PER_MIN, IndenterTrace, joined
from pipeline.fruit.bare_traces import spread

DEVELOPMENT = ("EF10_0T", "EF30_25T", "EF10_100T", "EF50_12_5T", "EF30_0T")
"""Mixtures on which laws, priors and the model error were chosen; all others were scored once at the end."""
DIAMETER_MM, HEIGHT_MM = 50.0, 30.0
RANGE_N = 1000.0
"""Of the load cell, as the tables state."""
NU = 0.49
"""Of silicone. Assumed."""
FRAMES, FRAMES_TOGETHER = 150, 120
"""Of a curve, spread evenly over time, force and travel: of one alone, and of one of ten together."""
SLOPE_UP_TO = 0.1
"""Greatest strain of the line through the recorded origin."""
SEEN = 0.8
"""Share of the travel from which the rest is predicted."""
HEADER = 8
"""Lines before the first row."""


def read(path: Path, ends: Ends | None = None, frames: int = FRAMES) -> IndenterTrace:
    """Time, travel and force of one table."""
    time_s, travel_mm, force_N = np.genfromtxt(path, delimiter=",", skip_header=HEADER)[:, :3].T
    kept = spread(time_s, travel_mm, force_N, frames)
    kept = kept[np.r_[True, np.diff(time_s[kept]) > 0]]
    return IndenterTrace(
        time_s=time_s[kept],
        force_N=force_N[kept],
        travel_mm=travel_mm[kept],
        geometry=Cylinder(diameter_mm=DIAMETER_MM, height_mm=HEIGHT_MM, ends=ends),
        drift_N_per_min=DRIFT_SHARE_PER_MIN * RANGE_N,
    )


def slope_kPa(trace: IndenterTrace, force_N: np.ndarray) -> float:
    """Of the line through the recorded origin."""
    strain = trace.travel_mm / HEIGHT_MM
    used = strain <= SLOPE_UP_TO
    stress = 1e3 * force_N / (np.pi / 4 * DIAMETER_MM**2)
    return float(strain[used] @ stress[used] / (strain[used] @ strain[used]))


def relative_rms(gap: np.ndarray, recorded: np.ndarray) -> float:
    """Root mean square over that of what was recorded."""
    return float(np.sqrt(np.mean(gap**2) / np.mean(recorded**2)))


def log_evidence(trace: IndenterTrace) -> float:
    """Of the plain law and of stiffening, its forms equally likely, together."""
    law = linear_law(trace, thickness_mm=None, poisson_ratio=NU)
    stiffening = {"stiffening": forms_of(trace)["stiffening"]}
    plain, *fits = candidate_fits(law, trace, pooled_noise(trace), np.random.default_rng(0), stiffening)
    of_forms = logsumexp([fit.log_evidence for fit in fits]) - np.log(len(fits))
    return float(np.logaddexp(plain.log_evidence, of_forms))


def _exponential(p: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.asarray(p[0] * p[1] * np.exp(np.minimum(p[1] * x, 50)))


Slopes = tuple[object, object]
"""Of the energy, in x = I1 - 3 and y = I2 - 3."""
SLOPES: dict[str, tuple[Callable[..., Slopes], tuple[float, ...]]] = {
    "Neo Hookean": (lambda p, _: (p[0] / 2, 0.0), (20.0,)),
    "Mooney Rivlin": (lambda p, x: (p[0] + 2 * sum(p[2:]) * x, p[1]), (10.0, 1.0, 0.1)),
    "Yeoh": (lambda p, x: (sum((k + 1) * c * x**k for k, c in enumerate(p)), 0.0), (10.0, 0.1, 0.1)),
    "Veronda Westmann": (lambda p, x: (_exponential(p, x), -p[0] * p[1] / 2), (100.0, 0.2)),
    "Humphrey": (lambda p, x: (_exponential(p, x), 0.0), (40.0, 0.2)),
}
"""Five families of hyperelastic_parameters.json in that repository by their names there, each with its
parameters' order there and with starts, kPa. Mooney and Rivlin's third term is in x squared."""
OGDEN = (5.0, -0.1, 4.0, -4.0)
"""Starts of the sixth family, two terms of Ogden's law: kPa of each, then exponent of each."""


def published_stress(name: str, p: np.ndarray, stretch: np.ndarray) -> np.ndarray:
    """Nominal stress of an incompressible solid that slides between the plates, by its parameters, kPa."""
    if name == "Ogden":
        terms = zip(*np.split(np.asarray(p), 2), strict=True)
        return np.asarray(sum(mu * (stretch ** (a - 1) - stretch ** (-a / 2 - 1)) for mu, a in terms))
    first, second = SLOPES[name][0](p, stretch**2 + 2 / stretch - 3)
    return np.asarray(2 * (stretch - stretch**-2) * (first + second / stretch))


def best_published(trace: IndenterTrace, seen: np.ndarray) -> tuple[str, float]:
    """The law that predicts the rest best, and its error over the rest's root mean square."""
    stretch = 1 - trace.travel_mm / HEIGHT_MM
    stress = -1e3 * trace.force_N / (np.pi / 4 * DIAMETER_MM**2)
    errors: dict[str, float] = {}
    for name, start in {"Ogden": OGDEN, **{name: start for name, (_, start) in SLOPES.items()}}.items():

        def gap(p: np.ndarray, name: str = name) -> np.ndarray:
            return published_stress(name, p, stretch) - stress

        fitted = least_squares(lambda p, gap=gap: gap(p)[seen], start, x_scale=np.abs(start)).x
        errors[name] = relative_rms(gap(fitted)[~seen], stress[~seen])
    best = min(errors, key=lambda name: errors[name])
    return best, errors[best]


def predicted_error(trace: IndenterTrace, seen: np.ndarray) -> float:
    """Of the rest by the mean over the laws fitted to the seen part, over the rest's root mean square."""
    until = trace.cut(slice(0, int(seen.sum())))
    account = explain_trace(until, thickness_mm=None, poisson_ratio=NU, rng=np.random.default_rng(0))
    gap = (account.posterior.force_N(trace, unseen=~seen) - trace.force_N)[~seen]
    return relative_rms(gap, trace.force_N[~seen])


def scored(path: Path) -> dict[str, object]:
    """One curve."""
    trace = read(path)
    account = explain_trace(trace, thickness_mm=None, poisson_ratio=NU, rng=np.random.default_rng(0))
    said = account.explanation
    logs = [log_evidence(read(path, ends)) for ends in ("lubricated", "bonded", None)]
    seen = trace.travel_mm <= SEEN * trace.travel_mm.max()
    name, published = best_published(trace, seen)
    onset = account.named.law.index("onset_mm")
    return {
        "mixture": path.parent.name,
        "curve": path.stem.removeprefix(f"{path.parent.name}_"),
        "own_kPa": slope_kPa(trace, trace.force_N),
        "law_kPa": slope_kPa(trace, account.posterior.force_N(trace)),
        "E_kPa": 1e3 * said.after.value,
        "E_sd_kPa": 1e3 * said.after.sd,
        "onset_mm": float(account.named.scaled[onset]),
        "held": logs[1] - logs[0],
        "any": logs[2] - logs[0],
        "verdict": said.verdict if isinstance(said.verdict, str) else " | ".join(said.verdict),
        "law": account.named.law.unknowns[-1].name,
        "last_fifth": predicted_error(trace, seen),
        "published_last_fifth": published,
        "published_law": name,
    }


def of_mixtures(rows: pd.DataFrame) -> pd.DataFrame:
    """A row for each mixture: means over its curves, and counts."""
    law, curve, published = rows["law_kPa"], rows["own_kPa"], rows["published_kPa"]
    counted = pd.DataFrame(
        {
            "mixture": rows["mixture"],
            "within_5_of_own": (law / curve - 1).abs() <= 0.05,
            "within_10_of_published": (law / published - 1).abs() <= 0.1,
            "own_within_10_of_published": (curve / published - 1).abs() <= 0.1,
            "none_or_stiffening": rows["verdict"].isin(["none", "stiffening"]),
            "with_sensor_drift": rows["verdict"].str.contains("sensor_drift"),
            "no_worse_than_published": rows["last_fifth"] <= rows["published_last_fifth"],
        }
    )
    each = rows.groupby("mixture", sort=False)
    means = each[["published_kPa", "own_kPa", "law_kPa", "E_kPa", "E_sd_kPa"]].mean()
    table = means.join(counted.groupby("mixture", sort=False).sum())
    table.insert(0, "curves", each.size())
    table["E_between_curves_kPa"] = each["E_kPa"].std()
    table[["held_over_sliding", "any_over_sliding"]] = each[["held", "any"]].sum()
    table[["last_fifth", "published_last_fifth"]] = each[["last_fifth", "published_last_fifth"]].median()
    table.insert(0, "part", ["development" if name in DEVELOPMENT else "last" for name in table.index])
    return table.reset_index()


def of_one_law(paths: list[Path]) -> dict[str, object]:
    """All curves of a mixture with one law, as `drupe explain` fits those of one specimen."""
    whole = joined([read(path, frames=FRAMES_TOGETHER) for path in paths])
    account = explain_trace(whole, thickness_mm=None, poisson_ratio=NU, rng=np.random.default_rng(0))
    said, trace = account.explanation, account.trace
    law_N = account.posterior.force_N(trace)
    slopes = [slope_kPa(part, law_N[at]) for part, at in zip(trace.parts, trace.slices, strict=True)]
    left_out = sorted(set(range(len(paths))) - set(trace.numbers))
    return {
        "mixture": paths[0].parent.name,
        "curves": len(paths),
        "E_kPa": 1e3 * said.after.value,
        "E_sd_kPa": 1e3 * said.after.sd,
        "scatter": scatter(own_moduli(trace, account.named, pooled_noise(trace)), account.named.scaled[0])[0],
        "left_out": " ".join(paths[k].stem.rsplit("_", 1)[1] for k in left_out),
        "why": " ".join(note for note in said.notes if "does not belong" in note),
        "law_kPa": float(np.mean(slopes)),
        "verdict": said.verdict if isinstance(said.verdict, str) else " | ".join(said.verdict),
        "heldout": said.heldout.rms_after if said.heldout else float("nan"),
    }


def main(
    folder: Path,
    csv: Path | None = None,
    curves: Path | None = None,
    part: Literal["development", "last", "all"] = "all",
    together: Path | None = None,
    jobs: int = 1,
) -> None:
    """Read, explain, print."""
    published = json.loads((folder / "published.json").read_text())["E"]
    groups = {
        name: sorted((folder / name).glob("*.csv"))
        for name in published
        if part == "all" or (name in DEVELOPMENT) == (part == "development")
    }
    paths = [path for group in groups.values() for path in group]
    work, of_each = (of_one_law, [g for g in groups.values() if g]) if together else (scored, paths)
    done = []
    with ProcessPoolExecutor(jobs) as pool:
        for row in pool.map(work, of_each):
            done.append(row)
            print(*(f"{v:.4g}" if isinstance(v, float) else v for v in row.values()), flush=True)
    rows = pd.DataFrame(done)
    rows["published_kPa"] = [published[name][0] for name in rows["mixture"]]
    if together:
        rows.to_csv(together, index=False, float_format="%.5g")
        return
    mixtures = of_mixtures(rows)
    print(mixtures.to_string(index=False, float_format="%.4g"))
    totals(rows, mixtures)
    for where, table in ((csv, mixtures), (curves, rows)):
        if where is not None:
            table.to_csv(where, index=False, float_format="%.5g")


def totals(rows: pd.DataFrame, mixtures: pd.DataFrame) -> None:
    """What is asked of all curves together."""
    print(f"\n{len(rows)} curves of {len(mixtures)} mixtures")
    for key in (
        "within_5_of_own", "within_10_of_published", "own_within_10_of_published", "none_or_stiffening",
        "with_sensor_drift", "no_worse_than_published",
    ):  # fmt: skip
        print(f"  {key}: {mixtures[key].sum()} of {len(rows)}")
    held, either = mixtures["held_over_sliding"].sum(), mixtures["any_over_sliding"].sum()
    print(f"  ends, log evidence over sliding: held {held:.0f}, any {either:.0f}")
    for key in ("law_kPa", "E_kPa"):
        tau = kendalltau(mixtures["published_kPa"], mixtures[key]).statistic
        print(f"  Kendall's tau of the published modulus with {key}: {tau:.3f}")
    print(rows["verdict"].value_counts().to_string())


if __name__ == "__main__":
    run(main)
