"""Ways to spoil a sound fruit, as people and machines do: units, orders, losses, frames of reference."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from field_fruit import Fruit

from recon.pit.placement import place_pit
from recon.pit.priors import load_prior
from tactile.readers.recording import GelPad, Recording

Change = Callable[[Fruit, Fruit, np.random.Generator], Fruit]


def each(change: Callable[[Recording, np.random.Generator], Recording]) -> Change:
    """Every recording of the fruit."""
    return lambda fruit, other, rng: replace(
        fruit, recordings=tuple(change(recording, rng) for recording in fruit.recordings)
    )


def pads(change: Callable[[GelPad, np.random.Generator], GelPad], *, only: int | None = None) -> Change:
    """Every pad, or the `only` one, of every recording."""

    def all_pads(recording: Recording, rng: np.random.Generator) -> Recording:
        return replace(
            recording,
            pads=tuple(
                change(pad, rng) if only in (None, k) and isinstance(pad, GelPad) else pad
                for k, pad in enumerate(recording.pads)
            ),
        )

    return each(all_pads)


FORCE, DISPLACEMENT = ("force_N",), ("displacement_mm",)
BOTH = (*FORCE, *DISPLACEMENT)
FIELDS = {"force": FORCE, "displacement": DISPLACEMENT, "both": BOTH, "rest": ("rest_mm",)}
"""A pad's arrays, by the word for them."""
Values = Callable[[np.ndarray], np.ndarray]


def arrays(
    make: Callable[[GelPad, np.random.Generator], Values], fields: Sequence[str], *, only: int | None = None
) -> Change:
    """These arrays of every pad, each by the function that `make` gives for the pad."""

    def changed(pad: GelPad, rng: np.random.Generator) -> GelPad:
        change = make(pad, rng)
        return replace(pad, **{name: change(getattr(pad, name)) for name in fields})

    return pads(changed, only=only)


def force(times: float, *, only: int | None = None) -> Change:
    """Forces times a factor."""
    return arrays(lambda pad, rng: lambda values: values * times, FORCE, only=only)


def shift(times: float, *, only: int | None = None) -> Change:
    """Displacements times a factor."""
    return arrays(lambda pad, rng: lambda values: values * times, DISPLACEMENT, only=only)


