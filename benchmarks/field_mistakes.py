"""Mistakes as they happen in the field, made on sound recordings: is each named, and what does it do to E?

    python benchmarks/field_mistakes.py FOLDER [...] [--half even|odd] [--sound] [--grade CACHE] [--csv OUT]

A FOLDER holds fruit.ply, perhaps pit.ply, grasp-*.h5 and truth.json (E_MPa, category), or such folders; a
mismatch case is one too, whose answers.json beside it holds the truth. Seeds are the folders' numbers: `even`
ones were worked with, `odd` ones scored once. `--sound` prints what the checks say of unchanged recordings.
Without `--grade` only the checks run (seconds); with it every changed fruit goes through the pipeline.
"""

import argparse
import csv
import json
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pipeline.batch import open_batch
from pipeline.layout import Results
from pipeline.records import FruitRecord, read_record, write_record
from pipeline.stages import grade_fruit
from pipeline.task import fruit_task
from recon.mesh_file import read_mesh, write_mesh
from tactile.checks.of_recording import recording_findings
from tactile.failure import TactileFailure
from tactile.recording import GelPad, Recording, read_recording, write_recording


@dataclass(frozen=True, kw_only=True)
class Fruit:
    """One fruit as its folder has it, and what is true of it."""

    name: str
    number: int
    category: str
    E_MPa: float
    vertices: np.ndarray
    faces: np.ndarray
    pit: tuple[np.ndarray, np.ndarray] | None
    recordings: tuple[Recording, ...]


Change = Callable[[Fruit, Fruit, np.random.Generator], Fruit]


@dataclass(frozen=True, kw_only=True)
class Mistake:
    """`words`: a sentence that holds one of these names the cause. `harmless`: E does not depend on it."""

    name: str
    change: Change
    words: tuple[str, ...]
    harmless: bool = False


# --- ways to change a recording ---------------------------------------------------------------------------


def each(change: Callable[[Recording, np.random.Generator], Recording]) -> Change:
    """Every recording of the fruit."""
    return lambda fruit, other, rng: replace(
        fruit, recordings=tuple(change(one, rng) for one in fruit.recordings)
    )


def pads(change: Callable[[GelPad, np.random.Generator], GelPad], *, only: int | None = None) -> Change:
    """Every pad, or the `only` one, of every recording."""

    def all_pads(one: Recording, rng: np.random.Generator) -> Recording:
        return replace(
            one,
            pads=tuple(
                change(pad, rng) if only in (None, k) and isinstance(pad, GelPad) else pad
                for k, pad in enumerate(one.pads)
            ),
        )

    return each(all_pads)


def force(times: float | np.ndarray, *, only: int | None = None) -> Change:
    """Forces times a factor."""
    return pads(lambda pad, rng: replace(pad, force_N=pad.force_N * times), only=only)


def shift(times: float | np.ndarray, *, only: int | None = None) -> Change:
    """Displacements times a factor."""
    return pads(lambda pad, rng: replace(pad, displacement_mm=pad.displacement_mm * times), only=only)


def gel(kn: float, kt: float | None = None) -> Change:
    """Stated stiffness times a factor."""
    return pads(
        lambda pad, rng: replace(
            pad,
            gel_kn_MPa_per_mm=pad.gel_kn_MPa_per_mm * kn,
            gel_kt_MPa_per_mm=pad.gel_kt_MPa_per_mm * (kn if kt is None else kt),
        )
    )


def frames(order: Callable[[int, np.random.Generator], np.ndarray], *, log: bool) -> Change:
    """Gel frames in another order; with `log` the jaws' log and poses too."""

    def change(one: Recording, rng: np.random.Generator) -> Recording:
        k = order(len(one.time_s), rng)
        gels = tuple(
            replace(
                pad,
                displacement_mm=pad.displacement_mm[k],
                force_N=pad.force_N[k],
                pose=pad.pose[k] if log else pad.pose,
            )
            for pad in one.pads
            if isinstance(pad, GelPad)
        )
        return replace(one, pads=gels, aperture_mm=one.aperture_mm[k] if log else one.aperture_mm)

    return each(change)


