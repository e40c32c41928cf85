"""Ways to spoil a sound fruit, as people and machines do: units, orders, losses, frames of reference."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from field_fruit import Fruit

from recon.pit.placement import place_pit
from recon.pit.priors import load_prior
from tactile.io.recording import GelPad, Recording

Change = Callable[[Fruit, Fruit, np.random.Generator], Fruit]


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


def picture_scale(times: float, *, sensor: str | None = None) -> Change:
    """Lengths in the gel's plane times a factor, and the forces of each marker's area times its square.

    `sensor`: the name of the sensor in place of the recordings' own.
    """
    plane = np.array([times, times, 1.0])
    scaled = pads(
        lambda pad, rng: replace(
            pad,
            rest_mm=pad.rest_mm * plane,
            displacement_mm=pad.displacement_mm * plane,
            force_N=pad.force_N * times**2,
        )
    )
    renamed = each(lambda one, rng: one if sensor is None else replace(one, sensor=sensor))
    return lambda fruit, other, rng: renamed(scaled(fruit, other, rng), other, rng)


def both(first: Change, second: Change) -> Change:
    """One change after the other."""
    return lambda fruit, other, rng: second(first(fruit, other, rng), other, rng)


def stated(**settings: str | float) -> Change:
    """Another category or Poisson's ratio in the batch's settings."""
    return lambda fruit, other, rng: replace(fruit, **settings)


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


def from_contact(one: Recording) -> np.ndarray:
    """Frames from the loading on: the first touch is gone."""
    total = _total(one)
    return np.arange(int(np.argmax(total > 0.3 * total.max())), len(total))


def until_peak(one: Recording) -> np.ndarray:
    """Frames up to the greatest force."""
    return np.arange(int(np.argmax(_total(one))) + 1)


def some(n: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """Some of n, by chance."""
    return np.asarray(rng.random(n) < share)


def dead(share: float, way: str, fields: str = "both") -> Change:
    """Markers that are zero throughout, zero or frozen from the middle on; in displacement, force or both."""

    def change(pad: GelPad, rng: np.random.Generator) -> GelPad:
        who = some(len(pad.rest_mm), share, rng)

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


def hole(pad: GelPad, rng: np.random.Generator) -> np.ndarray:
    """Markers within 2.6 mm of the most pressed."""
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


def transposed(pose_: np.ndarray) -> np.ndarray:
    """Rotations the other way round."""
    out = pose_.copy()
    out[:, :3, :3] = np.swapaxes(pose_[:, :3, :3], 1, 2)
    return out


def scaled_place(times: float) -> Callable[[np.ndarray], np.ndarray]:
    """Places in another unit."""

    def change(pose_: np.ndarray) -> np.ndarray:
        out = pose_.copy()
        out[:, :3, 3] *= times
        return out

    return change


def standing_still(pose_: np.ndarray) -> np.ndarray:
    """The first pose in every frame."""
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


def in_order(values: np.ndarray, order: Sequence[int]) -> np.ndarray:
    """Components in another order."""
    return np.asarray(values[..., list(order)])


def _sized(pad: GelPad, n: int) -> GelPad:
    return replace(pad, pose=pad.pose[:n], force_N=pad.force_N[:n], displacement_mm=pad.displacement_mm[:n])


def other_recording(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Another fruit's recordings under this one's name."""
    return replace(fruit, recordings=tuple(replace(one, fruit_id=fruit.name) for one in other.recordings))


def other_poses(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Poses of another day."""
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


def about_the_middle(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
    """A change of vertices about the middle of their box."""

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

    vertices, faces = place_pit(fruit.vertices, fruit.faces, load_prior(fruit.category))
    return np.asarray(vertices), np.asarray(faces)
