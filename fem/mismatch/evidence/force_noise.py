"""Errors in variables: what the noise of the forces adds to the products of fields with the data.

A regression on a noisy regressor is biased, and not only attenuated: noise that differs from marker to
marker is of short waves, and a model that answers less to those, as a stiff surface does, fits better.
Uncorrected, markers' noise of 4 um on soft sound fruit looks like a skin of 0.3 to 0.5 mm, worth 3 to 27
nats, and like flesh that is firmer outside. The normal equations are corrected by the expected products n of
fem.mismatch.model.force_products: b_i - n_i for b_i = phi_i . W y, computed for each recording from its own
noise (corrected score: Nakamura 1990, Biometrika 77; Fuller 1987, Measurement Error Models, section 2.2).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from fem.estimation.coloured_noise import drawn_coloured_noise
from fem.estimation.denoised_force import DenoisedForce
from fem.estimation.error_budget import ErrorBudget
from fem.estimation.frame_thinning import spacing
from fem.grasp_history import PadHistory
from fem.mismatch.evidence.grasp_equations import GraspEquations
from fem.mismatch.model.force_products import ForceNoise
from fem.mismatch.model.forward_model import ForwardModel
from fem.parallel_map import parallel_map

DRAWS = 2
"""Draws of a recording's noise. Each holds some thousand independent numbers: from one to the next n changes
by a tenth, and what is corrected is of the size of the amounts' standard deviations."""


def drawn_force_noise(
    forward: ForwardModel, recorded: Sequence[GraspEquations], *, draws: int = DRAWS
) -> list[ForceNoise]:
    """Draws of each recording's noise, as its own frames without contact show it, and their adjoint fields.

    The fields of all recordings are solved for together.
    """
    drawn = parallel_map(
        lambda equations: _drawn(forward, equations, draws), recorded, workers=forward.workers
    )
    forces = [force_N for _, force_N in drawn]
    solved = _solved(forward, recorded, forces)
    shares = [_shares(equations) for equations in recorded]
    weighed = []
    for equations, share, (places, _), (_, response) in zip(recorded, shares, drawn, solved, strict=True):
        excess = places - forward.compliance * np.einsum("fr,prnx->pfnx", share, response)
        weighed.append(np.stack([equations.weighed_markers(draw) for draw in excess]))
    pulled = [np.einsum("fr,pfnx->prnx", share, heavy) for share, heavy in zip(shares, weighed, strict=True)]
    adjoint = _solved(forward, recorded, pulled)
    return [
        ForceNoise(
            compliance=forward.compliance,
            recording=equations.recording,
            solid=forward.base.solid_of(equations.recording),
            force_N=forces[k],
            moved=solved[k][0],
            response=solved[k][1],
            weighed=weighed[k],
            pulled=pulled[k],
            adjoint=adjoint[k][0],
            adjoint_response=adjoint[k][1],
        )
        for k, equations in enumerate(recorded)
    ]


def _shares(equations: GraspEquations) -> Float[np.ndarray, "f r"]:
    """Of the patterns that hold the forces' own noise."""
    recording = equations.recording
    return recording.shares[:, : recording.finer.first + recording.finer.count]


def _drawn(
    forward: ForwardModel, equations: GraspEquations, draws: int
) -> tuple[Float[np.ndarray, "p f n 3"], Float[np.ndarray, "p r n 3"]]:
    """Noise of the markers' places, and of the forces by pattern."""
    recording = equations.recording
    rng = np.random.default_rng(0)
    drawn = [
        _of_pad(pad, denoised, recording.used, forward.base.case.budget, draws, rng)
        for pad, denoised in zip(recording.case.history.pads, recording.denoised, strict=True)
    ]
    places, forces = (np.concatenate(parts, axis=2) for parts in zip(*drawn, strict=True))
    shares = _shares(equations)
    return places, recording.finer.of_noise(
        np.einsum("fr,pfnx->prnx", shares / (shares**2).sum(axis=0), forces)
    )


def _of_pad(
    pad: PadHistory,
    denoised: DenoisedForce,
    used: Bool[np.ndarray, " t"],
    budget: ErrorBudget,
    draws: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "p f n 3"], Float[np.ndarray, "p f n 3"]]:
    """Noise of the markers' places and of the denoised forces: of frames, and of the markers' scales."""
    moved, force = pad.gel_displacement_mm[used], pad.force_N[used]
    shape, lag1 = (draws, *moved.shape), pad.lag1 ** spacing(used)
    one_each = (draws, 1, moved.shape[1], 1)
    places = pad.displacement_sd_mm * drawn_coloured_noise(shape, lag1, rng)
    places += budget.gel_scale_sd * rng.normal(size=one_each) * moved
    felt = pad.force_sd_N * drawn_coloured_noise(shape, lag1, rng)
    felt += budget.force_scale_sd * rng.normal(size=one_each) * force
    flat = (-1, *moved.shape[1:])
    return places, denoised.noise(places.reshape(flat), felt.reshape(flat)).reshape(shape)


def _solved(
    forward: ForwardModel,
    recorded: Sequence[GraspEquations],
    force_N: Sequence[Float[np.ndarray, "_p _r _n 3"]],
) -> list[tuple[Float[np.ndarray, "_p _r _m 3"], Float[np.ndarray, "_p _r _n 3"]]]:
    """K0^-1 L f of the whole flesh and at the markers (E = 1 MPa), recording by recording."""
    base, nodes = forward.base, len(forward.base.mesh.nodes_mm)
    loads = {recording.case.name: np.zeros((0, nodes, 3)) for recording in base.grasps}
    for equations, forces in zip(recorded, force_N, strict=True):
        flat = forces.reshape(-1, *forces.shape[2:])
        load = np.zeros((len(flat), nodes, 3))
        load[:, base.solid_of(equations.recording).contact_nodes] = equations.recording.nodal_of(flat)
        loads[equations.recording.case.name] = load
    solved = dict(zip(loads, base.displacements(list(loads.values())), strict=True))
    displacements = []
    for equations, forces in zip(recorded, force_N, strict=True):
        moved = solved[equations.recording.case.name]
        on_skin = moved[:, base.solid_of(equations.recording).contact_nodes]
        by_draw = moved.reshape(*forces.shape[:2], *moved.shape[1:])
        displacements.append((by_draw, equations.recording.at_markers(on_skin).reshape(forces.shape)))
    return displacements
