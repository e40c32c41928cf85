"""E from each frame of a closing gripper."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array
from threadpoolctl import threadpool_limits

from drupe.array_batch import Pit, Surface, array_batch, array_task, silent
from drupe.numbers import PerPad, numbers, per_pad
from drupe.refusal import DrupeError
from fem.estimation.live_modulus import FirstTouch, FrameEstimate, LiveModel, frame_modulus
from fem.grasp_history import SMALLEST_SD_MM, PadHistory
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import linked, pad_places
from pipeline.fruit.flesh_model import flesh_mesh, poisson_ratio
from pipeline.fruit.fruit_shape import FruitShape, embedded_pit, fruit_shape
from tactile.contact import frames_in_air, neighbourhood, touching_markers
from tactile.noise import FEWEST_NO_CONTACT_FRAMES, no_contact_noise
from tactile.readers.recording import GelPad, Recording
from tactile.readers.recording_fields import are_rigid
from tactile.registration import FARTHEST_SHARE, depth_along


@dataclass(frozen=True, kw_only=True)
class LivePad:
    """A pad before contact: zero and noise of its readings; `used`: the markers that the model contains."""

    rest_mm: Float[np.ndarray, "n 3"]
    displacement_zero_mm: Float[np.ndarray, "n 3"]
    force_zero_N: Float[np.ndarray, "n 3"]
    displacement_sd_mm: float
    force_sd_N: float
    neighbours: csr_array
    used: Bool[np.ndarray, " n"]
    surface_mm: Float[np.ndarray, "k 3"]


class LiveModulus:
    """A grasp in progress. `estimate` takes one frame after the other; `restart` discards all frames."""

    def __init__(self, model: LiveModel, pads: tuple[LivePad, ...]) -> None:
        self._model, self._pads = model, pads
        self.restart()

    @property
    def markers(self) -> tuple[Int[np.ndarray, " _k"], ...]:
        """Indices of each pad's markers in the model, in the order of a frame's residuals, pad by pad."""
        return tuple(np.flatnonzero(pad.used) for pad in self._pads)

    def restart(self) -> None:
        """Returns to the state before the first touch."""
        self._before = FirstTouch.none(sum(int(pad.used.sum()) for pad in self._pads))

    def estimate(self, displacement_mm: PerPad, force_N: PerPad, pose: PerPad) -> FrameEstimate:
        """E from this frame and the markers' first touches; an entry per pad in each argument.

        `displacement_mm` and `force_N` (N, 3) as in `recording`; `pose` (4, 4). Returns `E_MPa`, `E_sd_MPa`
        (from the markers' noise alone) and `residual_mm` (n, 3) in the mesh's frame. E is NaN if fewer than
        six markers touch in both this and the previous frame, or if the fitted 1/E is not positive. Raises
        DrupeError for a wrong shape, a value that is not finite, or a pose that is not rigid.
        """
        given = {"displacement_mm": displacement_mm, "force_N": force_N, "pose": pose}
        of_pads = {name: per_pad(name, arrays) for name, arrays in given.items()}
        for name, arrays in of_pads.items():
            if len(arrays) != len(self._pads):
                raise DrupeError(f"{name}: found {len(arrays)} pads, expected {len(self._pads)}")
        place, push, touch = [], [], []
        for k, pad in enumerate(self._pads):
            shape = (len(pad.rest_mm), 3)
            moved = numbers(f"displacement_mm[{k}]", of_pads["displacement_mm"][k], shape)
            moved = moved - pad.displacement_zero_mm
            force = numbers(f"force_N[{k}]", of_pads["force_N"][k], shape) - pad.force_zero_N
            at = numbers(f"pose[{k}]", of_pads["pose"][k], (4, 4))
            if not are_rigid(at[None]).all():
                raise DrupeError(
                    f"pose[{k}]: found a matrix that is no rotation and shift, expected one in mm"
                )
            pressed = touching_markers(force[None, :, 2], pad.force_sd_N, pad.neighbours)[0]
            place.append((pad.rest_mm + moved)[pad.used] @ at[:3, :3].T + at[:3, 3])
            push.append(force[pad.used] @ at[:3, :3].T)
            touch.append(pressed[pad.used])
        estimate, self._before = frame_modulus(
            self._model,
            self._before,
            position_mm=np.vstack(place),
            force_N=np.vstack(push),
            touching=np.concatenate(touch),
            sd_mm=max(pad.displacement_sd_mm for pad in self._pads),
        )
        return estimate


def live(
    mesh: Surface,
    air: Recording,
    *,
    travel_mm: float,
    pit: Pit,
    nu: float | None,
    category: str | None = None,
    settings: Mapping[str, Any] | None = None,
    report: Callable[[str], None] = silent,
) -> LiveModulus:
    """Prepares E from each frame of a grasp, within milliseconds of the frame.

    `air`: six or more frames before the first touch, with the pads at the place where they will close on the
    fruit; drupe takes zero, noise and place from them and ignores later frames. `travel_mm`: the greatest
    travel of a jaw after the first touch; it determines which markers can touch. Other arguments as in
    `modulus`. Takes up to a minute; prepare it while the gripper waits in the air. The model always has small
    strain: E of soft fruit is up to 10 % above that of `modulus`.

    Raises DrupeError as `modulus` does, and for fewer frames, a bare indenter, or no fruit before a pad.
    """
    if not numbers("travel_mm", travel_mm, ()) > 0:
        raise DrupeError(f"travel_mm: found {travel_mm:g}, expected a travel above 0 mm")
    given = array_batch(mesh, [air], pit=pit, nu=nu, category=category, settings=settings)
    with given as root, threadpool_limits(1):
        task = array_task(root)
        shape = fruit_shape(task)
        pads = tuple(_in_air(pad, shape, travel_mm=travel_mm) for pad in air.pads)
        report("flesh")
        flesh = flesh_mesh(task, embedded_pit(task, shape), np.vstack([pad.surface_mm for pad in pads]))
        places = [pad_places(_without_frames(pad), flesh) for pad in pads]
        report("model")
        solid = UnitModulusSolid.factorise(
            flesh,
            poisson_ratio=poisson_ratio(task.settings, task.prior)[0],
            support=air.support,
            contact_nodes=np.unique(np.concatenate([place.nodes for place in places])),
        )
        return LiveModulus(LiveModel.of([linked(place, solid) for place in places], solid), pads)


def _in_air(pad: object, shape: FruitShape, *, travel_mm: float) -> LivePad:
    """Zero and noise of a pad's frames in the air, and the places where its markers will touch."""
    if not isinstance(pad, GelPad):
        raise DrupeError("air: found a bare indenter, expected pads with markers")
    frames = frames_in_air(pad) - 1  # the first touch begins between two frames
    if frames < FEWEST_NO_CONTACT_FRAMES:
        raise DrupeError(
            f"air: pad {pad.name}: found {max(frames, 0)} frames before the first touch, expected "
            f"{FEWEST_NO_CONTACT_FRAMES} or more; record more frames before the pads touch"
        )
    moved, pushed = no_contact_noise(pad.displacement_mm[:frames]), no_contact_noise(pad.force_N[:frames])
    pose = pad.pose[frames - 1]
    where, ahead = pad.rest_mm @ pose[:3, :3].T + pose[:3, 3], pose[:3, 2]
    depth = depth_along(where, ahead, shape.vertices[shape.faces])
    nearest = np.nanmin(depth, initial=np.inf)
    used = depth - nearest <= travel_mm
    if not used.any() or nearest < -FARTHEST_SHARE * float(np.ptp(shape.vertices, axis=0).max()):
        raise DrupeError(
            f"air: pad {pad.name}: found no fruit in front of the pad, expected the mesh there; check the "
            "poses' frame and that z of the pose points into the fruit"
        )
    return LivePad(
        rest_mm=pad.rest_mm,
        displacement_zero_mm=moved.offset,
        force_zero_N=pushed.offset,
        displacement_sd_mm=max(moved.sd, SMALLEST_SD_MM),
        force_sd_N=pushed.sd,
        neighbours=neighbourhood(pad.rest_mm)[1],
        used=used,
        surface_mm=where[used] + depth[used, None] * ahead,
    )


def _without_frames(pad: LivePad) -> PadHistory:
    """A grasp history of the pad's markers without any frame."""
    count = int(pad.used.sum())
    none = np.zeros((0, count, 3))
    return PadHistory(
        name="",
        rest_mm=pad.rest_mm[pad.used],
        surface_mm=pad.surface_mm,
        position_mm=none,
        gel_displacement_mm=none,
        force_N=none,
        episode=np.zeros((0, count), dtype=np.int64),
        displacement_sd_mm=pad.displacement_sd_mm,
        force_sd_N=pad.force_sd_N,
        lag1=0.0,
    )
