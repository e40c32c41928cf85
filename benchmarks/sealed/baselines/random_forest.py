"""Baseline: a random forest (Breiman 2001, Machine Learning 45, 5) on the features of a bank's cases.

Features: linear gains of all effects, detection statistics, shares of the analysis of variance. Trained on
bank cases alone, never on sealed ones; how good it is there is told by cross-validation over fruits.
"""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GroupKFold, cross_val_predict

TREES, FOLDS = 400, 5
"""Trees of the forest, parts of the cross-validation (usual numbers)."""
CLOSE = 0.5
"""Share of the greatest probability from which a second name is in the verdict (set by hand)."""

# Of few cases most names are there once, which scikit-learn warns of in every tree.
warnings.filterwarnings("ignore", "The number of unique classes", UserWarning)


class Forest:
    """A forest trained on rows with `truth`, `fruit` and `features`."""

    def __init__(self, rows: Sequence[Mapping[str, Any]]) -> None:
        self.names = sorted({name for row in rows for name in flat(row["features"])})
        self.truth = np.array([row["truth"] for row in rows])
        self.fruits = np.array([row["fruit"] for row in rows])
        self.X = self.matrix([row["features"] for row in rows])
        self.model = RandomForestClassifier(TREES, random_state=0, class_weight="balanced")
        self.model.fit(self.X, self.truth)

    def matrix(self, features: Sequence[Mapping[str, Any]]) -> Float[np.ndarray, "n f"]:
        """One row per case; what a case lacks is zero; asinh, as gains span decades."""
        own = [flat(one) for one in features]
        return np.arcsinh(np.array([[one.get(name, 0.0) for name in self.names] for one in own], dtype=float))

    def accuracy(self) -> float:
        """Share of the bank's cases that are named right, each by a forest of other fruits."""
        folds = min(FOLDS, len(set(self.fruits)))
        model = RandomForestClassifier(TREES, random_state=0, class_weight="balanced")
        said = cross_val_predict(model, self.X, self.truth, groups=self.fruits, cv=GroupKFold(folds))
        return float(np.mean(said == self.truth))

    def answer(self, features: Mapping[str, Any]) -> dict[str, Any]:
        """Verdict and order for one case; it has no E and no fit of its own."""
        probability = self.model.predict_proba(self.matrix([features]))[0]
        order = np.argsort(-probability)
        names = [str(self.model.classes_[k]) for k in order]
        verdict = [
            n for n, k in zip(names, order, strict=True) if probability[k] >= CLOSE * probability.max()
        ]
        if names[0] in ("none", "unknown"):
            verdict = names[:1]
        return {
            "verdict": [one for one in verdict if one == names[0] or one not in ("none", "unknown")],
            "order": [one for one in names if one not in ("none", "unknown")],
            "E": None,
            "heldout_ratio": None,
        }


def flat(features: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Features by group and name."""
    return {f"{group} {name}": value for group, own in features.items() for name, value in own.items()}
