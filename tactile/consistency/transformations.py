"""Mistakes of people and machines in a valid recording, each with the change that undoes it.

A transformation of signals is tried on the pads that fail; one of poses, clock, aperture or mesh on the whole
recording. `log_prior` is 0 if the mistake is exactly undone. A fitted factor g costs log prior for its
freedom and its size. Its freedom costs 5, from a prior of width 3 on ln g and a posterior of 0.02; its size
has a standard deviation of 0.4 in ln g.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from tactile.consistency.finding import MEANINGLESS, Field, FindingKind
from tactile.consistency.footprint import E_OF_A_TURN
from tactile.consistency.misfit import CAUSES, Misfit, Situation
from tactile.consistency.relations import E_PER_GAIN, correlation, gain_of
from tactile.correction import straightened
from tactile.readers.recording import GelPad

FORCE = {
    101.97: "grams",
    0.10197: "kilograms",
    1e3: "millinewtons",
    1e-3: "kilonewtons",
    0.22481: "pounds",
    3.5969: "ounces",
    1e5: "dynes",
    1e6: "micronewtons",
}
"""Factor from a number in newtons to one in another unit."""
LENGTH = {1e-3: "metres", 0.1: "centimetres", 1e3: "micrometres", 1 / 25.4: "inches"}
"""The same from millimetres."""
STIFFNESS = {1e3: "kPa/mm (or MPa/m)", 1e6: "Pa/mm", 1e-3: "GPa/mm"}
"""The same from MPa/mm."""
E_PER_FORCE = 1.1
"""Error of ln E per ln of a factor on the force: E at 1.3 times the force is 1.28 to 1.32 times
(benchmarks/field_mistakes.py --grade)."""
FIELDS: dict[Field, str] = {"force": "force_N", "displacement": "displacement_mm"}
FREE, FACTOR_SD = 5.0, 0.4
"""Log Bayes factor that a fitted factor costs, and standard deviation of its ln; above."""
BENDS = (0.2, 0.3, 0.4, 0.45)
"""Shares of the peak M that a saturating sensor loses there, as f = F (1 - bend F / M)."""
MOST_LAG = 15
"""Frames up to which a delay of the force is tried."""
LAGS = (*range(-10, -1), *range(2, 11))
"""Frames by which the gel's signals may lag the jaws."""
MOST_LEFT_OUT = (2, 3, 4)
"""One of every two, three or four markers was kept; fewer cannot show a contact of a fruit."""
QUARTERS = np.rint(Rotation.from_rotvec(np.kron(np.eye(3), [[-90.0], [90.0]]), degrees=True).as_matrix())
"""Rotations by 90 degrees about x, y and z, both ways: the likeliest for a mesh in another frame."""


@dataclass(frozen=True, kw_only=True)
class Transformation:
    """A mistake: its `cause` in words, with advice, and the situation without it.

    `relative_sd`: of E, if the recording is used as it is.
    """

    kind: FindingKind
    cause: str
    undone: Situation
    pads: tuple[str, ...] = ()
    field: Field | None = None
    detail: str = ""
    relative_sd: float = MEANINGLESS
    log_prior: float = 0.0
    has_effect: bool = False


Change = Callable[[GelPad], GelPad]


