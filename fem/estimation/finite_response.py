"""The response of flesh at finite strain to a gel's traction in each frame, and the fruit's rigid motion.

In frame t a fruit of modulus E has rotated and shifted, x = R (X + u) + c, and

    u = U(f(t, u) / E),        E u = C f_0 + [E U(f / E) - C f_0]

with f the gel's traction over the deformed skin (fem.solid.gel_traction) in the fruit's own axes, C the
linear compliance, and f_0 the traction over the skin deformed at small strain. C f_0 is solved for in every
frame. The bracket is of second order: it is solved for in a few frames, together with the place of the load,
and predicted for the others (fem.estimation.frame_prediction), with a(t, s) = f_0(t) . C f_0(s). The few
frames are chosen greedily, each where the earlier ones predict worst (pivoted Cholesky).

A marker's material point X is its place on the deformed skin in the first frame of its contact. Each marker's
fitted place absorbs errors of scan and pose (fem.estimation.compliance_fit).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from fem.estimation.compliance_fit import CompliantFit, MarkerTracks, fit_compliance, rigid_motion
from fem.estimation.frame_prediction import elastic_kernel, weights_of_known
from fem.estimation.frame_thinning import loaded_frames
from fem.estimation.fruit_motion import FruitMotion, in_fruit_axes, refined_motion
from fem.estimation.grasp_model import GraspModel
from fem.estimation.modulus import require_markers, require_positive
from fem.estimation.pad_loads import PadFrames, nodal_loads
from fem.estimation.unit_response import marker_tracks, tracks_of
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import GraspHistory
from fem.materials.neo_hookean import NeoHookean
from fem.mesh.flesh_mesh import FleshMesh
from fem.mesh.surface_points import SurfacePoints, locate
from fem.solid.finite_strain import FiniteStrainSolid
from fem.solid.linear_solid import UnitModulusSolid

MOST_LEVELS = 8
"""Most frames in which large deformation is solved for. Set by hand; UNPREDICTED mostly stops earlier."""
UNPREDICTED = 0.01
"""Frames are computed until the prediction error is below this share of the largest correction. Set by
hand: the correction is about a tenth of the displacement, so that 0.1 % of that remains."""
FIRST_TOLERANCE, TO_SPARE, TOLERANCE = 1e-2, 0.03, 1e-3
"""Force residual over the load: in the first round; then this share of the last change of E; at least the
last value. With 3e-4, half of AGREED and fourteen points an element, E of three recordings differs by 0.01 to
0.02 % and takes 1.6 times as long."""
JITTER = 1e-10
"""Share of the kernel's trace added to its diagonal: chosen frames may be nearly equal."""
SMALL_ROUNDS = 2
"""Rounds at small strain in every frame: the second applies the load where the first moves skin and fruit."""
ROUNDS, AGREED = 10, 1e-3
"""Most rounds at finite strain in the chosen frames; greatest relative difference of the last fitted E from
the E of its solve. If 1 % in the latter moves the fit by 0.1 %, E is then within 0.01 %; with soft jaws,
where the fit moves by 0.9 %, within 0.05 %."""
LONGEST = 2.0
"""Greatest step of ln E over that of the last fit. Set by hand: twice is enough where fits alternate, as with
soft jaws."""


def neo_hookean_solid(solid: UnitModulusSolid) -> FiniteStrainSolid:
    """The solid under the law of grading, ready for several threads. Four points an element change E by less
    than 0.02 % (TOLERANCE).
    """
    finite = FiniteStrainSolid(solid=solid, law=NeoHookean(poisson_ratio=solid.poisson_ratio), degree=2)
    finite.prepare()
    return finite


def with_finite_strain(
    model: GraspModel,
    history: GraspHistory,
    finite: FiniteStrainSolid,
    *,
    recorded: GraspHistory,
    force_sd_N: float,
    scale_sd: float,
) -> GraspModel:
    """The model with the finite-strain correction of its response in the frames used, at the E that results.

    `history`: the recording that drives models (fem.estimation.prepared_grasp); `model` is its model on the
    solid of `finite`. `recorded`: the same with the rims of its contacts. `force_sd_N`: noise of a component
    of a force of `history` (PreparedGrasp.force_sd_N). `scale_sd` as in fem.estimation.compliance_fit. The
    correction includes the fruit's rotation, since markers are compared in the axes of the recording.

    Raises FemFailure: NO_LOAD, TOO_FEW_MARKERS, NOT_CONVERGED (a frame's forces, or E), NO_MODULUS.
    """
    used = loaded_frames(history)
    tracks, force_N = marker_tracks(history, model, used)
    require_markers(tracks)
    linear = fit_compliance(tracks, scale_sd=scale_sd, fruit_moves=model.fruit_moves)
    response = finite_response(
        history,
        finite,
        recorded=recorded,
        force_sd_N=force_sd_N,
        modulus_MPa=require_positive(linear.compliance),
        scale_sd=scale_sd,
    )
    correction = np.zeros((len(used), *model.place_mm.shape))
    correction[used] = response.unit_displacement - model.unit_displacement(force_N)
    return replace(model, displacement_correction=correction)


