"""Stored rounds with known answers: small synthetic problems in the place of recordings."""

from dataclasses import replace

from synthetic_problem import problem

from fem.mismatch.selection.decision import MISFIT

E_MPa = 0.5
PARAMETERS = {
    "skin": lambda amount: {"Et_N_per_mm": amount * E_MPa},
    "graded_modulus": lambda amount: {"gamma": amount},
    "clock_lag": lambda amount: {"lag_s": amount},
    "gripper_compliance": lambda amount: {"mm_per_N": amount},
}
"""Of the label of an effect of so large an amount."""


def labelled_round(amounts, *, fruit="null-200", bounds=None, seed=5):
    """A problem that holds these amounts; its noise leaves the misfit of recordings without mismatch."""
    case = problem(amounts, seed=seed)
    parameters = {name: PARAMETERS[name](amount) for name, amount in amounts.items()}
    answer = {
        "effect": "+".join(sorted(amounts)) or "none",
        "parameters": next(iter(parameters.values())) if len(parameters) == 1 else parameters,
        "E_MPa": E_MPa,
        "drawn_from": {"fruit": fruit, "added": [], "level": 3},
    }
    facts = {"answer": answer, "E_MPa": E_MPa, "bounds": bounds or {}}
    return replace(case, count=round(case.count / MISFIT), facts=case.facts | facts)
