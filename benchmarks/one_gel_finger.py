"""E from one finger with a gel against a plain jaw, over the truth, on drawn fruit.

    python benchmarks/one_gel_finger.py FOLDER [--first 0] [--count 6] [--half even|odd|all] [--finer]

Fruit are drawn as field_bank.py draws them, each grasped once between a gel and a jaw that is a hundred times
as stiff, with the elements of the shipped sample (about five minutes of processor time a fruit), and graded
with the stiff jaw's force alone, as of a plate. FOLDER keeps recordings and records; what is there is left as
it is. `--finer` takes finer elements and needs a FOLDER of its own, because FOLDER does not name the
elements. The even half sets pipeline.fruit.elasticity's PLAIN_JAW_SD, the odd one is scored once.
"""

import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from field_bank import Drawn, drawn
from field_fruit import Fruit
from field_mistakes import graded
from script import Half, in_half, run

from samples.gel_contact import DEFAULT_GEL, Gel
from samples.grasp_plan import PlannedGrasp, hold_along, two_cycles
from samples.hexahedra import FINER, SHIPPED, Fineness
from samples.sample_batch import simulate
from samples.sample_failure import SampleFailure
from tactile.readers.recording import GelPad, IndenterPad, Recording, read_recording, write_recording

STIFF = Gel(kn_MPa_per_mm=20.0, kt_MPa_per_mm=8.0)
"""A jaw that gives a hundredth of what the gel gives."""
LESS_DEEP = (1.0, 0.75, 0.5)
"""Shares of the drawn travel that are tried until the solver gets there."""


def recorded(number: int, drawing: Drawn, folder: Path, fineness: Fineness) -> Recording:
    """The grasp of a drawn fruit, simulated unless it is there. Raises SampleFailure."""
    path = folder / f"{number:03d}" / "grasp-1.h5"
    if path.is_file():
        return read_recording(path)
    rng = np.random.default_rng([78, number])
    hold = hold_along(drawing.fruit, azimuth_deg=float(rng.uniform(30, 60)), tilt_deg=float(rng.normal(0, 3)))
    deepest_mm, speed_mm_per_s = float(rng.uniform(0.8, 1.2)), float(rng.uniform(0.8, 2.5))
    recording = None
    for less in LESS_DEEP:
        way = two_cycles(deepest_mm=less * deepest_mm, speed_mm_per_s=speed_mm_per_s)
        with suppress(SampleFailure):
            grasp = PlannedGrasp(name="grasp-1", hold=hold, motion=way)
            recording = simulate(drawing.fruit, grasp, rng=rng, gel=(DEFAULT_GEL, STIFF), fineness=fineness)
            break
    if recording is None:
        raise SampleFailure(f"{drawing.fruit.fruit_id}: not in equilibrium at any depth")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_recording(path, replace(recording, category=drawing.category))
    return read_recording(path)


def with_bare_jaw(recording: Recording) -> Recording:
    """The recording as a gel and a jaw without one give it: the force is the gel's."""
    gel, stiff = recording.pads
    assert isinstance(gel, GelPad)
    assert isinstance(stiff, GelPad)
    force_N = np.einsum("tij,tj->ti", gel.pose[:, :3, :3], gel.force_N.sum(axis=1))
    pushed_N = -np.einsum("tj,tj->t", stiff.pose[:, :3, 2], force_N)
    bare = IndenterPad(name=stiff.name, pose=stiff.pose, force_z_N=pushed_N, indenter="plate", radius_mm=None)
    return replace(recording, pads=(gel, bare))


def main(folder: Path, first: int = 0, count: int = 6, half: Half = "all", finer: bool = False) -> None:
    """A line per fruit, then the spread."""
    errors: list[float] = []
    for number in (k for k in range(first, first + count) if in_half(k, half)):
        drawing = drawn(number, np.random.default_rng([77, number]))
        try:
            recording = recorded(number, drawing, folder, FINER if finer else SHIPPED)
        except SampleFailure as failure:
            sys.stderr.write(f"{number:03d}: {failure}; left out\n")
            continue
        fruit = Fruit(
            name=drawing.fruit.fruit_id,
            number=number,
            category=drawing.category,
            E_MPa=drawing.fruit.E_MPa,
            vertices=drawing.mesh[0],
            faces=drawing.mesh[1],
            pit=drawing.pit_mesh,
            recordings=(with_bare_jaw(recording),),
        )
        record = graded(fruit, folder / f"{number:03d}" / "plain")
        line = f"{number:03d} {drawing.category:9s} {drawing.fruit.E_MPa:.3f} MPa"
        if record.modulus is None:
            print(f"{line}  {record.reason}")
            continue
        ratio, sd = record.modulus.E_MPa / fruit.E_MPa, record.modulus.E_sd_MPa / fruit.E_MPa
        print(f"{line}  x {ratio:.3f} +- {sd:.3f}", flush=True)
        errors.append(float(np.log(ratio)))
    if errors:
        ln = np.array(errors)
        mean, rms = ln.mean(), np.sqrt((ln**2).mean())
        print(f"{len(ln)} fruit, ln E over the truth: mean {mean:+.3f}, rms {rms:.3f}")


if __name__ == "__main__":
    run(main)
