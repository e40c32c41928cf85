"""Flesh under a law whose stress depends on the strains so far, under the forces of all recordings.

The law's equation and its solution are those of fem.solid.initial_stress; here are the recordings' chosen
frames one after the other, what of a solution their markers see, and where a search starts from.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from fem.materials.strain_path import PathLaw
from fem.mismatch.model.case_model import CaseModel
from fem.mismatch.model.path_frames import PathFrames, path_frames
from fem.mismatch.model.plain_model import GraspResponse, PlainModel
from fem.solid.initial_stress import AddedStress
from fem.solid.linear_solid import Support

MOST_ROUNDS = 40
"""Searches of cases with these effects end after 1 to 10 rounds."""
CLOSE_MM = 6e-4
"""Rounds end when none asks a node of the skin to move more than this: a tenth of a marker's noise."""

SMALL_SHARE = 1e-4
"""Fields of force smaller than this share of the largest are left out of a round."""


@dataclass(frozen=True, kw_only=True)
class PathState:
    """The chosen frames of all recordings one after the other. `linear`: v0; `first` of each recording."""

    base: PlainModel
    frames: tuple[PathFrames, ...]
    linear: Float[np.ndarray, "f n 3"]

    @classmethod
    def of(cls, base: PlainModel, frames: tuple[PathFrames, ...]) -> "PathState":
        """Under the recordings' forces."""
        fields = [
            _combined(recording, chosen_frames)
            for recording, chosen_frames in zip(base.grasps, frames, strict=True)
        ]
        return cls(base=base, frames=frames, linear=np.concatenate(fields))

    @property
    def first(self) -> list[int]:
        """Where each recording begins among the frames, and the end."""
        return [0, *np.cumsum([len(chosen_frames.chosen) for chosen_frames in self.frames]).tolist()]

    def response(self, force: Float[np.ndarray, "f n 3"]) -> Float[np.ndarray, "f n 3"]:
        """K0^-1 of nodal forces, each recording with its own support."""
        displacement = np.empty_like(force)
        for support, solid in self.base.solids.items():
            held = self._held(support)
            turn, parts = _few(force[held])
            displacement[held] = np.tensordot(turn, solid.displacement(parts), axes=1)
        return displacement

    def marker_responses(
        self, forces: Sequence[Float[np.ndarray, "f n 3"]]
    ) -> list[list[Float[np.ndarray, "_f _n 3"]]]:
        """`at_markers` of the `response` to each of several laws' forces, solved for together."""
        by_law: list[dict[str, Float[np.ndarray, "_f _n 3"]]] = [{} for _ in forces]
        for support, solid in self.base.solids.items():
            held = self._held(support)
            turns, parts = zip(*(_few(force[held]) for force in forces), strict=True)
            on_skin = solid.contact_displacement(np.concatenate(parts))
            cuts = np.cumsum([len(part) for part in parts])[:-1]
            for responses, turn, part in zip(by_law, turns, np.split(on_skin, cuts), strict=True):
                moved, first = np.tensordot(turn, part, axes=1), 0
                for recording, frames in zip(self.base.grasps, self.frames, strict=True):
                    if recording.case.support == support:
                        after = first + len(frames.chosen)
                        seen_at = recording.seen(moved[first:after])
                        responses[recording.case.name] = np.tensordot(frames.mix, seen_at, axes=1)
                        first = after
        return [[responses[recording.case.name] for recording in self.base.grasps] for responses in by_law]

    def at_markers(self, field: Float[np.ndarray, "f m 3"]) -> list[Float[np.ndarray, "_f _n 3"]]:
        """Of every recording, in all frames used."""
        responses = []
        for recording, chosen_frames, a, b in zip(
            self.base.grasps, self.frames, self.first, self.first[1:], strict=False
        ):
            seen_at = recording.at_markers(field[a:b])
            responses.append(np.tensordot(chosen_frames.mix, seen_at, axes=1))
        return responses

    def _held(self, support: Support) -> Int[np.ndarray, " g"]:
        """Which frames are of recordings with this support."""
        of_recording = [recording.case.support == support for recording in self.base.grasps]
        return np.flatnonzero(np.repeat(of_recording, np.diff(self.first)))


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


def _combined(recording: GraspResponse, chosen_frames: PathFrames) -> Float[np.ndarray, "k n 3"]:
    return np.asarray(np.tensordot(recording.shares[chosen_frames.chosen], recording.moved, axes=1))


def path_state(model: CaseModel, *, frames: int, remembers: bool) -> PathState:
    """The model's recordings by about so many frames (times its path_share), chosen once."""

    def compute() -> PathState:
        count = max(round(model.path_share * frames), len(model.grasps))
        return PathState.of(model.base, path_frames(model.grasps, count, remembers=remembers))

    return model.memoised(("path", frames, remembers), compute)


def fixed_point(
    model: CaseModel,
    state: PathState,
    law: PathLaw,
    *,
    name: str,
    place: Float[np.ndarray, " p"],
    together: bool,
    start: Float[np.ndarray, "f n 3"] | None = None,
    stiffer: Float[np.ndarray, " f"] | None = None,
) -> Float[np.ndarray, "f n 3"]:
    """v - v0 of flesh with this law, to CLOSE_MM at the skin; see AddedStress, also for `together`.

    The search starts from its nearest solution with the law of this `name`, else from `start` (None: zero);
    `place`: the law's among them. `stiffer`: None for laws that soften. Raises FemFailure (NOT_CONVERGED).
    """
    problem = AddedStress(
        linear=state.linear,
        added_force=lambda moved: model.pieces.forces(moved, law),
        response=state.response,
        compliance=model.compliance,
        stiffer=np.ones(len(state.linear)) if stiffer is None else stiffer,
        skin=state.base.case.mesh.outer_nodes,
    )
    known = None if model.warm_starts is None else model.warm_starts.nearest(name, place)
    more = problem.beyond_linear(
        start=start if known is None else known[1],
        together=together,
        tolerance_mm=CLOSE_MM,
        rounds=MOST_ROUNDS,
    )
    if model.warm_starts is not None:
        model.warm_starts.keep(name, place, more.astype(np.float32))
    return more


def whole_response(state: PathState, more: Float[np.ndarray, "f m 3"]) -> list[Float[np.ndarray, "_f _n 3"]]:
    """The markers' displacement with v - v0 = `more` added to the linear one, of every recording."""
    return [
        recording.tracks.unit_displacement + displacement
        for recording, displacement in zip(state.base.grasps, state.at_markers(more), strict=True)
    ]
