"""Displacement under measured forces of flesh whose stress depends on its strain history: one factorisation.

    K0 v + B' d(s v, history) / s = L f,        v = u / s = E u

d: the law's stress (for E = 1 MPa) in excess of the linear one, a function of the strain of all frames so
far. With v0 the linear displacement, every iteration sets

    v <- v + (v0 - K0^-1 B' d(s v) / s - v) / k

for all frames of all recordings at once, the whole history being that of the iteration before. k, per frame,
is half of the largest stiffness over the linear one (1 for a law that softens): below that the iteration
would overshoot. It is accelerated by mixing the last few iterates (Anderson 1965, "Iterative procedures for
nonlinear integral equations", Journal of the ACM 12). Source of the scheme: Kachanov's method of variable
elasticity parameters, with the initial stiffness.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.fem_failure import FemFailure, FemProblem
from fem.mismatch.model.baseline import Baseline, GraspResponse
from fem.mismatch.model.forward_model import ForwardModel
from fem.mismatch.model.path_frames import PathFrames, path_frames

MOST_ROUNDS, MEMORY = 40, 4
"""Searches of cases with these effects end after 1 to 10 rounds."""
CLOSE_MM = 6e-4
"""Rounds end when none asks a node of the skin to move more than this: a tenth of a marker's noise."""

RUN_AWAY = 1e6
"""N per MPa of the modulus: forces on a node that no flesh makes."""
SMALL_SHARE = 1e-4
"""Fields of force smaller than this share of the largest are left out of a round."""

ExcessForce = Callable[[Float[np.ndarray, "f n 3"]], Float[np.ndarray, "f n 3"]]
"""Displacement (mm) in all frames in order of time to nodal forces B' d of unit modulus."""


@dataclass(frozen=True, kw_only=True)
class PathState:
    """The chosen frames of all recordings one after the other. `linear`: v0; `first` of each recording."""

    base: Baseline
    frames: tuple[PathFrames, ...]
    linear: Float[np.ndarray, "f n 3"]

    @classmethod
    def of(cls, base: Baseline, frames: tuple[PathFrames, ...]) -> "PathState":
        """Under the recordings' forces."""
        fields = [_combined(recording, own) for recording, own in zip(base.grasps, frames, strict=True)]
        return cls(base=base, frames=frames, linear=np.concatenate(fields))

    @property
    def first(self) -> list[int]:
        """Where each recording begins among the frames, and the end."""
        return [0, *np.cumsum([len(own.chosen) for own in self.frames]).tolist()]

    def response(self, force: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """K0^-1 of nodal forces, each recording with its own support."""
        found = np.empty_like(force)
        held = np.repeat([recording.case.support for recording in self.base.grasps], np.diff(self.first))
        for support, solid in self.base.solids.items():
            own = np.flatnonzero(held == support)
            turn, parts = _few(force[own])
            found[own] = np.tensordot(turn, solid.displacement(parts), axes=1)
        return found

    def at_markers(self, field: Float[np.ndarray, "f n 3"]) -> list[Float[np.ndarray, "f n 3"]]:
        """Of every recording, in all frames used."""
        found = []
        for recording, own, a, b in zip(
            self.base.grasps, self.frames, self.first, self.first[1:], strict=False
        ):
            seen_at = recording.at_markers(field[a:b][:, self.base.solid_of(recording).contact_nodes])
            found.append(np.tensordot(own.mix, seen_at, axes=1))
        return found


def _few(
    fields: Float[np.ndarray, "f n 3"],
) -> tuple[Float[np.ndarray, "f r"], Float[np.ndarray, "r n 3"]]:
    """An orthogonal basis of the fields, and their coefficients: frames that differ by load alone share
    one.
    """
    flat = fields.reshape(len(fields), -1)
    size, turn = np.linalg.eigh(flat @ flat.T)
    kept = size > SMALL_SHARE**2 * max(float(size[-1]), 1e-300)
    kept[-1] = True
    return turn[:, kept], (turn[:, kept].T @ flat).reshape(-1, *fields.shape[1:])


def _combined(recording: GraspResponse, own: PathFrames) -> Float[np.ndarray, "k n 3"]:
    return np.asarray(np.tensordot(recording.shares[own.chosen], recording.moved, axes=1))


def fixed_point(
    state: PathState,
    excess_force: ExcessForce,
    *,
    compliance: float,
    stiffer: Float[np.ndarray, " f"],
    start: Float[np.ndarray, "f n 3"] | None,
    together: bool,
) -> Float[np.ndarray, "f n 3"]:
    """v - v0, by fixed-point iteration. `stiffer`: each frame's largest tangent stiffness over the linear
    one; `start`: first guess, None for zero.

    `together`: see `_mixed`. Raises FemFailure (NOT_CONVERGED) where the iteration diverges, or where the
    last of MOST_ROUNDS still moves the skin by more than CLOSE_MM.
    """
    skin = state.base.mesh.outer_nodes
    slower = np.maximum(stiffer / 2, 1.0)[:, None, None]
    more = np.zeros_like(state.linear) if start is None else start
    tried: list[Float[np.ndarray, "f n 3"]] = []
    steps: list[Float[np.ndarray, "f n 3"]] = []
    for _ in range(MOST_ROUNDS):
        step = (first_round(state, excess_force, compliance=compliance, start=more) - more) / slower
        left_mm = compliance * float(np.abs((step * slower)[:, skin]).max())
        if left_mm < CLOSE_MM:
            return np.asarray(more + step)
        tried, steps = [*tried, more][-MEMORY - 1 :], [*steps, step][-MEMORY - 1 :]
        more = _mixed(tried, steps, skin, together=together)
    raise FemFailure(
        FemProblem.NOT_CONVERGED,
        f"the search for how flesh of {1 / compliance:.3g} MPa moves by this law still moves the skin by "
        f"{1e3 * left_mm:.2g} µm after {MOST_ROUNDS} rounds, expected {1e3 * CLOSE_MM:.2g} µm at most",
    )


def first_round(
    state: PathState,
    excess_force: ExcessForce,
    *,
    compliance: float,
    start: Float[np.ndarray, "f n 3"] | None = None,
) -> Float[np.ndarray, "f n 3"]:
    """v - v0 under the law's stress in the field v0 + start (None: v0): to first order in the law.

    Raises FemFailure (NOT_CONVERGED) where the stress has no bounds there.
    """
    force = excess_force(compliance * (state.linear if start is None else state.linear + start))
    if not np.abs(force).max() < RUN_AWAY:
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"the search for how flesh of {1 / compliance:.3g} MPa moves by this law ran away",
        )
    return -state.response(force) / compliance


