"""Mistakes of the field (benchmarks/field_list.py), made on a sound recording; and a pad by a slab's law."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from field_fruit import Fruit
from field_list import MISTAKES, Mistake, naming
from field_mistakes import checked
from injected_grasp import frames_of, gel_pad, with_pads

from pipeline.fruit.input_doubts import Doubt
from recon.pit.priors import load_prior
from recon.surface.mesh_file import read_mesh
from samples.fruit import fruits_of_seed, scanned_mesh
from tactile.consistency.finding import Finding
from tactile.consistency.of_recording import recording_findings
from tactile.gel.force_inverse import InvertedForce
from tactile.gel.grid import INITIAL_HYPERPARAMETERS, gel_grid
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.readers.recording import read_recording
from tactile.sensors import bonded_stiffness

__all__ = ["MISTAKES", "naming"]
ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "samples" / "data" / "nectarines"
RANGE_MPA = load_prior("nectarine").plausible.E_MPa


def findings(recording, mesh):
    return recording_findings(recording, *mesh, E_range_MPa=RANGE_MPA)


@cache
def fruit_and_other() -> list[Fruit]:
    """The fruit of tests/data/nectarine-grasp, and one of the sample's."""
    data, sample = ROOT / "tests" / "data" / "nectarine-grasp", fruits_of_seed(4, seed=1)[0]
    grasps = (data / "grasp.h5", SHIPPED / "fruits" / sample.fruit_id / "grasps" / "grasp-1.h5")
    meshes = (read_mesh(data / "fruit.ply"), scanned_mesh(sample, cells=28, error_mm=0.1))
    return [
        Fruit(
            name=path.parent.name, number=4, category="nectarine", E_MPa=0.5, vertices=mesh[0], faces=mesh[1],
            pit=None, recordings=(read_recording(path),),
        )
        for path, mesh in zip(grasps, meshes, strict=True)
    ]  # fmt: skip


def said_of(mistake: Mistake) -> list[Doubt | Finding]:
    """What the checks say where the mistake was made."""
    return checked(mistake.change(*fruit_and_other(), np.random.default_rng([11, 4])))


def on_pads(change, only=None):
    return lambda recording: with_pads(recording, change, only)


def force(times, only=None):
    return on_pads(lambda pad: replace(pad, force_N=pad.force_N * times), only)


def picked(n, share=0.3):
    return np.random.default_rng(5).random(n) < share


def without(choose):
    def change(pad):
        k = ~choose(pad)
        return replace(
            pad, rest_mm=pad.rest_mm[k], force_N=pad.force_N[:, k], displacement_mm=pad.displacement_mm[:, k]
        )

    return on_pads(change)


def kept(frames):
    return lambda recording: frames_of(recording, frames)


@cache
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
    stated = {"thickness_mm": 4.0, "gel_E_MPa": 0.2, "gel_nu": 0.48}
    return gel_pad("left", rest, np.array(moved), np.array(pushed), kn=kn, kt=kt, **stated)
