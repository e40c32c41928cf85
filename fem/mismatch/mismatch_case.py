"""Input of the finder: one fruit's mesh, and its recordings as histories in the fruit frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import GraspModel
from fem.grasp_history import GraspHistory
from fem.mesh.flesh_mesh import FleshMesh
from fem.mismatch.result import Modulus
from fem.solid.linear_solid import Support, UnitModulusSolid


@dataclass(frozen=True, kw_only=True)
class PadMotion:
    """One pad as the machine drove it, every frame of the recording.

    `pose`: pad frame to fruit frame. `normal_N`: total recorded normal force of all the pad's markers, with
    its offset. `markers`: their number. `gel_N_per_mm`: normal stiffness of the gel under one marker as
    stated by its maker or a calibration, or None.
    """

    name: str
    pose: Float[np.ndarray, "t 4 4"]
    normal_N: Float[np.ndarray, " t"]
    markers: int
    gel_N_per_mm: float | None = None


@dataclass(frozen=True, kw_only=True)
class GraspCase:
    """One recording: its history (markers in and around the patch), and the motion of its pads.

    `pads`: in the order of `history.pads`. `correction`: displacement that confirmed effects add to the plain
    model's response, mm MPa, all frames (GraspModel.displacement_correction); None: nothing.
    """

    name: str
    history: GraspHistory
    pads: tuple[PadMotion, ...]
    support: Support
    correction: Float[np.ndarray, "t n 3"] | None = None

    @property
    def turns(self) -> Float[np.ndarray, "p 3 3"]:
        """Each pad's axes in the fruit frame, as columns, in its frame of greatest force."""
        return np.stack([pad.pose[int(np.argmax(pad.normal_N)), :3, :3] for pad in self.pads])


@dataclass(frozen=True, kw_only=True)
class MismatchCase:
    """All recordings of one fruit, its flesh around the prior's pit, and the assumptions about them.

    `finer_mesh`: of the same flesh, for the plain response (fem.mismatch.model.finer_mesh); None: `mesh`.
    """

    mesh: FleshMesh
    grasps: tuple[GraspCase, ...]
    poisson_ratio: float
    budget: ErrorBudget
    finer_mesh: FleshMesh | None = None


@dataclass(frozen=True, kw_only=True)
class GradedCase:
    """Grading's results for the same recordings: E without an effect, and one model about the prior's pit for
    each recording. A model is None if grading has no E of the recording, or none by displacement since first
    touch. `solids`: grading's factorised solids about the prior's pit, by support; the finder factorises
    missing ones itself.
    """

    modulus: Modulus
    models: tuple[GraspModel | None, ...] = ()
    solids: Mapping[Support, UnitModulusSolid] = field(default_factory=dict, repr=False)