def of_signals(situation: Situation, names: Sequence[str]) -> Iterator[Transformation]:
    """Transformations of the signals of these pads."""
    pads = [press.pad for press in situation.pressings]
    share = len(names) / len(pads)

    def made(kind: FindingKind, cause: str, change: Change, **more: Any) -> Transformation:
        changed = [change(pad) if pad.name in names else pad for pad in pads]
        return Transformation(
            kind=kind, cause=cause, undone=situation.with_pads(changed), pads=tuple(names), **more
        )

    kind = FindingKind.SCALE
    for field, cause, factor, detail, log_prior in _factors(situation, names):
        sd = share * E_PER_GAIN * abs(float(np.log(factor)))
        change = _scaled(field, 1 / factor)
        yield made(kind, cause, change, field=field, detail=detail, relative_sd=sd, log_prior=log_prior)
    for count in MOST_LEFT_OUT:
        cause = f"the arrays hold only one of every {count} markers; write all markers"
        sd = share * E_PER_FORCE * float(np.log(count))
        change = _scaled("force", float(count))
        kind = FindingKind.MARKERS_MISSING
        yield made(kind, cause, change, relative_sd=sd, log_prior=-FREE - 1, detail=str(count))
    for field in ("force", "displacement"):
        yield from _of_field(field, made)
    yield from _orders(made)
    for bend in BENDS:
        cause = (
            f"force grows by {1 - 2 * bend:.1f} of its first slope at its peak: the sensor saturates or is "
            "nonlinear (run drupe explain for the amount)"
        )
        change = _on("force_N", straightened, -bend)
        sd = share * E_PER_FORCE * abs(float(np.log1p(-bend)))
        more: dict[str, Any] = {"field": "force", "relative_sd": sd, "log_prior": -FREE, "has_effect": True}
        yield made(FindingKind.SATURATION, cause, change, **more)
    lag = _best_lag(situation, names[0])
    if lag:
        cause = (
            f"force comes {abs(lag)} frames {'late' if lag > 0 else 'early'} relative to its displacement: "
            "the two clocks disagree; give both one clock"
        )
        change = _on("force_N", _moved, -lag)
        yield made(FindingKind.DELAY, cause, change, detail=f"{lag} frames")
    for times, unit in LENGTH.items():
        cause = f"rest_mm looks like {unit}; write millimetres"
        change = _on("rest_mm", np.divide, times)
        yield made(FindingKind.MARKERS_UNIT, cause, change, detail=unit)
    cause = "force and displacement are in each other's place; exchange them"
    yield made(
        FindingKind.FIELDS_EXCHANGED,
        cause,
        lambda pad: replace(pad, force_N=-pad.displacement_mm, displacement_mm=-pad.force_N),
    )


def _factors(situation: Situation, names: Sequence[str]) -> Iterator[tuple[Field, str, float, str, float]]:
    """Field, cause, factor, unit and log prior of each factor that the fields may have."""
    units: tuple[tuple[Field, str, dict[float, str]], ...] = (
        ("force", "forces look like {}; record newtons, or convert force_N", FORCE),
        ("displacement", "displacement looks like {}; record millimetres, or convert it", LENGTH),
        ("stiffness", "gel_kn_MPa_per_mm looks like {}; state it in MPa per mm", STIFFNESS),
    )
    for field, cause, known in units:
        for factor, unit in known.items():
            yield field, cause.format(unit), factor, unit, 0.0
    gains = [gain for press in situation.pressings if press.pad.name in names and (gain := gain_of(press))]
    if not gains:
        return
    gain = float(np.exp(np.mean(np.log(gains))))
    log_prior = -FREE - float(np.log(gain)) ** 2 / (2 * FACTOR_SD**2)
    yield "force", "force has a gain; calibrate the force", gain, "", log_prior
    yield "displacement", "displacement is scaled, or the gel creeps; calibrate it", 1 / gain, "", log_prior
    cause = "the stiffness (kn, kt) is that of another gel; state this gel's"
    yield "stiffness", cause, 1 / gain, "", log_prior


def _of_field(field: Field, made: Callable[..., Transformation]) -> Iterator[Transformation]:
    """Signs, axes, increments and orders of one field."""
    name = FIELDS[field]
    cause = (
        f"{field} has the wrong sign: pressing must move markers to negative z and give a positive force on "
        "the fruit"
    )
    yield made(FindingKind.SIGN, cause, _on(name, np.negative), field=field)
    for order in ((2, 1, 0), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1)):
        axes = "".join("xyz"[k] for k in np.argsort(order))
        cause = f"{field} has its axes exchanged: its columns are {axes}, expected xyz"
        change = _on(name, np.take, order, -1)
        yield made(FindingKind.AXES, cause, change, field=field, detail=axes)
    cause = f"{field} is written as increments between frames. Write {field} from rest"
    yield made(FindingKind.INCREMENTS, cause, _on(name, lambda v: np.cumsum(v, axis=0)), field=field)
    cause = f"{field} is summed up over frames. Write {field} from rest"
    change = _on(name, lambda v: np.diff(v, axis=0, prepend=v[:1]))
    yield made(FindingKind.INCREMENTS, cause, change, field=field)
    cause = f"{field}'s frames are in reverse order; write all fields in one order"
    yield made(FindingKind.DELAY, cause, _on(name, lambda v: v[::-1]), field=field, detail="reversed")


