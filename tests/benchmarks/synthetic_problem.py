"""A small linear problem with known amounts: columns drawn at random, unit noise, two recordings or more."""

import numpy as np
from reduced_case import ReducedCase

EFFECTS = ("skin", "graded_modulus", "clock_lag", "gripper_compliance")
"""Of the catalogue, each with one column here, none with a sign but the last."""


def problem(
    amounts: dict[str, float], *, numbers: int = 400, recordings: int = 4, share: float = 0.0, seed: int = 5
) -> ReducedCase:
    """Data = 1/E column x share + columns x amounts + noise of sd 1; columns have entries of order 1."""
    rng = np.random.default_rng(seed)
    names = ["1/E", "pit", *EFFECTS]
    true = np.array([share, 0.0, *(amounts.get(name, 0.0) for name in EFFECTS)])
    rows, products = [], []
    for _ in range(recordings):
        fields = rng.normal(size=(len(names), numbers))
        data = true @ fields + rng.normal(size=numbers)
        both = np.vstack([data, fields])
        rows.append(np.arange(len(names)))
        products.append(both @ both.T)
    columns = [
        {
            "name": name,
            "sd": 3.0,
            "mean": 0.0,
            "positive": name == "gripper_compliance",
            "least": 0.0,
            "measured": 0.0,
            "measured_sd": 0.0,
            "same_as": None,
            "role": role,
        }
        for name, role in zip(names, ["plain", "nuisance"] + ["signature"] * len(EFFECTS), strict=True)
    ]
    signatures = [
        {"effect": name, "label": "", "columns": [2 + k], "said": 0.0, "direct": 0.0, "surface_sd": [0.0]}
        for k, name in enumerate(EFFECTS)
    ]
    return ReducedCase(
        columns=columns,
        signatures=signatures,
        rows=rows,
        products=products,
        count=recordings * numbers,
        facts={"compliance": 2.0, "compliance_ratio": 1.0, "variance": {}, "gains": {}},
    )
