"""Ways to spoil a sound fruit, as people and machines do: units, orders, losses, frames of reference."""

from collections.abc import Callable
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


FIELDS = {
    "force": ("force_N",),
    "displacement": ("displacement_mm",),
    "both": ("force_N", "displacement_mm"),
    "rest": ("rest_mm",),
    "markers": ("rest_mm", "force_N", "displacement_mm"),
    "stiffness": ("gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm"),
    "stiffness and force": ("gel_kn_MPa_per_mm", "gel_kt_MPa_per_mm", "force_N"),
    "pose": ("pose",),
}
"""Arrays of a pad by the name of the field."""
Values = Callable[[np.ndarray], np.ndarray]


def changed(
    field: str, make: Callable[[GelPad, np.random.Generator], Values], *, only: int | None = None
) -> Change:
    """A field of every pad, by the function that `make` gives for the pad."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> GelPad:
        change = make(pad, rng)
        return replace(pad, **{name: change(getattr(pad, name)) for name in FIELDS[field]})

    return pads(of_pad, only=only)


def always(field: str, change: Values, *, only: int | None = None) -> Change:
    """A field of every pad by one function."""
    return changed(field, lambda pad, rng: change, only=only)


def scaled(field: str, times: float, *, only: int | None = None) -> Change:
    """A field times a factor."""
    return always(field, lambda values: values * times, only=only)


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


def stated(**settings: str | float) -> Change:
    """Another category or Poisson's ratio in the batch's settings."""
    return lambda fruit, other, rng: replace(fruit, **settings)


def _with_frames(
    recording: Recording, k: np.ndarray | slice, *, log: bool = True, time: bool = True
) -> Recording:
    """These frames of the gels; with `log` of the jaws' log and poses too, with `time` of the clock."""
    fields = (*FIELDS["both"], "pose") if log else FIELDS["both"]
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

    return always(field, moved)


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

    return changed(field, of_pad)


def without_markers(choose: Callable[[GelPad, np.random.Generator], np.ndarray]) -> Change:
    """Markers missing from all arrays; `choose` says which go."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        kept = np.flatnonzero(~choose(pad, rng))
        return lambda values: values.take(kept, axis=-2)

    return changed("markers", of_pad)


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

    return changed(field, of_pad)


def normal(change: Values) -> Values:
    """A change of the components along z alone."""

    def of_normal(values: np.ndarray) -> np.ndarray:
        out = values.copy()
        out[:, :, 2] = change(out[:, :, 2])
        return out

    return of_normal


def clipped(field: str, share: float) -> Change:
    """Normal values cannot exceed a share of their peak: forces press upwards, displacements downwards."""
    sign = 1.0 if field == "force" else -1.0
    limited = normal(lambda z: sign * np.minimum(sign * z, share * (sign * z).max()))
    return always(field, limited)


def noisy(times: float) -> Change:
    """More noise of the kind that quiet frames show."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        def more(values: np.ndarray) -> np.ndarray:
            sd = float(values[:6].std(axis=0).mean())
            return np.asarray(values + times * sd * rng.normal(size=values.shape))

        return more

    return changed("both", of_pad)


def offset(share: float) -> Change:
    """A constant normal force at every marker, as without a tare (share of the peak)."""
    return always("force", normal(lambda z: z + share * z.max()))


def rounded(levels: int) -> Change:
    """Forces in so many steps up to the peak."""

    def stepped(values: np.ndarray) -> np.ndarray:
        step = values[:, :, 2].max() / levels
        return np.round(values / step) * step

    return always("force", stepped)


def zero_frames(count: int) -> Change:
    """Frames lost in the contact and filled with zeros."""

    def of_pad(pad: GelPad, rng: np.random.Generator) -> Values:
        total = pad.force_N[:, :, 2].sum(axis=1)
        loaded = np.flatnonzero(total > 0.4 * total.max())
        first = len(loaded) // 2
        lost = np.isin(np.arange(len(total)), loaded[first : first + count])
        return lambda values: np.where(lost[:, None, None], 0.0, values)

    return changed("both", of_pad)


def transposed(pose: np.ndarray) -> np.ndarray:
    """Rotations the other way round."""
    out = pose.copy()
    out[:, :3, :3] = np.swapaxes(pose[:, :3, :3], 1, 2)
    return out


def in_metres(pose: np.ndarray) -> np.ndarray:
    """Places in metres."""
    out = pose.copy()
    out[:, :3, 3] *= 1e-3
    return out


def standing_still(pose: np.ndarray) -> np.ndarray:
    """The first pose in every frame."""
    return np.broadcast_to(pose[0], pose.shape).copy()


def exchanged(field: str) -> Change:
    """A field of the left and the right pad exchanged."""

    def change(recording: Recording, rng: np.random.Generator) -> Recording:
        pairs = zip(recording.pads, reversed(recording.pads), strict=True)
        gels = (replace(pad, **{name: getattr(twin, name) for name in FIELDS[field]}) for pad, twin in pairs)
        return replace(recording, pads=tuple(gels))

    return each(change)


def axes_exchanged(field: str) -> Change:
    """Components along x and z of a field exchanged."""
    return always(field, lambda values: values[..., [2, 1, 0]])


def other_recording(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Another fruit's recordings under this one's name."""
    return replace(
        fruit, recordings=tuple(replace(recording, fruit_id=fruit.name) for recording in other.recordings)
    )


def other_poses(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Poses of another day."""
    recordings = []
    for mine, theirs in zip(fruit.recordings, other.recordings, strict=False):
        n = min(len(mine.time_s), len(theirs.time_s))
        short = _with_frames(mine, slice(n))
        gels = tuple(replace(a, pose=b.pose[:n]) for a, b in zip(short.pads, theirs.pads, strict=True))
        recordings.append(replace(short, pads=gels))
    return replace(fruit, recordings=tuple(recordings))


def _middle(vertices: np.ndarray) -> np.ndarray:
    return np.asarray((vertices.min(axis=0) + vertices.max(axis=0)) / 2)


def mesh(change: Values, *, turn_faces: bool = False) -> Change:
    """The mesh's vertices changed about the middle of their box; the pit stays."""
    return lambda fruit, other, rng: replace(
        fruit,
        vertices=_middle(fruit.vertices) + change(fruit.vertices - _middle(fruit.vertices)),
        faces=fruit.faces[:, ::-1].copy() if turn_faces else fruit.faces,
    )


def other_mesh(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
    """Another fruit's mesh, about the same centre."""
    shift = _middle(fruit.vertices) - _middle(other.vertices)
    return replace(fruit, vertices=other.vertices + shift, faces=other.faces)


def pit(change: Values) -> Change:
    """The given pit changed about its middle; a fruit without one gets its category's first."""

    def of_fruit(fruit: Fruit, other: Fruit, rng: np.random.Generator) -> Fruit:
        prior = load_prior(fruit.category)
        vertices, faces = fruit.pit or place_pit(fruit.vertices, fruit.faces, prior)
        return replace(fruit, pit=(_middle(vertices) + change(vertices - _middle(vertices)), faces))

    return of_fruit
