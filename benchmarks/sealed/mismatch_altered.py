"""Recordings of a case altered as they are read (cut off, left out, or noisier), or an effect left out."""

import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np

from fem.mismatch.catalogue import EFFECTS
from pipeline.batch.layout import CaseFolder
from tactile.contact import Phase, find_contact
from tactile.io.recording import GelPad, Recording, read_recording
from tactile.noise import Noise

WHOLE, LOAD_ONLY, NOT_TURNED, LEFT_OUT = "whole", "load-only", "no-grasp-4", "effect-left-out"
NOISIER = {"noise-2": 2.0, "noise-4": 4.0, "noise-8": 8.0}
ABLATIONS = (WHOLE, LOAD_ONLY, NOT_TURNED, LEFT_OUT, *NOISIER)
"""As recorded; up to the end of the first loading; without the fruit turned; the true effect not in the
catalogue; noise so many times as large."""


@contextmanager
def altered(ablation: str, truth: str = "") -> Iterator[None]:
    """While it holds, the recordings of cases are read so; `truth`: the true effects, joined by +."""
    if ablation == LEFT_OUT:
        without = tuple(effect for effect in EFFECTS if effect.spec.name not in truth.split("+"))
        with patch("fem.mismatch.procedure.EFFECTS", without):
            yield
        return
    if ablation == NOT_TURNED:
        files = CaseFolder.grasp_files

        def but_the_turned(folder: CaseFolder) -> tuple[Path, ...]:
            return tuple(path for path in files(folder) if path.stem != "grasp-4")

        with patch.object(CaseFolder, "grasp_files", but_the_turned):
            yield
        return
    change = first_loading if ablation == LOAD_ONLY else _noisier(NOISIER.get(ablation, 1.0))
    if ablation == WHOLE:
        yield
        return
    with patch("pipeline.fruit.placed_grasp.read_recording", lambda path: change(read_recording(path), path)):
        yield


def first_loading(recording: Recording, path: Path) -> Recording:
    """Without hold, unloading and what comes after."""
    phase = find_contact(recording, source=path.name).phase
    end = next((k for k, one in enumerate(phase) if one in (Phase.HOLD, Phase.UNLOAD)), len(phase))
    pads = tuple(
        replace(
            pad,
            pose=pad.pose[:end],
            displacement_mm=pad.displacement_mm[:end],
            force_N=pad.force_N[:end],
            images=None,
        )
        for pad in recording.pads
        if isinstance(pad, GelPad)
    )
    return replace(
        recording,
        time_s=recording.time_s[:end],
        aperture_mm=recording.aperture_mm[:end],
        wrench_N=None if recording.wrench_N is None else recording.wrench_N[:end],
        pads=pads,
    )


def _noisier(times: float) -> Callable[[Recording, Path], Recording]:
    """Noise of markers and forces raised to so many times its spread in the air, with its own colour."""

    def change(recording: Recording, path: Path) -> Recording:
        contact = find_contact(recording, source=path.name)
        rng = np.random.default_rng([zlib.crc32(f"{path.parent.name}/{path.name}".encode()), int(times)])
        pads = []
        for pad, seen in zip(recording.pads, contact.pads, strict=True):
            moved, force = (
                coloured(np.shape(values), noise, rng) * np.sqrt(times**2 - 1)
                for values, noise in (
                    (pad.displacement_mm, seen.displacement_noise),
                    (pad.force_N, seen.force_noise),
                )
            )
            pads.append(
                replace(pad, displacement_mm=pad.displacement_mm + moved, force_N=pad.force_N + force)
            )
        return replace(recording, pads=tuple(pads))

    return change


def coloured(shape: tuple[int, ...], noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """Noise of this spread whose neighbouring frames correlate so."""
    values = noise.sd * rng.normal(size=shape)
    for k in range(1, len(values)):
        values[k] = noise.lag1 * values[k - 1] + np.sqrt(1 - noise.lag1**2) * values[k]
    return values