def _mixed(
    tried: Sequence[Float[np.ndarray, "f n 3"]],
    steps: Sequence[Float[np.ndarray, "f n 3"]],
    skin: Int[np.ndarray, " o"],
    *,
    together: bool,
) -> Float[np.ndarray, "f n 3"]:
    """The next iterate: the mix of those so far whose step is least at the skin, and that step.

    Each frame has a mix of its own, or all have one `together`: where stress depends on earlier frames,
    separate mixes would be inconsistent in the later ones.
    """
    more = tried[-1] + steps[-1]
    if len(steps) == 1:
        return np.asarray(more)
    rows = 1 if together else len(more)
    last = steps[-1][:, skin].reshape(rows, -1)
    changes = np.stack([step[:, skin].reshape(rows, -1) - last for step in steps[:-1]], axis=1)
    gram = changes @ np.swapaxes(changes, 1, 2)
    size = np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-30
    shares = np.linalg.solve(gram + 1e-8 * size * np.eye(len(gram[0])), changes @ last[..., None])[..., 0]
    for k, (one, step) in enumerate(zip(tried[:-1], steps[:-1], strict=True)):
        more = more - shares[:, k, None, None] * (one + step - tried[-1] - steps[-1])
    return np.asarray(more)


MOST_RUNS = 6
"""Earlier answers kept to start from: each is a field over all frames, and NEAR wants the latest few."""
NEAR, FARTHEST = 1e-2, 20.0
"""A guess is for parameters as NEAR to those wanted as it can be with weights whose sizes sum to FARTHEST."""


def path_state(forward: ForwardModel, *, frames: int, remembers: bool) -> PathState:
    """The model's recordings by about so many frames, chosen once."""

    def compute() -> PathState:
        return PathState.of(forward.base, path_frames(forward.base.grasps, frames, remembers=remembers))

    return forward.memoised(("path", frames, remembers), compute)


@dataclass(frozen=True)
class Run:
    """One solution: a law by its parameters, in units of distance between laws, and its v - v0."""

    law: Float[np.ndarray, " p"]
    more: Float[np.ndarray, "f n 3"]


def guess(runs: Sequence[Run], law: Float[np.ndarray, " p"]) -> Float[np.ndarray, "f n 3"] | None:
    """v - v0 for the law of these parameters: a mean of other runs, with weights that add up to one.

    The weights w are those of least |sum_i w_i (law_i - law)|^2 + near^2 |w|^2: a plane through the runs,
    and their mean far from all of them. None without runs.
    """
    if not runs:
        return None
    away = np.stack([run.law - law for run in runs])
    near, weight = NEAR, np.full(len(away), np.inf)
    while np.abs(weight).sum() > FARTHEST:
        weight = np.linalg.solve(away @ away.T + near**2 * np.eye(len(away)), np.ones(len(away)))
        weight /= weight.sum()
        near *= 3
    return np.asarray(sum(w * run.more for w, run in zip(weight, runs, strict=True)))


def keep_run(
    forward: ForwardModel, name: str, law: Float[np.ndarray, " p"], more: Float[np.ndarray, "f n 3"]
) -> None:
    """Stores one more solution of the search, the newest first; the oldest of MOST_RUNS is dropped."""
    run = Run(law, more.astype(np.float32))
    forward.store_warm_start(("runs", name), (run, *forward.warm_start(("runs", name)))[:MOST_RUNS])


def first_guess(
    forward: ForwardModel, name: str, law: Float[np.ndarray, " p"]
) -> Float[np.ndarray, "f n 3"] | None:
    """`guess` from the search's own solutions with a law of this name."""
    return guess(forward.warm_start(("runs", name)), law)