def gel(times: float) -> Change:
    """Stated stiffness times a factor."""
    return pads(
        lambda pad, rng: replace(
            pad,
            gel_kn_MPa_per_mm=pad.gel_kn_MPa_per_mm * times,
            gel_kt_MPa_per_mm=pad.gel_kt_MPa_per_mm * times,
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
    renamed = each(lambda recording, rng: recording if sensor is None else replace(recording, sensor=sensor))
    return lambda fruit, other, rng: renamed(scaled(fruit, other, rng), other, rng)


def both(first: Change, second: Change) -> Change:
    """One change after the other."""
    return lambda fruit, other, rng: second(first(fruit, other, rng), other, rng)


def stated(**settings: str | float) -> Change:
    """Another category or Poisson's ratio in the batch's settings."""
    return lambda fruit, other, rng: replace(fruit, **settings)


def _with_frames(
    recording: Recording, k: np.ndarray | slice, *, log: bool = True, time: bool = True
) -> Recording:
    """These frames of the gels; with `log` of the jaws' log and poses too, with `time` of the clock."""
    fields = (*BOTH, "pose") if log else BOTH
    gels = tuple(
        replace(pad, **{name: getattr(pad, name)[k] for name in fields})
        for pad in recording.pads
        if isinstance(pad, GelPad)
    )
    aperture_mm = recording.aperture_mm[k] if log else recording.aperture_mm
    return replace(
        recording,
        pads=gels,
        aperture_mm=aperture_mm,
        time_s=recording.time_s[k] if time else recording.time_s,
    )


def frames(order: Callable[[int, np.random.Generator], np.ndarray], *, log: bool) -> Change:
    """Gel frames in another order; with `log` the jaws' log and poses too."""
    return each(
        lambda recording, rng: _with_frames(recording, order(len(recording.time_s), rng), log=log, time=False)
    )


def late(field: str, count: int) -> Change:
    """A field's frames come `count` later."""

    def moved(values: np.ndarray) -> np.ndarray:
        return values[np.clip(np.arange(len(values)) - count, 0, len(values) - 1)]

    return arrays(lambda pad, rng: moved, FIELDS[field])


def cut(keep: Callable[[Recording], np.ndarray]) -> Change:
    """Only some frames are there."""
    return each(lambda recording, rng: _with_frames(recording, keep(recording)))


def _total(recording: Recording) -> np.ndarray:
    pad = recording.pads[0]
    assert isinstance(pad, GelPad)
    return np.asarray(pad.force_N[:, :, 2].sum(axis=1))


def from_contact(recording: Recording) -> np.ndarray:
    """Frames from the loading on: the first touch is gone."""
    total = _total(recording)
    return np.arange(int(np.argmax(total > 0.3 * total.max())), len(total))


def until_peak(recording: Recording) -> np.ndarray:
    """Frames up to the greatest force."""
    return np.arange(int(np.argmax(_total(recording))) + 1)


def some(n: int, share: float, rng: np.random.Generator) -> np.ndarray:
    """Some of n, by chance."""
    return np.asarray(rng.random(n) < share)


def dead(share: float, way: str, field: str = "both") -> Change:
    """Markers that are zero throughout, zero or frozen from the middle on; in displacement, force or both."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        who = some(len(pad.rest_mm), share, rng)

        def spoilt(values: np.ndarray) -> np.ndarray:
            out = values.copy()
            start = 0 if way == "zero" else len(out) // 2
            out[start:, who] = out[start, who] if way == "frozen" else 0.0
            return out

        return spoilt

    return arrays(of_pad, FIELDS[field])


def without_markers(choose: Callable[[GelPad, np.random.Generator], np.ndarray]) -> Change:
    """Markers missing from all arrays; `choose` says which go."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        kept = np.flatnonzero(~choose(pad, rng))
        return lambda values: values.take(kept, axis=-2)

    return arrays(of_pad, ("rest_mm", *BOTH))


def hole(pad: GelPad, rng: np.random.Generator) -> np.ndarray:
    """Markers within 2.6 mm of the most pressed."""
    peak = int(np.argmax(pad.force_N[:, :, 2].sum(axis=1)))
    middle = pad.rest_mm[int(np.argmax(pad.force_N[peak, :, 2]))]
    return np.asarray(np.linalg.norm(pad.rest_mm - middle, axis=1) < 2.6)


def permuted(field: str) -> Change:
    """A field's markers in chance order."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        k = rng.permutation(len(pad.rest_mm))
        return lambda values: values.take(k, axis=-2)

    return arrays(of_pad, FIELDS[field])


def normal(change: Values) -> Values:
    """A change of the components along z alone."""

    def changed(values: np.ndarray) -> np.ndarray:
        out = values.copy()
        out[:, :, 2] = change(out[:, :, 2])
        return out

    return changed


def clipped(field: str, share: float) -> Change:
    """Normal values cannot exceed a share of their peak: forces press upwards, displacements downwards."""
    sign = 1.0 if field == "force" else -1.0
    limited = normal(lambda z: sign * np.minimum(sign * z, share * (sign * z).max()))
    return arrays(lambda pad, rng: limited, FIELDS[field])


def noisy(times: float) -> Change:
    """More noise of the kind that quiet frames show."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        def more(values: np.ndarray) -> np.ndarray:
            sd = float(values[:6].std(axis=0).mean())
            return np.asarray(values + times * sd * rng.normal(size=values.shape))

        return more

    return arrays(of_pad, BOTH)


def offset(share: float) -> Change:
    """A constant normal force at every marker, as without a tare (share of the peak)."""
    return arrays(lambda pad, rng: normal(lambda z: z + share * z.max()), FORCE)


def rounded(levels: int) -> Change:
    """Forces in so many steps up to the peak."""

    def stepped(values: np.ndarray) -> np.ndarray:
        step = values[:, :, 2].max() / levels
        return np.round(values / step) * step

    return arrays(lambda pad, rng: stepped, FORCE)


def zero_frames(count: int) -> Change:
    """Frames lost in the contact and filled with zeros."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        total = pad.force_N[:, :, 2].sum(axis=1)
        loaded = np.flatnonzero(total > 0.4 * total.max())
        first = len(loaded) // 2
        lost = np.isin(np.arange(len(total)), loaded[first : first + count])
        return lambda values: np.where(lost[:, None, None], 0.0, values)

    return arrays(of_pad, BOTH)


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

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        a, b = recording.pads
        assert isinstance(a, GelPad)
        assert isinstance(b, GelPad)
        if what == "poses":
            return replace(recording, pads=(replace(a, pose=b.pose), replace(b, pose=a.pose)))
        fields = ("rest_mm", "displacement_mm", "force_N")
        return replace(
            recording,
            pads=(
                replace(a, **{f: getattr(b, f) for f in fields}),
                replace(b, **{f: getattr(a, f) for f in fields}),
            ),
        )

    return each(change)


def in_order(values: np.ndarray, order: Sequence[int]) -> np.ndarray:
    """Components in another order."""
    return np.asarray(values[..., list(order)])


def other_recording(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Another fruit's recordings under this one's name."""
    return replace(
        fruit, recordings=tuple(replace(recording, fruit_id=fruit.name) for recording in other.recordings)
    )


def other_poses(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Poses of another day."""
    changed = []
    for mine, theirs in zip(fruit.recordings, other.recordings, strict=False):
        n = min(len(mine.time_s), len(theirs.time_s))
        short = _with_frames(mine, slice(n))
        gels = tuple(replace(a, pose=b.pose[:n]) for a, b in zip(short.pads, theirs.pads, strict=True))
        changed.append(replace(short, pads=gels))
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
        given_pit = fruit.pit or _category_pit(fruit)
        return replace(fruit, pit=(change(given_pit[0]), given_pit[1]))

    return changed


def _category_pit(fruit: Fruit) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = place_pit(fruit.vertices, fruit.faces, load_prior(fruit.category))
    return np.asarray(vertices), np.asarray(faces)