def _orders(made: Callable[..., Transformation]) -> Iterator[Transformation]:
    """Orders of the markers in one array."""
    for field, name in (*FIELDS.items(), (None, "rest_mm")):
        for words, order_of in (
            ("reversed", lambda v: np.flip(v, -2)),
            ("transposed (columns for rows)", _transposed),
        ):
            cause = f"the marker order of {name} is {words}; write all arrays in one order"
            change = _on(name, order_of)
            yield made(FindingKind.MARKERS_ORDER, cause, change, field=field, detail=words)


def of_machine(situation: Situation, *, late: bool) -> Iterator[Transformation]:
    """Transformations of poses and aperture; with `late` of the clock too."""
    pads = [press.pad for press in situation.pressings]
    recording = situation.recording

    def posed(kind: FindingKind, cause: str, poses: Sequence[np.ndarray], **more: Any) -> Transformation:
        changed = [replace(pad, pose=pose) for pad, pose in zip(pads, poses, strict=True)]
        return Transformation(kind=kind, cause=cause, undone=situation.with_pads(changed), **more)

    given = [pad.pose for pad in pads]
    for times, unit in LENGTH.items():
        cause = f"the poses look like {unit}; write millimetres"
        poses = [_placed(pose, pose[:, :3, 3] / times) for pose in given]
        yield posed(FindingKind.POSES_UNIT, cause, poses, detail=unit)
        cause = f"aperture_mm looks like {unit}; write millimetres"
        undone = replace(situation, recording=replace(recording, aperture_mm=recording.aperture_mm / times))
        kind = FindingKind.APERTURE_UNIT
        yield Transformation(kind=kind, cause=cause, undone=undone, detail=unit, relative_sd=0.0)
    cause = "the poses' rotations are transposed (fruit to pad instead of pad to fruit); transpose them"
    yield posed(FindingKind.POSES_TRANSPOSED, cause, [_with_rotation(p, np.swapaxes(p, 1, 2)) for p in given])
    cause = "the poses are inverted (fruit to pad instead of pad to fruit); invert them"
    yield posed(FindingKind.POSES_INVERTED, cause, [np.linalg.inv(pose) for pose in given])
    cause = (
        "the poses put the pads back to back. z must point out of the gel into the fruit, or the poses of "
        "left and right are swapped"
    )
    yield posed(FindingKind.POSES_BACK_TO_BACK, cause, [pose * [1.0, 1.0, -1.0, 1.0] for pose in given])
    if len(pads) == 2 and all(np.ptp(pose[:, :3, 3], axis=0).max() < 0.05 for pose in given):
        closed = (recording.aperture_mm[0] - recording.aperture_mm) / 2
        cause = "the poses stand still: poses of one instant, or of another recording"
        moved = [_placed(p, p[:1, :3, 3] + closed[:, None] * p[:1, :3, 2]) for p in given]
        yield posed(FindingKind.POSES_STILL, cause, moved)
    for lag in LAGS if late else ():
        changed = [
            replace(pad, displacement_mm=_moved(pad.displacement_mm, -lag), force_N=_moved(pad.force_N, -lag))
            for pad in pads
        ]
        yield Transformation(
            kind=FindingKind.CLOCKS_APART,
            cause=f"the clocks of gel and jaws are {abs(lag)} frames apart (lag); give both one clock",
            undone=situation.with_pads(changed),
            relative_sd=np.nan,
            has_effect=True,
            log_prior=-FREE / 2,
        )


