"""A case's linear problem, reduced to what selection needs of it: products of all columns, and little else.

It is taken while a case is explained, and replays the linear round without the fruit. Stored as a compressed
.npz of a few hundred kB: lower triangles of the products, and words as JSON.
"""

import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from fem.mismatch.catalogue import EFFECTS
from fem.mismatch.effect import Effect, Signature
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.evidence.linear_evidence import GramMatrix
from fem.mismatch.evidence.model_error import model_error_columns, model_error_shares
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.observation_delta import Regressor
from fem.mismatch.procedure import case_model
from fem.mismatch.selection.screening import LinearRound, linear_round
from fem.mismatch.signature_variant import ONE_WAY, Variant, of_pad
from pipeline.diagnosis.diagnosed_case import open_case
from pipeline.diagnosis.diagnosis import finer_mesh_of, mismatch_case
from pipeline.fruit.grasped import grasped_fruit
from pipeline.fruit.stage_log import StageLog

FORMAT = 4
"""Of the file; a reader refuses another."""
WORDS = ("name", "sd", "mean", "measured", "measured_sd", "positive", "least", "same_as")
"""What a file keeps of a Regressor."""
OF_MODEL_ERROR = "model error"
"""Role of columns that stand for the model's own error."""


@dataclass(frozen=True, kw_only=True)
class ReducedCase:
    """Columns and signatures in words, products by recording as GramMatrix has them.

    `columns`: dicts of WORDS (Regressor) and role ("plain", "nuisance", "model error", "signature").
    `signatures`: dicts of effect, label, columns, said, direct (what else is known of it, ln) and surface_sd
    (that of each column in LinearRound).
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
        return tuple(
            j for j, column in enumerate(self.columns) if column["role"] in ("nuisance", OF_MODEL_ERROR)
        )

    def gram(self) -> GramMatrix:
        """The products as selection takes them."""
        regressors = [
            Regressor(fields=(), **{word: column[word] for word in WORDS}) for column in self.columns
        ]
        return GramMatrix.from_products(regressors, self.rows, self.products)

    def linear(self) -> LinearRound:
        """The linear round, by the product's own selection code."""
        gram = self.gram()
        signatures = self._signatures(gram)
        stored = {
            id(signature): words for (_, signature, _), words in zip(signatures, self.signatures, strict=True)
        }
        return linear_round(
            gram,
            self.nuisances,
            signatures,
            auxiliary=lambda _, signature, __: (
                float(stored[id(signature)]["said"]),
                float(stored[id(signature)]["direct"]),
            ),
            surface_sd=self.surface_sd,
            without={},
            numbers=self.count,
        )

    @property
    def surface_sd(self) -> dict[int, float]:
        """As LinearRound has it."""
        return {
            j: sd
            for words in self.signatures
            for j, sd in zip(words["columns"], words["surface_sd"], strict=True)
            if sd
        }

    def _signatures(self, gram: GramMatrix) -> list[tuple[Effect, Signature, tuple[int, ...]]]:
        effects = {effect.spec.name: effect for effect in EFFECTS}
        return [
            (
                effects[words["effect"]],
                Signature(
                    variant=_variant(effects[words["effect"]], words["label"]),
                    columns=tuple(gram.columns[j] for j in words["columns"]),
                ),
                tuple(words["columns"]),
            )
            for words in self.signatures
        ]

    def with_shipped_model_error(self) -> "ReducedCase":
        """The same with the model error of today's file (fem.mismatch.evidence.model_error) for its own."""
        return self.with_model_error(model_error_shares())

    def with_model_error(self, shares: Mapping[str, float]) -> "ReducedCase":
        """The same with a model error of these shares, by effect, for its own."""
        errors = model_error_columns(
            self._signatures(self.gram()),
            compliance_ratio=float(self.facts["compliance_ratio"]),
            surface_sd=self.surface_sd,
            shares=shares,
        )
        kept = [j for j, column in enumerate(self.columns) if column["role"] != OF_MODEL_ERROR]
        renumbered = {j: k for k, j in enumerate(kept)}
        sources = [*kept, *(error.same_as for error in errors)]
        rows, products = [], []
        for known, gram in zip(self.rows, self.products, strict=True):
            place = {int(j): at for at, j in enumerate(known, 1)}
            rows.append(np.array([k for k, j in enumerate(sources) if j in place], dtype=np.int64))
            at = [0, *(place[j] for j in sources if j in place)]
            products.append(gram[np.ix_(at, at)])
        columns = [self.columns[j] for j in kept]
        for error in errors:
            source = renumbered[error.same_as]
            columns.append({**column_words(error, OF_MODEL_ERROR), "same_as": source})
        signatures = [
            {**words, "columns": [renumbered[j] for j in words["columns"]]} for words in self.signatures
        ]
        return replace(self, columns=columns, signatures=signatures, rows=rows, products=products)

    def information(self) -> Float[np.ndarray, "c c"]:
        """Products of all columns with each other, the sum over all recordings."""
        total = np.zeros((len(self.columns),) * 2)
        for rows, products in zip(self.rows, self.products, strict=True):
            total[np.ix_(rows, rows)] += products[1:, 1:]
        return total


