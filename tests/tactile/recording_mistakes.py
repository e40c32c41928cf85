"""Mistakes of the field, made on a recording that has none, and what the checks have to say of each."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from injected_grasp import frames_of

from recon.pit.priors import load_prior
from tactile.checks.of_recording import recording_findings
from tactile.gel.force_inverse import InvertedForce
from tactile.gel.grid import INITIAL_HYPERPARAMETERS, gel_grid
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.io.recording import GelPad
from tactile.sensors import bonded_stiffness

SHIPPED = Path(__file__).parents[2] / "samples" / "data" / "nectarines"
RANGE_MPA = load_prior("nectarine").plausible.E_MPa


def findings(recording, mesh):
    return recording_findings(recording, *mesh, E_range_MPa=RANGE_MPA)


def on_pads(change, only=None):
    def changed(recording):
        pads = [change(pad) if only in (None, pad.name) else pad for pad in recording.pads]
        return replace(recording, pads=tuple(pads))

    return changed


def force(times, only=None):
    return on_pads(lambda pad: replace(pad, force_N=pad.force_N * times), only)


def shift(times, only=None):
    return on_pads(lambda pad: replace(pad, displacement_mm=pad.displacement_mm * times), only)


def both(change):
    return on_pads(
        lambda pad: replace(
            pad, force_N=change(pad.force_N.copy()), displacement_mm=change(pad.displacement_mm.copy())
        )
    )


def delayed(values, frames):
    return values[np.clip(np.arange(len(values)) - frames, 0, None)]


def picked(n, share=0.3):
    return np.random.default_rng(5).random(n) < share


def spoilt(start, value):
    def change(values):
        who = picked(values.shape[1])
        values[start:, who] = value if value is not None else values[start, who]
        return values

    return both(change)


def clipped(values):
    out = values.copy()
    out[:, :, 2] = np.minimum(out[:, :, 2], 0.5 * out[:, :, 2].max())
    return out


def without(choose):
    def change(pad):
        k = ~choose(pad)
        return replace(
            pad, rest_mm=pad.rest_mm[k], force_N=pad.force_N[:, k], displacement_mm=pad.displacement_mm[:, k]
        )

    return on_pads(change)


def in_order(log):
    def change(recording):
        k = np.random.default_rng(3).permutation(len(recording.time_s))
        changed = both(lambda values: values[k])(recording)
        if log:
            changed = on_pads(lambda pad: replace(pad, pose=pad.pose[k]))(changed)
            changed = replace(changed, aperture_mm=changed.aperture_mm[k])
        return changed

    return change


def one_zero_frame(values):
    values[30] = 0.0
    return values


def permuted(field):
    order = np.random.default_rng(4).permutation(400)
    if field == "rest_mm":
        return on_pads(lambda pad: replace(pad, rest_mm=pad.rest_mm[order]))
    return on_pads(lambda pad: replace(pad, **{field: getattr(pad, field)[:, order]}))


def poses(change):
    return on_pads(lambda pad: replace(pad, pose=change(pad.pose.copy())))


def in_metres(pose):
    pose[:, :3, 3] *= 1e-3
    return pose


def transposed(pose):
    pose[:, :3, :3] = np.swapaxes(pose[:, :3, :3], 1, 2)
    return pose


def gel(times):
    return on_pads(lambda pad: replace(pad, gel_kn_MPa_per_mm=pad.gel_kn_MPa_per_mm * times))


def drifting(recording):
    time = recording.time_s
    grown = 1.8 * (time - time[0])[:, None] / (time[-1] - time[0]) / 400
    left, right = recording.pads
    force = left.force_N.copy()
    force[:, :, 2] += grown
    return replace(recording, pads=(replace(left, force_N=force), right))


def dropped(recording):
    return kept(np.flatnonzero(np.arange(len(recording.time_s)) % 3 != 2))(recording)


def kept(frames):
    return lambda recording: frames_of(recording, frames)


def noisy(times):
    def change(pad):
        rng = np.random.default_rng(7)
        more = np.sqrt(times**2 - 1)
        return replace(
            pad,
            displacement_mm=pad.displacement_mm + rng.normal(0, 0.004 * more, pad.force_N.shape),
            force_N=pad.force_N + rng.normal(0, 0.005 * more, pad.force_N.shape),
        )

    return on_pads(change)


REFUSED = {
    "grams": (force(101.97), "look like grams"),
    "kilonewtons": (force(1e-3), "look like kilonewtons"),
    "one pad in grams": (force(101.97, "left"), "the left pad's forces look like grams"),
    "one pad halved": (force(0.5, "right"), "the right pad's forces are 0.50 times"),
    "force sign": (force(-1.0), "force has the wrong sign"),
    "force clipped": (on_pads(lambda p: replace(p, force_N=clipped(p.force_N))), "is clipped"),
    "force late": (on_pads(lambda p: replace(p, force_N=delayed(p.force_N, 5))), "5 frames late"),
    "force x and z": (on_pads(lambda p: replace(p, force_N=p.force_N[..., ::-1])), "force has its axes"),
    "force permuted": (permuted("force_N"), "permuted"),
    "metres": (shift(1e-3), "displacement looks like metres"),
    "displacement halved": (shift(0.5), "a scale of the displacement"),
    "displacement sign": (shift(-1.0), "displacement has the wrong sign"),
    "displacement x and z": (
        on_pads(lambda p: replace(p, displacement_mm=p.displacement_mm[..., ::-1])),
        "displacement has its axes",
    ),
    "displacement permuted": (permuted("displacement_mm"), "permuted"),
    "displacement dead": (shift(0.0, "left"), "the left pad's displacement is dead"),
    "increments": (
        on_pads(lambda p: replace(p, displacement_mm=np.diff(p.displacement_mm, axis=0, prepend=0.0))),
        "increments",
    ),
    "rest permuted": (permuted("rest_mm"), "permuted"),
    "markers missing": (without(lambda pad: picked(len(pad.rest_mm))), "grid has holes"),
    "every second marker missing": (
        without(lambda pad: np.arange(len(pad.rest_mm)) % 2 == 1),
        "both pads' markers are only every second one of the gel: about 200 of 400 are missing",
    ),
    "every second marker missing, in turns": (
        without(lambda pad: np.indices((20, 20)).sum(axis=0).ravel() % 2 == 1),
        "both pads' markers are only every second one of the gel: about 200 of 400 are missing",
    ),
    "every third marker kept": (
        without(lambda pad: np.arange(len(pad.rest_mm)) % 3 != 1),
        "both pads' markers are only every third one of the gel",
    ),
    "half of the gel missing": (without(lambda pad: pad.rest_mm[:, 0] > 0.2), "markers are missing"),
    "zero throughout": (spoilt(0, 0.0), "are zero in displacement and force"),
    "zero from the middle": (spoilt(28, 0.0), "are zero in displacement and force"),
    "frozen": (spoilt(24, None), "are frozen in displacement and force"),
    "a frame of zeros": (both(one_zero_frame), "zero at every marker in 1 frames"),
    "gel's frames shuffled": (in_order(log=False), "shuffled"),
    "all frames shuffled": (in_order(log=True), "shuffled"),
    "poses in metres": (poses(in_metres), "poses look like metres"),
    "poses transposed": (poses(transposed), "transposed"),
    "poses of one instant": (poses(lambda pose: np.tile(pose[0], (len(pose), 1, 1))), "poses stand still"),
    "stiffness in kPa": (gel(1e3), "kPa/mm"),
}
SAID = {
    "a gain of 1.2": (force(1.2), "forces are 1.20 times"),
    "a drift": (drifting, "the left pad's force drifts"),
    "aperture in cm": (lambda r: replace(r, aperture_mm=r.aperture_mm / 10), "aperture_mm looks like cent"),
    "every third frame dropped": (dropped, "frames were dropped: "),
    "ten times the noise": (noisy(10.0), "mostly noise"),
    "no first touch": (kept(slice(22, None)), "starts in contact"),
}


def slab_pad():
    """A slab under growing pressure, forces by the inverse of its displacement."""
    slab = GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)
    line = 1.5 * (np.arange(9) - 4.0)
    rest = np.column_stack([np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2), np.zeros(81)])
    fine = np.arange(-5, 5.01, 0.5)
    nodes = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    compliance = -tent_compliance(slab, rest[:, :2], nodes, pitch_mm=0.5)
    rng = np.random.default_rng(0)
    inverse = InvertedForce(
        gel_grid(slab, rest), np.tile(np.eye(3) / 0.004**2, (81, 1, 1)), INITIAL_HYPERPARAMETERS
    )
    kn, kt = bonded_stiffness(0.2, 0.48, 4.0)
    moved, pushed = [], []
    for depth in (*np.zeros(4), *np.linspace(0.2, 1, 4), 0.6, 0.0, 0.0):
        within = 1 - (nodes**2).sum(axis=1) / (20.0 * depth + 1e-9)
        load = np.outer(0.015 * np.sqrt(depth * np.maximum(within, 0.0)), [0.2, 0.0, 1.0])
        seen = np.einsum("nimj,mj->ni", compliance, load) + rng.normal(0, 0.004, rest.shape)
        moved.append(seen)
        pushed.append(inverse.solve(seen).force_N)
    return GelPad(
        name="left",
        pose=np.tile(np.eye(4), (len(moved), 1, 1)),
        rest_mm=rest,
        displacement_mm=np.array(moved),
        force_N=np.array(pushed),
        gel_kn_MPa_per_mm=kn,
        gel_kt_MPa_per_mm=kt,
        thickness_mm=4.0,
        gel_E_MPa=0.2,
        gel_nu=0.48,
    )
