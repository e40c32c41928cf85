"""Candidate grasps: where the jaws could close next, and how.

Opposing jaws keep their distance apart; what may change is where they close, as a turn of a recorded grasp
about the fruit's centre, and how: depth, speed, hold, cycles.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from fem.mismatch.model.baseline import GraspResponse

STEM = np.array([0.0, 0.0, 1.0])
"""The stem's axis in the fruit frame."""
DEEPER, SLOWER, HOLD_S, CYCLES = 1.5, 0.1, 10.0, 2
"""Depth and speed over those recorded, the long hold (s), and cycles. Set by hand: what any gripper can do,
and well apart from the recorded grasp."""
TILT_DEG, ROUND_DEG = 30.0, (45.0,)
"""Further directions of the jaws: towards the stem, and round it. Set by hand, to bound the time."""
ALONG_STEM = 0.8
"""Cosine between jaws' direction and stem from which turning about the stem moves no pad. Set by hand."""
SAME_DEG = 15.0
"""Directions of two grasps within this angle are the same spots: about half a patch. Set by hand."""


class PlaceKind(StrEnum):
    """Where a candidate's pads go."""

    SAME = "same spots"
    TURNED = "same spots turned"
    ACROSS = "across"
    ROUND = "elsewhere round the stem"
    TILTED = "tilted towards the stem"


@dataclass(frozen=True, kw_only=True)
class Place:
    """A recorded grasp (its number) turned about the fruit's centre by `rotation`."""

    kind: PlaceKind
    source: int
    rotation: Float[np.ndarray, "3 3"]

    @property
    def on_pressed_flesh(self) -> bool:
        """Whether the flesh there has been pressed before."""
        return self.kind in (PlaceKind.SAME, PlaceKind.TURNED)


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """How the jaws close: `depth` and `speed` over those recorded, hold in s (None: as recorded), cycles."""

    depth: float = 1.0
    speed: float = 1.0
    hold_s: float | None = None
    cycles: int = 1


@dataclass(frozen=True, kw_only=True)
class CandidateGrasp:
    """One grasp that could be recorded next."""

    place: Place
    protocol: Protocol


AS_BEFORE, TWICE = Protocol(), Protocol(cycles=CYCLES)
SLOW, DEEP = Protocol(speed=SLOWER, hold_s=HOLD_S), Protocol(depth=DEEPER)
FULL = (AS_BEFORE, DEEP, Protocol(speed=SLOWER), Protocol(hold_s=HOLD_S), TWICE, SLOW)
"""Protocols at the places that are tried first; elsewhere FEW of them."""
FEW = (AS_BEFORE, TWICE, SLOW)


def candidate_grasps(grasps: tuple[GraspResponse, ...]) -> list[CandidateGrasp]:
    """About thirty, the least effort first among those of one place."""
    source = next((k for k, grasp in enumerate(grasps) if abs(jaws_of(grasp) @ STEM) < ALONG_STEM), 0)
    jaws = jaws_of(grasps[source])

    def place(kind: PlaceKind, degrees: float, axis: Float[np.ndarray, "3"], of: int = source) -> Place:
        return Place(kind=kind, source=of, rotation=_about(axis, degrees))

    full = [
        place(PlaceKind.SAME, 0.0, STEM),
        place(PlaceKind.TURNED, 180.0, STEM),
        place(PlaceKind.ACROSS, 90.0, STEM),
    ]
    few = [place(PlaceKind.ROUND, degrees, STEM) for degrees in ROUND_DEG]
    if abs(jaws @ STEM) < ALONG_STEM:
        sideways = np.cross(STEM, jaws)
        few += [place(PlaceKind.TILTED, sign * TILT_DEG, sideways) for sign in (1, -1)]
    else:  # turned about the stem, jaws along it stay where they are
        full, few = full[:1], []
    for number, other in enumerate(grasps):
        known = [grasps[spot.source] for spot in full if spot.kind == PlaceKind.SAME]
        if not any(_angle_deg(jaws_of(other), jaws_of(grasp)) < SAME_DEG for grasp in known):
            few.append(place(PlaceKind.SAME, 0.0, STEM, number))
            break
    return [CandidateGrasp(place=spot, protocol=how) for spot in full for how in FULL] + [
        CandidateGrasp(place=spot, protocol=how) for spot in few for how in FEW
    ]


def jaws_of(recording: GraspResponse) -> Float[np.ndarray, "3"]:
    """Unit direction in which the first pad presses, against the last one where there are several."""
    first = recording.case.turns[0, :, 2]
    along = first - (recording.case.turns[-1, :, 2] if len(recording.links) > 1 else 0.0)
    return np.asarray(along / np.linalg.norm(along))


def _about(axis: Float[np.ndarray, "3"], degrees: float) -> Float[np.ndarray, "3 3"]:
    return np.asarray(Rotation.from_rotvec(np.deg2rad(degrees) * axis / np.linalg.norm(axis)).as_matrix())


def _angle_deg(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> float:
    return float(np.rad2deg(np.arccos(np.clip(abs(a @ b), 0.0, 1.0))))