def _variant(effect: Effect, label: str) -> Variant:
    """That of a pad where the effect is a pad's; others are not told apart."""
    of_one_pad = any(parameter.kind == "pad" for parameter in effect.spec.parameters)
    return of_pad(label) if of_one_pad and label else ONE_WAY


def opened(folder: Path) -> tuple[CaseModel, list[GraspEquations]]:
    """The plain model of a case folder, and the equations of its recordings."""
    with tempfile.TemporaryDirectory() as work:
        case = open_case(folder.resolve(), fruit_id=None, work=Path(work), out=None)
        fruit = grasped_fruit(case.task, StageLog(str), explains=True)
        model, _ = case_model(mismatch_case(case, fruit, finer_mesh=finer_mesh_of(case, fruit)))
    recorded = [GraspEquations.of(model, recording) for recording in model.grasps]
    return model, recorded


def gains_of(linear: LinearRound) -> dict[str, float]:
    """Each effect's best gain, ln evidence."""
    return {fit.effect.spec.name: float(fit.gain) for fit in linear.best}


def reduced(model: CaseModel, recorded: Sequence[GraspEquations], linear: LinearRound) -> ReducedCase:
    """A case as it stands after its linear round."""
    roles = ["plain"] + ["signature"] * (len(linear.products.columns) - 1)
    for j in linear.nuisances:
        roles[j] = "nuisance" if linear.products.columns[j].same_as is None else OF_MODEL_ERROR
    columns = [
        column_words(column, role) for column, role in zip(linear.products.columns, roles, strict=True)
    ]
    signatures = [
        {
            "effect": fit.effect.spec.name,
            "label": fit.signature.variant.label,
            "columns": list(fit.columns),
            "said": fit.auxiliary_log_likelihood - fit.direct,
            "direct": fit.direct,
            "surface_sd": [linear.surface_sd.get(j, 0.0) for j in fit.columns],
        }
        for fit in linear.linear_fits
    ]
    return ReducedCase(
        columns=columns,
        signatures=signatures,
        rows=list(linear.products.rows),
        products=list(linear.products.products),
        count=sum(equations.nuisances.shape[1] for equations in recorded),
        facts={
            "compliance": model.compliance,
            "compliance_ratio": model.compliance_ratio,
            "gains": gains_of(linear),
        },
    )


def column_words(column: Regressor, role: str) -> dict[str, Any]:
    """A column without its fields, as plain JSON values."""
    return {word: getattr(column, word) for word in WORDS} | {"role": role}


def store(path: Path, case: ReducedCase) -> None:
    """Write a case, whole or not at all."""
    kept = ("columns", "signatures", "count", "facts")
    words = {"format": FORMAT} | {name: getattr(case, name) for name in kept}
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