@dataclass(frozen=True, kw_only=True)
class FiniteResponse:
    """`unit_displacement`: E times the markers' displacement in the frames used (mm MPa), in the axes of the
    recording, less a small rigid motion in each frame; zero out of contact. `fit`: that of 1/E, in the axes
    of the fruit.
    """

    unit_displacement: Float[np.ndarray, "f n 3"]
    modulus_MPa: float
    fit: CompliantFit


def finite_response(
    driven: GraspHistory,
    finite: FiniteStrainSolid,
    *,
    recorded: GraspHistory,
    force_sd_N: float,
    modulus_MPa: float,
    scale_sd: float,
) -> FiniteResponse:
    """The response under the forces of `driven`; `modulus_MPa`: a first guess of E.

    `recorded`, `force_sd_N`, `scale_sd` and what it raises: as `with_finite_strain`.
    """
    solid, used = finite.solid, loaded_frames(driven)
    skin = np.sort(solid.mesh.outer_nodes)
    on_skin = replace(solid, contact_nodes=skin)
    pads = [PadFrames.of(*pair, used, force_sd_N) for pair in zip(recorded.pads, driven.pads, strict=True)]
    every = np.arange(int(used.sum()))
    motion = FruitMotion(np.tile(np.eye(3), (len(every), 1, 1)), np.zeros((len(every), 3)))
    unit = np.zeros((len(every), len(skin), 3))
    for _ in range(SMALL_ROUNDS):
        load = nodal_loads(pads, solid.mesh, skin, motion, unit / modulus_MPa, every)
        if not load.any():
            raise FemFailure(
                FemProblem.NO_LOAD,
                "no force of a pad reaches the mesh, expected a pad that faces its skin; check the poses",
            )
        unit = linear = on_skin.contact_displacement(load)
        fitted = _fitted(solid, skin, driven, used, motion, unit, modulus_MPa, scale_sd=scale_sd)
        motion, modulus_MPa = fitted.motion, require_positive(fitted.fit.compliance)
    work = np.einsum("tcx,scx->ts", load[:, skin], linear, optimize=True)
    kernel = elastic_kernel(work, float(np.diag(work).max()))
    chosen = _chosen(kernel)
    moved_mm: Float[np.ndarray, "k n 3"] | None = None
    tolerance, rounds = FIRST_TOLERANCE, list[tuple[float, float]]()
    for _ in range(ROUNDS):
        before = modulus_MPa
        load = nodal_loads(pads, solid.mesh, skin, motion, unit / before, chosen)
        moved_mm = finite.displacement(load / before, start=moved_mm, tolerance=tolerance)
        unit = linear + _predicted(kernel, chosen, before * moved_mm[:, skin] - linear[chosen])
        fitted = _fitted(solid, skin, driven, used, motion, unit, before, scale_sd=scale_sd)
        motion, fitted_MPa = fitted.motion, require_positive(fitted.fit.compliance)
        changed = abs(fitted_MPa / before - 1)
        if changed < AGREED and tolerance == TOLERANCE:
            break
        tolerance = max(TOLERANCE, min(tolerance, TO_SPARE * changed))
        rounds.append((before, fitted_MPa))
        modulus_MPa = next_modulus(rounds)
        moved_mm = moved_mm * (before / modulus_MPa)
    else:
        raise FemFailure(
            FemProblem.NOT_CONVERGED,
            f"E at finite strain changes from {before:.4f} to {fitted_MPa:.4f} MPa in round "
            f"{ROUNDS}, expected agreement to {AGREED:.2%}. Check the forces",
        )
    apart = motion.out_of_fruit(fitted.places_mm + fitted.moved / fitted_MPa) - fitted.places_mm
    if solid.support == "free":
        apart = _without_rigid_motion(apart, fitted.tracks)
    on = (fitted.tracks.episode >= 0)[..., None]
    return FiniteResponse(
        unit_displacement=np.where(on, fitted_MPa * apart, 0.0), modulus_MPa=fitted_MPa, fit=fitted.fit
    )


def next_modulus(rounds: Sequence[tuple[float, float]]) -> float:
    """The E at which to solve next, from each round so far: the E of its solve and the E of its fit.

    With x = ln E and h(x) = ln (E fitted / E), the root of the secant of h through the last two rounds, at
    most LONGEST steps of the last fit away. After one round, or if h grows with x, the fitted E.

    >>> round(next_modulus([(1.0, 1.2), (1.2, 1.02)]), 3)
    1.101
    """
    (x, h), *before = [(np.log(solved), np.log(fitted / solved)) for solved, fitted in reversed(rounds)]
    step = h
    if before and x != before[0][0] and (slope := (h - before[0][1]) / (x - before[0][0])) < 0:
        step = np.clip(-h / slope, -LONGEST * abs(h), LONGEST * abs(h))
    return float(np.exp(x + step))