def late(field: str, count: int) -> Change:
    """A field's frames come `count` later."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        def moved(values: np.ndarray) -> np.ndarray:
            return values[np.clip(np.arange(len(values)) - count, 0, len(values) - 1)]

        if field == "both":
            return replace(pad, force_N=moved(pad.force_N), displacement_mm=moved(pad.displacement_mm))
        if field == "force":
            return replace(pad, force_N=moved(pad.force_N))
        return replace(pad, displacement_mm=moved(pad.displacement_mm))

    return pads(change)


def cut(keep: Callable[[Recording], np.ndarray]) -> Change:
    """Only some frames are there."""

    def change(one: Recording, rng: np.random.Generator) -> Recording:
        k = keep(one)
        gels = tuple(
            replace(pad, displacement_mm=pad.displacement_mm[k], force_N=pad.force_N[k], pose=pad.pose[k])
            for pad in one.pads
            if isinstance(pad, GelPad)
        )
        return replace(one, time_s=one.time_s[k], aperture_mm=one.aperture_mm[k], pads=gels)

    return each(change)


def _total(one: Recording) -> np.ndarray:
    pad = one.pads[0]
    assert isinstance(pad, GelPad)
    return np.asarray(pad.force_N[:, :, 2].sum(axis=1))


def _from_contact(one: Recording) -> np.ndarray:
    total = _total(one)
    return np.arange(int(np.argmax(total > 0.3 * total.max())), len(total))


def _until_peak(one: Recording) -> np.ndarray:
    return np.arange(int(np.argmax(_total(one))) + 1)


def _some(n: int, share: float, rng: np.random.Generator) -> np.ndarray:
    return np.asarray(rng.random(n) < share)


def dead(share: float, way: str, fields: str = "both") -> Change:
    """Markers that are zero throughout, zero or frozen from the middle on; in displacement, force or both."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        who = _some(len(pad.rest_mm), share, rng)

        def spoilt(values: np.ndarray) -> np.ndarray:
            out = values.copy()
            middle = len(out) // 2
            if way == "zero":
                out[:, who] = 0.0
            elif way == "zero-late":
                out[middle:, who] = 0.0
            else:
                out[middle:, who] = out[middle, who]
            return out

        return replace(
            pad,
            force_N=spoilt(pad.force_N) if fields != "displacement" else pad.force_N,
            displacement_mm=spoilt(pad.displacement_mm) if fields != "force" else pad.displacement_mm,
        )

    return pads(change)


def without_markers(choose: Callable[[GelPad, np.random.Generator], np.ndarray]) -> Change:
    """Markers missing from all arrays; `choose` says which go."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        k = ~choose(pad, rng)
        return replace(
            pad,
            rest_mm=pad.rest_mm[k],
            force_N=pad.force_N[:, k],
            displacement_mm=pad.displacement_mm[:, k],
        )

    return pads(change)


def _hole(pad: GelPad, rng: np.random.Generator) -> np.ndarray:
    peak = int(np.argmax(pad.force_N[:, :, 2].sum(axis=1)))
    middle = pad.rest_mm[int(np.argmax(pad.force_N[peak, :, 2]))]
    return np.asarray(np.linalg.norm(pad.rest_mm - middle, axis=1) < 2.6)


def permuted(field: str) -> Change:
    """A field's markers in chance order."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        k = rng.permutation(len(pad.rest_mm))
        if field == "rest":
            return replace(pad, rest_mm=pad.rest_mm[k])
        if field == "force":
            return replace(pad, force_N=pad.force_N[:, k])
        return replace(pad, displacement_mm=pad.displacement_mm[:, k])

    return pads(change)


def clipped(field: str, share: float) -> Change:
    """Normal values cannot exceed a share of their peak."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        if field == "force":
            top = share * pad.force_N[:, :, 2].max()
            out = pad.force_N.copy()
            out[:, :, 2] = np.minimum(out[:, :, 2], top)
            return replace(pad, force_N=out)
        top = share * pad.displacement_mm[:, :, 2].min()
        out = pad.displacement_mm.copy()
        out[:, :, 2] = np.maximum(out[:, :, 2], top)
        return replace(pad, displacement_mm=out)

    return pads(change)


def noisy(times: float) -> Change:
    """More noise of the kind that quiet frames show."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        def more(values: np.ndarray) -> np.ndarray:
            sd = float(values[:6].std(axis=0).mean())
            return np.asarray(values + times * sd * rng.normal(size=values.shape))

        return replace(pad, force_N=more(pad.force_N), displacement_mm=more(pad.displacement_mm))

    return pads(change)