def of_mesh(situation: Situation, failing: Sequence[Misfit]) -> Iterator[Transformation]:
    """Pads exchanged, and the mesh in another frame, or of another size if its width is a failing
    relation."""
    vertices = situation.vertices
    assert vertices is not None
    if len(situation.pressings) == 2:
        left, right = (press.pad for press in situation.pressings)
        yield Transformation(
            kind=FindingKind.PADS_EXCHANGED,
            cause="the contact imprints fit with the pads exchanged: left and right are swapped (signals or "
            "poses), or the mesh is rotated or of another fruit",
            undone=situation.with_pads([replace(left, pose=right.pose), replace(right, pose=left.pose)]),
            relative_sd=E_OF_A_TURN,
            log_prior=-float(np.log(len(QUARTERS))),
        )
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    for width in (misfit for misfit in failing if misfit.kind is FindingKind.WIDTH):
        yield Transformation(
            kind=FindingKind.WIDTH,
            cause=CAUSES[FindingKind.WIDTH],
            undone=replace(situation, vertices=centre + (vertices - centre) / float(width.detail)),
            relative_sd=width.relative_sd,
            log_prior=-FREE / 2,
        )
    for turn in QUARTERS:
        yield Transformation(
            kind=FindingKind.MESH_TURNED,
            cause="the contact imprints fit on the mesh rotated by 90 degrees: the mesh is rotated or of "
            "another fruit, or a pose is wrong",
            undone=replace(situation, vertices=centre + (vertices - centre) @ turn),
            relative_sd=E_OF_A_TURN,
            log_prior=-float(np.log(len(QUARTERS))),
        )


def _on(name: str, change: Callable[..., np.ndarray], *arguments: Any) -> Change:
    """`change` of one array of a pad; `arguments` come after the array."""

    def changed(pad: GelPad) -> GelPad:
        more: dict[str, Any] = {name: np.asarray(change(getattr(pad, name), *arguments))}
        return replace(pad, **more)

    return changed


def _scaled(field: Field, times: float) -> Change:
    if field != "stiffness":
        return _on(FIELDS[field], np.multiply, times)
    return lambda pad: replace(
        pad, gel_kn_MPa_per_mm=pad.gel_kn_MPa_per_mm * times, gel_kt_MPa_per_mm=pad.gel_kt_MPa_per_mm * times
    )


def _moved(values: Float[np.ndarray, "t n 3"], frames: int) -> Float[np.ndarray, "t n 3"]:
    """Values delayed by this many frames; the end values are repeated."""
    return np.asarray(values[np.clip(np.arange(len(values)) - frames, 0, len(values) - 1)])


def _transposed(values: Float[np.ndarray, "... n 3"]) -> Float[np.ndarray, "... n 3"]:
    """The markers of a square grid with columns and rows exchanged; any other grid stays."""
    count = values.shape[-2]
    side = round(count**0.5)
    if side**2 != count:
        return values
    return np.asarray(values[..., np.arange(count).reshape(side, side).T.ravel(), :])


def _placed(pose: Float[np.ndarray, "t 4 4"], places_mm: Float[np.ndarray, "t 3"]) -> np.ndarray:
    out = pose.copy()
    out[:, :3, 3] = places_mm
    return out


def _with_rotation(pose: Float[np.ndarray, "t 4 4"], rotations: Float[np.ndarray, "t 4 4"]) -> np.ndarray:
    out = pose.copy()
    out[:, :3, :3] = rotations[:, :3, :3]
    return out


def _best_lag(situation: Situation, name: str) -> int:
    """Frames by which a pad's force follows its displacement best."""
    press = next(press for press in situation.pressings if press.pad.name == name)
    u = np.abs(press.felt_mm[:, :, 2].sum(axis=1))
    v = np.abs(press.force_N[:, :, 2].sum(axis=1))
    most = max(1, min(len(u) // 4, MOST_LAG))
    pairs = {
        k: (u[max(0, -k) : len(u) - max(0, k)], v[max(0, k) : len(v) - max(0, -k)])
        for k in range(-most, most + 1)
    }
    return max(pairs, key=lambda k: correlation(*pairs[k]))