@dataclass(frozen=True, kw_only=True)
class _Fitted:
    """`places_mm`: the markers' material points; `moved`: E u there; `motion`: the fruit's, refined."""

    places_mm: Float[np.ndarray, "f n 3"]
    moved: Float[np.ndarray, "f n 3"]
    tracks: MarkerTracks
    fit: CompliantFit
    motion: FruitMotion


def _fitted(
    solid: UnitModulusSolid, skin: Int[np.ndarray, " c"], driven: GraspHistory, used: Bool[np.ndarray, " t"],
    motion: FruitMotion, unit: Float[np.ndarray, "f c 3"], modulus_MPa: float, *, scale_sd: float,
) -> _Fitted:  # fmt: skip
    """1/E and the fruit's motion fitted to the markers; E times the skin's displacement is `unit`."""
    history = in_fruit_axes(driven, used, motion)
    places, moved = _at_markers(solid.mesh, skin, history, used, unit, modulus_MPa)
    tracks = tracks_of(history, used, normal=np.zeros_like(places[0]), unit_displacement=moved)
    fit = fit_compliance(tracks, scale_sd=scale_sd, fruit_moves=solid.support == "free")
    if solid.support == "free":
        modelled = places + moved / require_positive(fit.compliance)
        motion = refined_motion(tracks, modelled, motion)
    return _Fitted(places_mm=places, moved=moved, tracks=tracks, fit=fit, motion=motion)


def _without_rigid_motion(
    moved_mm: Float[np.ndarray, "f n 3"], tracks: MarkerTracks
) -> Float[np.ndarray, "f n 3"]:
    """Less each frame's small rigid motion of the touching markers; a rotation's second order remains."""
    modes = rigid_motion(tracks.place_mm)
    left = moved_mm.copy()
    for frame, on in enumerate(tracks.episode >= 0):
        if on.any():
            frame_modes = modes[on].reshape(-1, 6)
            amounts = np.linalg.lstsq(frame_modes, moved_mm[frame, on].ravel(), rcond=None)[0]
            left[frame] -= modes @ amounts
    return left


def _predicted(
    kernel: Float[np.ndarray, "f f"], chosen: Int[np.ndarray, " k"], values: Float[np.ndarray, "k c 3"]
) -> Float[np.ndarray, "f c 3"]:
    """Values in all frames, from those of the chosen ones."""
    weights = weights_of_known(kernel, chosen, JITTER * float(kernel[chosen, chosen].sum()))
    return np.asarray(np.einsum("kt,kcx->tcx", weights, values, optimize=True))


def _at_markers(
    mesh: FleshMesh,
    skin: Int[np.ndarray, " c"],
    history: GraspHistory,
    used: Bool[np.ndarray, " t"],
    unit: Float[np.ndarray, "f c 3"],
    modulus_MPa: float,
) -> tuple[Float[np.ndarray, "f n 3"], Float[np.ndarray, "f n 3"]]:
    """The markers' material points in each frame (one a contact), and E u there; zero out of contact."""
    episode = np.concatenate([pad.episode[used] for pad in history.pads], axis=1)
    position = np.concatenate([pad.position_mm[used] for pad in history.pads], axis=1)
    places, moved = position.copy(), np.zeros_like(position)
    face_nodes = np.zeros((position.shape[1], 6), dtype=np.int64)
    reference = np.zeros((position.shape[1], 2))
    for contact in range(int(episode.max()) + 1):
        during = episode == contact
        first = np.where(during.any(axis=0), during.argmax(axis=0), -1)
        for frame in np.unique(first[first >= 0]):
            who = first == frame
            nodes = mesh.nodes_mm.copy()
            nodes[skin] += unit[frame] / modulus_MPa
            deformed = FleshMesh(nodes, mesh.tets, mesh.outer_faces, mesh.pit_nodes)
            at = locate(deformed, position[frame, who])
            face_nodes[who], reference[who] = at.face_nodes, at.reference
        who = np.flatnonzero(first >= 0)
        touched = SurfacePoints.at(mesh, face_nodes[who], reference[who])
        here = during[:, who, None]
        places[:, who] = np.where(here, touched.point_mm, places[:, who])
        moved[:, who] = np.where(here, touched.among(skin).sample(unit), moved[:, who])
    return places, moved


def _chosen(kernel: Float[np.ndarray, "t t"]) -> Int[np.ndarray, " k"]:
    """Frames by pivoted Cholesky, until the others are predicted to UNPREDICTED."""
    left, columns, chosen = np.diag(kernel).copy(), np.zeros((len(kernel), 0)), list[int]()
    greatest = left.max()
    while len(chosen) < min(MOST_LEVELS, len(kernel)) and np.sqrt(left.max() / greatest) > UNPREDICTED:
        pivot = int(left.argmax())
        column = (kernel[:, pivot] - columns @ columns[pivot]) / np.sqrt(left[pivot])
        columns = np.column_stack([columns, column])
        left = np.maximum(left - column**2, 0.0)
        left[[*chosen, pivot]] = 0.0
        chosen.append(pivot)
    return np.array(chosen)
