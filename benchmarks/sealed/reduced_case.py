"""A case's linear problem, reduced to what selection needs of it: products of all columns, and little else.

It is taken while a case is explained, and replays the linear round without the fruit. Stored as a compressed
.npz of a few hundred kB: lower triangles of the products, and words as JSON.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Effect, Signature
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.result import NONE
from fem.mismatch.selection.detection import best_beyond_quantile, null_gain, p_values
from fem.mismatch.selection.screening import LinearRound, linear_round
from fem.mismatch.signature_variant import ONE_WAY
from fem.mismatch.thresholds import DETECTION_P

FORMAT = 2
"""Of the file; a reader refuses another."""


@dataclass(frozen=True, kw_only=True)
class ReducedCase:
    """Columns and signatures in words, products by recording as GramMatrix has them.

    `columns`: dicts of name, sd, mean, positive, least and role ("plain", "nuisance", "discrepancy",
    "stand-in", "signature").
    `signatures`: dicts of effect, label, columns, said and direct (what else is known of it, ln).
    `count`: numbers of the data; `facts`: plain numbers of the case.
    """

    columns: list[dict[str, Any]]
    signatures: list[dict[str, Any]]
    rows: list[Int[np.ndarray, " _"]]
    products: list[Float[np.ndarray, "_ _"]]
    count: int
    facts: dict[str, Any]

    @property
    def nuisances(self) -> tuple[int, ...]:
        """Numbers of the plain model's columns but 1/E."""
        return tuple(j for j, one in enumerate(self.columns) if one["role"] in ("nuisance", "discrepancy"))

    def gram(self) -> GramMatrix:
        """The products as selection takes them."""
        regressors = [
            Regressor(
                name=one["name"],
                sd=one["sd"],
                mean=one["mean"],
                positive=one["positive"],
                least=one["least"],
                fields=(),
            )
            for one in self.columns
        ]
        return GramMatrix.from_products(regressors, self.rows, self.products)

    def linear(self) -> LinearRound:
        """The linear round, by the product's own selection code."""
        effects = {effect.spec.name: effect for effect in EFFECTS}
        found: list[tuple[Effect, Signature, tuple[int, ...]]] = []
        stored: dict[int, dict[str, Any]] = {}
        gram = self.gram()
        for one in self.signatures:
            signature = Signature(variant=ONE_WAY, columns=tuple(gram.columns[j] for j in one["columns"]))
            stored[id(signature)] = one
            found.append((effects[one["effect"]], signature, tuple(one["columns"])))
        return linear_round(
            gram,
            self.nuisances,
            found,
            auxiliary=lambda _, signature, __: (
                float(stored[id(signature)]["said"]),
                float(stored[id(signature)]["direct"]),
            ),
            without={},
        )

    def statistics(self, linear: LinearRound) -> dict[str, float]:
        """Those of fem.mismatch.procedure.detection_statistics."""
        ratio = float(self.facts["compliance_ratio"])
        gains = ((one.name, one.gain) for one in linear.linear_fits)
        return {
            "best single": best_beyond_quantile(gains, ratio),
            "best pair": max((gain for gain, _, _ in linear.pairs), default=0.0) / ratio**2,
            "what is left": linear.null.chi2 / self.count,
        }

    def linear_verdict(self, linear: LinearRound) -> str:
        """Before any refit: "none", or the effect that gains most beyond its null quantile."""
        if p_values(self.statistics(linear))[0] >= DETECTION_P:
            return NONE
        ratio = float(self.facts["compliance_ratio"])
        best = max(linear.linear_fits, key=lambda one: one.gain - null_gain(one.name, ratio))
        return str(best.effect.spec.name)


def gains_of(linear: LinearRound) -> dict[str, float]:
    """Each effect's best gain, ln evidence."""
    return {one.effect.spec.name: float(one.gain) for one in linear.best}


def reduced(forward: ForwardModel, recorded: Sequence[GraspEquations], linear: LinearRound) -> ReducedCase:
    """A case as it stands after its linear round."""
    roles = ["plain"] + ["signature"] * (len(linear.products.columns) - 1)
    for j in linear.nuisances:
        roles[j] = "nuisance" if linear.products.columns[j].discrepancy_of is None else "discrepancy"
    for j, column in enumerate(linear.products.columns):
        if column.stands_in:
            roles[j] = "stand-in"
    columns = [
        {
            "name": one.name,
            "sd": one.sd,
            "mean": one.mean,
            "positive": one.positive,
            "least": one.least,
            "role": role,
        }
        for one, role in zip(linear.products.columns, roles, strict=True)
    ]
    signatures = [
        {
            "effect": one.effect.spec.name,
            "label": one.signature.label,
            "columns": list(one.columns),
            "said": one.auxiliary_log_likelihood - one.direct,
            "direct": one.direct,
        }
        for one in linear.linear_fits
    ]
    return ReducedCase(
        columns=columns,
        signatures=signatures,
        rows=list(linear.products.rows),
        products=list(linear.products.products),
        count=sum(one.own.shape[1] for one in recorded),
        facts={
            "compliance": forward.compliance,
            "compliance_ratio": forward.compliance_ratio,
            "gains": gains_of(linear),
        },
    )


def store(path: Path, case: ReducedCase) -> None:
    """Write a case, whole or not at all."""
    words = {
        "format": FORMAT,
        "columns": case.columns,
        "signatures": case.signatures,
        "count": case.count,
        "facts": case.facts,
    }
    arrays: dict[str, Any] = {}
    for k, (rows, products) in enumerate(zip(case.rows, case.products, strict=True)):
        arrays[f"rows_{k}"] = rows.astype(np.int16)
        arrays[f"products_{k}"] = products[np.tril_indices(len(products))]
    partial = path.with_suffix(".partial.npz")
    np.savez_compressed(partial, words=np.array(json.dumps(words)), **arrays)
    partial.replace(path)


def stored(path: Path) -> ReducedCase:
    """Read a case. Raises ValueError for another format."""
    with np.load(path, allow_pickle=False) as file:
        words = json.loads(str(file["words"]))
        if words.pop("format") != FORMAT:
            raise ValueError(f"{path} is of another format: write it anew")
        rows, products = [], []
        while f"rows_{len(rows)}" in file:
            rows.append(file[f"rows_{len(rows)}"].astype(np.int64))
            half = np.zeros((len(rows[-1]) + 1,) * 2)
            half[np.tril_indices(len(half))] = file[f"products_{len(products)}"]
            products.append(half + half.T - np.diag(np.diag(half)))
        return ReducedCase(rows=rows, products=products, **words)
