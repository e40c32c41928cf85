"""A recording with a gel's own fault, corrected, is the recording without it."""

from dataclasses import replace

import numpy as np
import pytest
from injected_grasp import injected_grasp

from tactile.correction import GainFault, corrected
from tactile.gel_correction import ForceLawFault, GelCreepFault, GelHysteresisFault, ThermalFault
from tactile.io.recording import Recording


@pytest.fixture(scope="module")
def true() -> Recording:
    return injected_grasp(np.random.default_rng(3)).recording


def changed(recording: Recording, change) -> Recording:  # type: ignore[no-untyped-def]
    return replace(recording, pads=tuple(change(pad) for pad in recording.pads))


def same(found: Recording, expected: Recording, atol: float = 1e-9) -> None:
    for one, other in zip(found.pads, expected.pads, strict=True):
        for name in ("pose", "force_N", "displacement_mm"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=atol, err_msg=name)


@pytest.mark.parametrize("a", [-0.4, -0.2, 0.3])
def test_a_reading_that_bends_is_straightened(true: Recording, a: float) -> None:
    largest = max(np.linalg.norm(pad.force_N, axis=2).max() for pad in true.pads)

    def bent(pad):  # type: ignore[no-untyped-def]
        size = np.linalg.norm(pad.force_N, axis=2, keepdims=True)
        return replace(pad, force_N=pad.force_N * (1 + a * size / largest))

    recorded = changed(true, bent)
    assert np.abs(recorded.pads[0].force_N - true.pads[0].force_N).max() > 0.1 * largest
    same(corrected(recorded, [ForceLawFault(a=a)]), true)


def test_a_face_that_has_crept_is_put_back(true: Recording) -> None:
    def crept(pad):  # type: ignore[no-untyped-def]
        memory = np.zeros_like(pad.displacement_mm)
        for k in range(1, len(true.time_s)):
            q = np.exp(-(true.time_s[k] - true.time_s[k - 1]) / 1.3)
            memory[k] = q * memory[k - 1] + (1 - q) * pad.displacement_mm[k]
        return replace(pad, displacement_mm=pad.displacement_mm + 0.2 * memory)

    same(corrected(changed(true, crept), [GelCreepFault(creep=0.2, tau_s=1.3)]), true)


def test_a_loop_is_closed(true: Recording) -> None:
    def looped(pad):  # type: ignore[no-untyped-def]
        total = np.maximum(pad.force_N[:, :, 2].sum(axis=1), 0.0)
        r = total / np.maximum.accumulate(np.maximum(total, 0.02 * total.max()))
        return replace(pad, force_N=pad.force_N * (1 - 0.4 * r * (1 - r))[:, None, None])

    recorded = changed(true, looped)
    assert np.abs(recorded.pads[0].force_N - true.pads[0].force_N).max() > 0
    same(corrected(recorded, [GelHysteresisFault(share=0.1)]), true, atol=1e-6)


def test_a_warming_gel_is_cooled(true: Recording) -> None:
    total = true.pads[0].force_N[:, :, 2].sum(axis=1)
    root = np.sqrt(true.time_s - true.time_s[0])
    fault = ThermalFault(strain_per_root_s=1e-3, N_per_root_s=1e-3 * float(total.max()))

    def warmed(pad):  # type: ignore[no-untyped-def]
        force, moved = pad.force_N.copy(), pad.displacement_mm.copy()
        force[:, :, 2] += fault.N_per_root_s / len(pad.rest_mm) * root[:, None]
        moved[:, :, :2] += fault.strain_per_root_s * root[:, None, None] * pad.rest_mm[:, :2]
        return replace(pad, force_N=force, displacement_mm=moved)

    found = corrected(changed(true, warmed), [fault])
    for one, other in zip(found.pads, true.pads, strict=True):
        # what had come by the frames in the air is the sensor's offset, which contact takes out
        for name in ("force_N", "displacement_mm"):
            left = getattr(one, name) - getattr(other, name)
            np.testing.assert_allclose(left, np.broadcast_to(left[0], left.shape), atol=1e-9)


def test_the_order_in_which_faults_are_given_is_of_no_account(true: Recording) -> None:
    faults = [
        ForceLawFault(a=-0.2),
        GainFault(pad="left", gain=1.1),
        GelCreepFault(creep=0.1, tau_s=2.0),
        GelHysteresisFault(share=0.05),
        ThermalFault(strain_per_root_s=1e-4, N_per_root_s=0.01),
    ]
    same(corrected(true, faults), corrected(true, faults[::-1]), atol=0.0)