def offset(newton: float) -> Change:
    """A constant normal force at every marker, as without a tare (share of the peak)."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        out = pad.force_N.copy()
        out[:, :, 2] += newton * out[:, :, 2].max()
        return replace(pad, force_N=out)

    return pads(change)


def rounded(levels: int) -> Change:
    """Forces in so many steps up to the peak."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        step = pad.force_N[:, :, 2].max() / levels
        return replace(pad, force_N=np.round(pad.force_N / step) * step)

    return pads(change)


def zero_frames(count: int) -> Change:
    """Frames lost in the contact and filled with zeros."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        total = pad.force_N[:, :, 2].sum(axis=1)
        loaded = np.flatnonzero(total > 0.4 * total.max())
        k = loaded[len(loaded) // 2 : len(loaded) // 2 + count]
        force, moved = pad.force_N.copy(), pad.displacement_mm.copy()
        force[k], moved[k] = 0.0, 0.0
        return replace(pad, force_N=force, displacement_mm=moved)

    return pads(change)


def pose(change: Callable[[np.ndarray], np.ndarray], *, only: int | None = None) -> Change:
    """Poses changed."""
    return pads(lambda pad, rng: replace(pad, pose=change(pad.pose)), only=only)


def _rotated(pose_: np.ndarray) -> np.ndarray:
    out = pose_.copy()
    out[:, :3, :3] = np.swapaxes(pose_[:, :3, :3], 1, 2)
    return out


def _scaled_place(times: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(pose_: np.ndarray) -> np.ndarray:
        out = pose_.copy()
        out[:, :3, 3] *= times
        return out

    return change


def _still(pose_: np.ndarray) -> np.ndarray:
    return np.broadcast_to(pose_[0], pose_.shape).copy()


def exchanged(what: str) -> Change:
    """Left and right pads' gel signals, or their poses, exchanged."""

    def change(one: Recording, rng: np.random.Generator) -> Recording:
        a, b = one.pads
        assert isinstance(a, GelPad)
        assert isinstance(b, GelPad)
        if what == "poses":
            return replace(one, pads=(replace(a, pose=b.pose), replace(b, pose=a.pose)))
        fields = ("rest_mm", "displacement_mm", "force_N")
        return replace(
            one,
            pads=(
                replace(a, **{f: getattr(b, f) for f in fields}),
                replace(b, **{f: getattr(a, f) for f in fields}),
            ),
        )

    return each(change)


def _axes(values: np.ndarray, order: Sequence[int]) -> np.ndarray:
    return np.asarray(values[..., list(order)])


def _sized(pad: GelPad, n: int) -> GelPad:
    return replace(pad, pose=pad.pose[:n], force_N=pad.force_N[:n], displacement_mm=pad.displacement_mm[:n])


