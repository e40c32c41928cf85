"""How a recording's response changes with what is inside the fruit and with its surface, to first order."""

import numpy as np
from jaxtyping import Float

from fem.grasp_sensitivity import inner_forces
from fem.mismatch.baseline import Seen
from fem.mismatch.ground import Ground


def inner_changes(ground: Ground, seen: Seen) -> dict[str, Float[np.ndarray, "f n 3"]]:
    """dc/dp, mm MPa, for what moves no pad in fem.grasp_sensitivity: pit, surface, Poisson's ratio."""

    def compute() -> dict[str, Float[np.ndarray, "f n 3"]]:
        causes, forces = inner_forces(ground.base.solid_of(seen), seen.moved, list(seen.links))
        moved = ground.base.answer(seen, forces.reshape(-1, *forces.shape[2:]))
        moved = moved.reshape(len(causes), len(seen.patterns), *moved.shape[1:])
        return {cause: seen.over_time(own) for cause, own in zip(causes, moved, strict=True)}

    return ground.kept(("inner", seen.case.name), compute)
