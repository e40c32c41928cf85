"""Loads of the pads on the deformed skin of a fruit, frame by frame, from the gel's traction."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from fem.estimation.fruit_motion import FruitMotion, span_a_plane
from fem.fem_failure import FemFailure, FemProblem
from fem.grasp_history import PadHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.solid.gel_traction import GelField, GelFrame, MarkerGrid, nodal_force

CLEAR = 3.0
"""A denoised normal force counts as contact above this many standard deviations of its noise. Set by hand, at
the usual level: noise alone exceeds it in one of 700 markers. Other levels were not tried."""
OFF_CONTACT = 3.0
"""A marker more than this many pitches from the touching ones has noise alone: a rim that noise hides is one
or two wide."""
HALF_TURN = np.array([1.0, -1.0, -1.0])
"""About the x axis."""


@dataclass(frozen=True)
class PadFrames:
    """One pad in the frames used, its own axes (mm, N)."""

    rest_mm: Float[np.ndarray, "n 3"]
    turn: Float[np.ndarray, "f 3 3"]
    origin_mm: Float[np.ndarray, "f 3"]
    fields: tuple[GelField | None, ...]

    @classmethod
    def of(
        cls, recorded: PadHistory, driven: PadHistory, used: Bool[np.ndarray, " t"], force_sd_N: float
    ) -> "PadFrames":
        """The pose maps markers at rest to their places without gel displacement; z points into the fruit.

        Noise hides the rim of the recorded contact: a marker with a recorded force also touches if its
        driving force clearly pushes.
        """
        rest, at = recorded.rest_mm, (recorded.position_mm - recorded.gel_displacement_mm)[used]
        if not span_a_plane(rest):
            raise FemFailure(
                FemProblem.TOO_FEW_MARKERS,
                f"the {len(rest)} markers of pad {recorded.name} lie on a line, expected markers "
                "beside it too",
            )
        middle = rest.mean(axis=0)
        turn = np.stack(
            [Rotation.align_vectors(x - x.mean(axis=0), rest - middle)[0].as_matrix() for x in at]
        )
        if float((driven.force_N[used].sum(axis=1) * turn[:, :, 2]).sum()) < 0:
            rest, middle, turn = rest * HALF_TURN, middle * HALF_TURN, turn * HALF_TURN
        forces, felt = driven.force_N[used] @ turn, recorded.episode[used] >= 0
        noise_N = max(force_sd_N, _noise_off_contact_N(rest, forces[:, :, 2], felt))
        pushes = (forces[:, :, 2] > CLEAR * noise_N) & recorded.force_N[used].any(axis=2)
        touching = felt | pushes
        grid = MarkerGrid.of(rest[:, :2])
        return cls(
            rest_mm=rest,
            turn=turn,
            origin_mm=at.mean(axis=1) - turn @ middle,
            fields=tuple(
                GelField.of(GelFrame(grid=grid, shear_mm=moved[:, :2], force_N=force, touching=on))
                for moved, force, on in zip(
                    recorded.gel_displacement_mm[used] @ turn, forces, touching, strict=True
                )
            ),
        )


def _noise_off_contact_N(
    rest_mm: Float[np.ndarray, "n 3"], normal_N: Float[np.ndarray, "f n"], felt: Bool[np.ndarray, "f n"]
) -> float:
    """Root mean square of the normal forces at markers at least OFF_CONTACT pitches from those that touch.

    It includes the noise of a frame and the error of each marker's zero, which all frames share.
    """
    apart = cdist(rest_mm, rest_mm)
    pitch = float(np.median(np.sort(apart, axis=1)[:, 1]))
    near = np.asarray(felt @ (apart < OFF_CONTACT * pitch))
    off = ~near & near.any(axis=1, keepdims=True)
    return float(np.sqrt(np.mean(normal_N[off] ** 2))) if off.any() else 0.0


def nodal_loads(
    pads: list[PadFrames], mesh: FleshMesh, skin: Int[np.ndarray, " c"], motion: FruitMotion,
    moved_mm: Float[np.ndarray, "f c 3"], frames: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "k n 3"]:  # fmt: skip
    """Forces of all pads on the nodes in these frames, N, in the fruit's axes."""
    faces = np.searchsorted(skin, mesh.outer_faces)
    load = np.zeros((len(frames), *mesh.nodes_mm.shape))
    for k, frame in enumerate(frames):
        turn = motion.turn[frame]
        here = (mesh.nodes_mm[skin] + moved_mm[frame]) @ turn.T + motion.shift_mm[frame]
        for pad in pads:
            field = pad.fields[frame]
            if field is not None:
                local = (here - pad.origin_mm[frame]) @ pad.turn[frame]
                load[k, skin] += nodal_force(field, local, faces) @ pad.turn[frame].T @ turn
    return load