def other_recording(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Another fruit's recordings under this one's name."""
    return replace(fruit, recordings=tuple(replace(one, fruit_id=fruit.name) for one in other.recordings))


def other_poses(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Poses of another session."""
    changed = []
    for mine, theirs in zip(fruit.recordings, other.recordings, strict=False):
        n = min(len(mine.time_s), len(theirs.time_s))
        gels = tuple(
            replace(_sized(a, n), pose=b.pose[:n])
            for a, b in zip(mine.pads, theirs.pads, strict=True)
            if isinstance(a, GelPad) and isinstance(b, GelPad)
        )
        changed.append(replace(mine, time_s=mine.time_s[:n], aperture_mm=mine.aperture_mm[:n], pads=gels))
    return replace(fruit, recordings=tuple(changed))


def mesh(change: Callable[[np.ndarray], np.ndarray], *, turn_faces: bool = False) -> Change:
    """The mesh's vertices changed; the pit stays."""
    return lambda fruit, other, rng: replace(
        fruit,
        vertices=change(fruit.vertices),
        faces=fruit.faces[:, ::-1].copy() if turn_faces else fruit.faces,
    )


def _about(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    def about(vertices: np.ndarray) -> np.ndarray:
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        return np.asarray(centre + change(vertices - centre))

    return about


def other_mesh(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Another fruit's mesh, about the same centre."""
    centre = [(v.min(axis=0) + v.max(axis=0)) / 2 for v in (fruit.vertices, other.vertices)]
    return replace(fruit, vertices=other.vertices - centre[1] + centre[0], faces=other.faces)


def pit(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """The given pit changed; a fruit without one gets its category's first."""

    def changed(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
        found = fruit.pit or _category_pit(fruit)
        return replace(fruit, pit=(change(found[0]), found[1]))

    return changed


def _category_pit(fruit: Fruit) -> tuple[np.ndarray, np.ndarray]:
    from recon.pit import place_pit
    from recon.priors import load_prior

    vertices, faces = place_pit(fruit.vertices, fruit.faces, load_prior(fruit.category))
    return np.asarray(vertices), np.asarray(faces)


TURN_90 = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
TILT_90 = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRROR = np.diag([-1.0, 1, 1])

MISTAKES: tuple[Mistake, ...] = (
    Mistake(name="force in grams", change=force(101.97), words=("grams",)),
    Mistake(name="force in kN", change=force(1e-3), words=("kilonewtons",)),
    Mistake(name="force in mN", change=force(1e3), words=("millinewtons",)),
    Mistake(name="force in pounds", change=force(0.22481), words=("pounds",)),
    Mistake(name="force x 1.3", change=force(1.3), words=("forces are", "gain")),
    Mistake(name="force sign", change=force(-1.0), words=("sign",)),
    Mistake(name="one pad's force in grams", change=force(101.97, only=0), words=("grams",)),
    Mistake(name="one pad's force x 0.5", change=force(0.5, only=1), words=("forces are", "gain")),
    Mistake(
        name="force x and z exchanged",
        change=pads(lambda p, r: replace(p, force_N=_axes(p.force_N, (2, 1, 0)))),
        words=("axes",),
    ),
    Mistake(name="force 5 frames late", change=late("force", 5), words=("late", "early")),
    Mistake(name="force 2 frames early", change=late("force", -2), words=("late", "early")),
    Mistake(name="force clipped at half", change=clipped("force", 0.5), words=("clipped",)),
    Mistake(name="force clipped at 80 %", change=clipped("force", 0.8), words=("clipped",)),
    Mistake(name="force offset, no tare", change=offset(0.3), words=("offset", "tare"), harmless=True),
    Mistake(name="force in 6 steps", change=rounded(6), words=("quantised",)),
    Mistake(name="displacement in metres", change=shift(1e-3), words=("metres",)),
    Mistake(name="displacement in micrometres", change=shift(1e3), words=("micrometres",)),
    Mistake(name="displacement sign", change=shift(-1.0), words=("sign",)),
    Mistake(name="displacement x 0.5", change=shift(0.5), words=("scale of the displacement", "scaled")),
    Mistake(
        name="displacement x and z exchanged",
        change=pads(lambda p, r: replace(p, displacement_mm=_axes(p.displacement_mm, (2, 1, 0)))),
        words=("axes",),
    ),
    Mistake(
        name="displacement as increments",
        change=pads(
            lambda p, r: replace(
                p, displacement_mm=np.diff(p.displacement_mm, axis=0, prepend=p.displacement_mm[:1])
            )
        ),
        words=("increments",),
    ),
    Mistake(name="one pad's displacement dead", change=shift(0.0, only=0), words=("dead", "zero")),
    Mistake(name="displacement clipped at half", change=clipped("displacement", 0.5), words=("clipped",)),
    Mistake(name="displacement's markers permuted", change=permuted("displacement"), words=("permuted",)),
    Mistake(name="force's markers permuted", change=permuted("force"), words=("permuted",)),
    Mistake(name="rest places permuted", change=permuted("rest"), words=("permuted",)),
    Mistake(
        name="rest places in metres",
        change=pads(lambda p, r: replace(p, rest_mm=p.rest_mm * 1e-3)),
        words=("rest_mm",),
    ),
    Mistake(
        name="30 % of markers missing",
        change=without_markers(lambda p, r: _some(len(p.rest_mm), 0.3, r)),
        words=("holes", "missing"),
    ),
    Mistake(name="a hole in the markers", change=without_markers(_hole), words=("holes", "missing")),
    Mistake(
        name="half of the markers missing",
        change=without_markers(lambda p, r: p.rest_mm[:, 0] > 0.2),
        words=("missing",),
    ),
    Mistake(name="30 % zero throughout", change=dead(0.3, "zero"), words=("dead", "zero")),
    Mistake(name="30 % zero from the middle", change=dead(0.3, "zero-late"), words=("dead", "zero")),
    Mistake(name="30 % frozen from the middle", change=dead(0.3, "frozen"), words=("frozen", "dead")),
    Mistake(name="10 % frozen in force", change=dead(0.1, "frozen", "force"), words=("frozen", "dead")),
    Mistake(name="noise x 10", change=noisy(10.0), words=("noise",), harmless=True),
    Mistake(name="one frame of zeros", change=zero_frames(1), words=("zero",)),
    Mistake(name="three frames of zeros", change=zero_frames(3), words=("zero",)),
    Mistake(
        name="gel frames shuffled",
        change=frames(lambda n, r: r.permutation(n), log=False),
        words=("shuffled",),
    ),
    Mistake(
        name="all frames shuffled",
        change=frames(lambda n, r: r.permutation(n), log=True),
        words=("shuffled",),
    ),
    Mistake(
        name="every second frame a copy",
        change=frames(lambda n, r: np.arange(n) // 2 * 2, log=False),
        words=("duplicated",),
        harmless=True,
    ),
    Mistake(
        name="every third frame dropped",
        change=cut(lambda one: np.flatnonzero(np.arange(len(one.time_s)) % 3 != 2)),
        words=("dropped",),
        harmless=True,
    ),
    Mistake(name="no first touch", change=cut(_from_contact), words=("starts in contact",)),
    Mistake(name="no unloading", change=cut(_until_peak), words=("unload",), harmless=True),
    Mistake(name="gel 5 frames late on jaws", change=late("both", 5), words=("late", "lag")),
    Mistake(name="time in ms", change=each(lambda o, r: replace(o, time_s=o.time_s * 1e3)),
            words=("milliseconds",), harmless=True),
    Mistake(name="aperture in cm", change=each(lambda o, r: replace(o, aperture_mm=o.aperture_mm / 10)),
            words=("centimetres",), harmless=True),
    Mistake(name="stiffness in kPa/mm", change=gel(1e3), words=("kPa",), harmless=True),
    Mistake(name="stiffness of another gel", change=gel(2.2), words=("another gel",), harmless=True),
    Mistake(name="poses in metres", change=pose(_scaled_place(1e-3)), words=("metres", "units (mm)")),
    Mistake(name="rotations transposed", change=pose(_rotated), words=("transposed",)),
    Mistake(name="poses of one instant", change=pose(_still), words=("stand still", "one instant")),
    Mistake(name="poses of another session", change=other_poses,
            words=("another session", "another recording", "another fruit", "poses are wrong")),
    Mistake(name="pads' signals exchanged", change=exchanged("signals"),
            words=("other pad", "exchanged"), harmless=True),
    Mistake(name="pads' poses exchanged", change=exchanged("poses"), words=("exchanged", "other pad")),
    Mistake(name="another fruit's recording", change=other_recording, words=("another fruit",)),
    Mistake(name="another fruit's mesh", change=other_mesh, words=("another fruit",)),
    Mistake(name="mesh turned by 90 degrees", change=mesh(_about(lambda v: v @ TURN_90)), words=("turned",)),
    Mistake(name="mesh lying on its side", change=mesh(_about(lambda v: v @ TILT_90)), words=("turned",)),
    Mistake(name="mesh mirrored", change=mesh(_about(lambda v: v @ MIRROR), turn_faces=True),
            words=("mirrored", "turned"), harmless=True),
    Mistake(name="mesh x 1.1", change=mesh(_about(lambda v: 1.1 * v)), words=("scaled", "another fruit")),
    Mistake(name="mesh x 0.95", change=mesh(_about(lambda v: 0.95 * v)), words=("scaled", "another fruit")),
    Mistake(name="pit moved 10 mm", change=pit(lambda v: v + np.array([7.0, 0.0, -7.0])), words=("pit",)),
    Mistake(name="pit moved 6 mm", change=pit(lambda v: v + np.array([6.0, 0.0, 0.0])), words=("pit",)),
    Mistake(name="pit x 1.4", change=pit(_about(lambda v: 1.4 * v)), words=("pit",)),
    Mistake(name="pit x 0.6", change=pit(_about(lambda v: 0.6 * v)), words=("pit",)),
    Mistake(name="pit turned by 90 degrees", change=pit(_about(lambda v: v @ TURN_90)), words=("pit",)),
)  # fmt: skip


# --- fruit --------------------------------------------------------------------------------------------------


def fruit_of(folder: Path) -> Fruit | None:
    """The fruit in a folder; None where none is."""
    if not (folder / "fruit.ply").is_file():
        return None
    own, beside = folder / "truth.json", folder.parent / "answers.json"
    if own.is_file():
        truth = json.loads(own.read_text())
    elif beside.is_file():
        truth = json.loads(beside.read_text()).get(folder.name)
    else:
        truth = None
    if truth is None:
        return None
    number = re.findall(r"\d+", folder.name)
    pit_file = folder / "pit.ply"
    category = str(truth["category"])
    return Fruit(
        name=str(truth.get("fruit_id", folder.name)),
        number=int(number[-1]) if number else 0,
        category={"pdms_ball": "phantom"}.get(category, category),
        E_MPa=float(truth["E_MPa"]),
        vertices=read_mesh(folder / "fruit.ply")[0],
        faces=read_mesh(folder / "fruit.ply")[1],
        pit=read_mesh(pit_file) if pit_file.is_file() else None,
        recordings=tuple(read_recording(path) for path in sorted(folder.glob("grasp-*.h5"))),
    )


def fruits_in(paths: Sequence[Path], half: str) -> list[Fruit]:
    """All fruit below the paths, of one half of the numbers."""
    folders = [
        f for path in paths for f in ([path] if (path / "fruit.ply").is_file() else sorted(path.iterdir()))
    ]
    found = [fruit for folder in folders if folder.is_dir() and (fruit := fruit_of(folder)) is not None]
    wanted = {"even": (0,), "odd": (1,), "all": (0, 1)}[half]
    return [fruit for fruit in found if fruit.number % 2 in wanted]


def partner(fruits: Sequence[Fruit], k: int) -> Fruit:
    """The next fruit of the same category, else the next."""
    rest = [*fruits[k + 1 :], *fruits[:k]]
    same = [one for one in rest if one.category == fruits[k].category]
    return (same or rest or [fruits[k]])[0]


# --- what is said -------------------------------------------------------------------------------------------

RANGE_MPA = {"nectarine": (0.005, 20.0), "plum": (0.005, 12.0), "phantom": (0.0005, 60.0)}


def checked(fruit: Fruit) -> list[tuple[str, bool, float]]:
    """(sentence, refused, relative sd) of every recording by the checks alone."""
    said: list[tuple[str, bool, float]] = []
    for one in fruit.recordings:
        try:
            found = recording_findings(
                one, fruit.vertices, fruit.faces, E_range_MPa=RANGE_MPA.get(fruit.category)
            )
            said += [(f.sentence, f.refused, f.relative_sd) for f in found]
        except TactileFailure as failure:
            said.append((failure.detail, True, 0.0))
    return said


SETTINGS = """\
category = "{category}"
poisson_ratio = 0.45
[mesh]
edge_mm = 8.0
pad_edge_mm = 3.0
"""
PHANTOM = """\
[pit]
offset_sd_mm = 0.3
size_sd = 0.02
"""


def graded(fruit: Fruit, folder: Path) -> FruitRecord:
    """The fruit's record by the pipeline, as a batch of its own in `folder`; kept there."""
    kept = folder / "record.json"
    if kept.is_file() and (record := read_record(kept)) is not None:
        return record
    where = folder / "batch" / "fruits" / "F"
    (where / "grasps").mkdir(parents=True, exist_ok=True)
    settings = SETTINGS.format(category=fruit.category) + (PHANTOM if fruit.category == "phantom" else "")
    (folder / "batch" / "batch.toml").write_text(settings, encoding="utf-8")
    (folder / "batch" / "fruits.csv").write_text("fruit_id\nF\n", encoding="utf-8")
    write_mesh(where / "fruit.ply", fruit.vertices, fruit.faces)
    if fruit.pit is not None:
        write_mesh(where / "pit.ply", *fruit.pit)
    for k, one in enumerate(fruit.recordings):
        write_recording(where / "grasps" / f"grasp-{k + 1}.h5", replace(one, fruit_id="F"))
    task = fruit_task(open_batch(folder / "batch"), "F", Results(folder / "out"))
    record = grade_fruit(task, lambda stage: None)
    write_record(kept, record)
    return record


def named(said: Sequence[str], words: Sequence[str]) -> bool:
    """Whether the first sentence holds a word that names the cause."""
    return bool(said) and any(word in said[0] for word in words)


def judged(fruit: Fruit, changed: Fruit, mistake: Mistake, cache: Path | None) -> dict[str, object]:
    """One row: what is said of the mistake, and with `cache` what E becomes."""
    row: dict[str, object] = {
        "mistake": mistake.name,
        "fruit": fruit.name,
        "category": fruit.category,
        "harmless": mistake.harmless,
    }
    if cache is None:
        said = checked(changed)
        refused = any(r for _, r, _ in said)
        sentences = [s for s, _, _ in said]
        return row | {
            "refused": refused,
            "named": named(sentences, mistake.words),
            "said": sentences[0] if said else "",
        }
    slug = re.sub(r"[^a-z0-9]+", "-", mistake.name.lower())
    record = graded(changed, cache / slug / fruit.name)
    E, sd = (None, None) if record.modulus is None else (record.modulus.E_MPa, record.modulus.E_sd_MPa)
    sentences = list(record.doubts or record.warnings) if record.graded else [record.reason]
    return row | {
        "refused": not record.graded,
        "named": named(sentences, mistake.words),
        "doubted": bool(record.doubts),
        "ratio": None if E is None or not record.graded else E / fruit.E_MPa,
        "sd": None if E is None or sd is None else sd / E,
        "sds": None if E is None or sd is None or not record.graded else abs(E - fruit.E_MPa) / sd,
        "said": sentences[0] if sentences else "",
    }


def in_a_line(name: str, rows: Sequence[dict[str, object]]) -> str:
    """One mistake's row of the table."""

    def share(key: str) -> float:
        return float(np.mean([bool(row.get(key)) for row in rows]))

    def middle(key: str) -> str:
        values = [float(str(row[key])) for row in rows if row.get(key) is not None]
        return f"{np.median(values):6.3f}" if values else "     -"

    wrong = [row for row in rows if not row["refused"] and not row["named"] and _far(row)]
    return (
        f"{name:32s} {len(rows):3d}  named {share('named'):4.0%}  refused {share('refused'):4.0%}  "
        f"E/true {middle('ratio')}  sd {middle('sd')}  |error|/sd {middle('sds')}  "
        f"wrong and not named {len(wrong)}"
    )


def _far(row: dict[str, object]) -> bool:
    """E off by more than 5 % and 3 of its standard deviations."""
    ratio, sds = row.get("ratio"), row.get("sds")
    return ratio is not None and abs(float(str(ratio)) - 1) > 0.05 and float(str(sds)) > 3


SOUND = Mistake(name="none", change=lambda fruit, other, rng: fruit, words=())


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--half", choices=("even", "odd", "all"), default="all")
    parser.add_argument("--sound", action="store_true")
    parser.add_argument("--grade", type=Path)
    parser.add_argument("--csv", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--grasps", type=int, default=2)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    fruits = [
        replace(one, recordings=one.recordings[: options.grasps])
        for one in fruits_in(options.folders, options.half)
    ]
    if options.sound:
        sound(fruits)
        return
    rows: list[dict[str, object]] = []
    for mistake in (SOUND, *MISTAKES):
        if options.only not in mistake.name:
            continue
        own = []
        for k, fruit in enumerate(fruits):
            rng = np.random.default_rng([11, fruit.number])
            changed = mistake.change(fruit, partner(fruits, k), rng)
            own.append(judged(fruit, changed, mistake, options.grade))
            if options.verbose and mistake.words and not own[-1]["named"]:
                sys.stdout.write(f"  {mistake.name} | {fruit.name} | {str(own[-1]['said'])[:200]}\n")
        sys.stdout.write(in_a_line(mistake.name, own) + "\n")
        sys.stdout.flush()
        rows += own
    if options.csv:
        with options.csv.open("w", newline="", encoding="utf-8") as file:
            table = csv.DictWriter(file, fieldnames=list(rows[0]))
            table.writeheader()
            table.writerows(rows)


def sound(fruits: Sequence[Fruit]) -> None:
    """What the checks say of unchanged recordings."""
    count = wrong = 0
    for fruit in fruits:
        for one in fruit.recordings:
            found = recording_findings(
                one, fruit.vertices, fruit.faces, E_range_MPa=RANGE_MPA.get(fruit.category)
            )
            count += 1
            wrong += bool(found)
            for f in found:
                sys.stdout.write(f"{fruit.name} ({'refused' if f.refused else 'said'}): {f.sentence}\n")
    sys.stdout.write(f"{count} recordings of {len(fruits)} fruit, {wrong} with a sentence\n")


if __name__ == "__main__":
    main()
