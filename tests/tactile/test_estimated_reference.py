"""The untouched gel, estimated from pictures in which something is pressed into it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_gel import PITCH_PX, bulged, drawn, grid
from jaxtyping import Float
from raw_folder import CENTRE, replaced, write_picture, write_raw
from scipy.spatial import cKDTree

from tactile.contact import find_contact
from tactile.from_frames import recording_of
from tactile.io.raw_grasp import read_raw_grasp
from tactile.io.recording import read_recording, write_recording
from tactile.markers.smooth_lattice import lattice_places
from tactile.markers.tracking import ReferenceMarkers, reference_of
from tactile.pad_reference import EstimatedReference, estimated_reference
from tactile.tactile_failure import TactileFailure, TactileProblem


def pressed(places: Float[np.ndarray, "n 2"], px: float) -> Float[np.ndarray, "n 2"]:
    """A ball is pressed in beside the middle, and felt to three pitches."""
    return bulged(places, px, middle=np.array([100.0, 80.0]), wide=30.0)


def estimated(
    markers_px: Float[np.ndarray, "n 2"], **described: Any
) -> tuple[ReferenceMarkers, EstimatedReference]:
    reference = reference_of(drawn(markers_px, noise=1.0), source="drawn")
    ideal, known = lattice_places(reference.lattice)
    return reference, estimated_reference(reference.lattice, ideal, known, source="drawn", **described)


def below_print(found: EstimatedReference, truth_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    """Errors (px) of the places that are not seen, over their standard deviations in the second half."""
    off = found.rest_px - truth_px[np.asarray(cKDTree(truth_px).query(found.rest_px)[1])]
    return np.stack([np.linalg.norm(off, axis=1), found.sd_px])[:, ~found.unloaded]


@pytest.mark.parametrize("seed", range(3))
def test_places_below_a_print_are_those_of_the_lattice_within_their_spread(seed: int) -> None:
    truth = grid() + np.random.default_rng(seed).normal(scale=0.3, size=grid().shape)
    seen = pressed(truth, 6.0)
    _, found = estimated(seen)
    moved = np.linalg.norm(seen - truth, axis=1).max()
    off, sd_px = below_print(found, truth)
    assert moved > 5.0
    assert len(off) >= 6
    assert off.max() < 1.5
    assert (off < 3.0 * sd_px).all()
    assert found.unloaded.sum() >= 40


def test_an_empty_gel_stays_where_it_is_seen() -> None:
    reference, found = estimated(grid())
    assert found.unloaded.all()
    np.testing.assert_array_equal(found.rest_px, reference.lattice.rest_px)


def test_a_described_lattice_is_shifted_to_the_unloaded_markers() -> None:
    truth = grid() + np.array([1.7, -0.9])
    reference = reference_of(drawn(pressed(truth, 6.0), noise=1.0), source="drawn")
    described = grid()[np.asarray(cKDTree(truth).query(reference.lattice.rest_px)[1])]
    _, found = estimated(pressed(truth, 6.0), described_px=described)
    off, sd_px = below_print(found, truth)
    assert len(off) >= 6
    assert off.max() < 0.2
    assert sd_px.max() < 0.05 * PITCH_PX


def test_a_gel_that_is_loaded_nearly_everywhere_is_refused() -> None:
    rng = np.random.default_rng(4)
    waves = 4.0 * np.sin(grid() / 22.0 + rng.uniform(0, 6, size=2))[:, ::-1]
    with pytest.raises(
        TactileFailure, match=r"found \d+ of \d+ markers outside the imprint, expected"
    ) as caught:
        estimated(grid() + waves)
    assert caught.value.problem is TactileProblem.NO_MARKERS
    assert "reference = ... in grasp.toml" in str(caught.value)


def test_a_grasp_that_is_loaded_throughout_is_converted_with_its_spread(tmp_path: Path) -> None:
    folder = write_raw(tmp_path / "g")
    depths = [5.0, 5.0, 5.2, 5.6, 6.0, 6.2, 6.2, 6.2]
    for t, px in enumerate(depths):
        write_picture(folder / f"left/frame_{t:06d}.png", drawn(pressed(grid(), px), noise=1.0, seed=t))
    (folder / "left/reference.png").unlink()
    replaced(folder / "grasp.toml", 'sensor = "left.toml"', 'sensor = "left.toml"\nreference = "estimate"')
    made = recording_of(read_raw_grasp(folder))
    write_recording(tmp_path / "g.h5", made.recording)
    left = read_recording(tmp_path / "g.h5").pads[0]
    assert left.reference_print is None
    assert (left.reference_sd_mm > 0.03).all()
    seen = left.displacement_mm[-1, :, :2]
    truth = pressed(grid(), depths[-1]) - grid()
    order = np.asarray(cKDTree((grid() - CENTRE) / 15.0).query(left.rest_mm[:, :2])[1])
    assert np.abs(seen - truth[order] / 15.0).max() < 3.5 * left.reference_sd_mm.max()
    assert np.linalg.norm(seen, axis=1).max() > 0.25
    assert any("g/left: drupe estimated the untouched gel from frame " in note for note in made.notes)


def test_the_spread_of_an_estimate_is_in_the_displacements_noise(nectarine_grasp: Any) -> None:
    recording, _ = nectarine_grasp
    sound = find_contact(recording, source="g")
    pads = tuple(replace(pad, reference_sd_mm=np.full(len(pad.rest_mm), 0.05)) for pad in recording.pads)
    wider = find_contact(replace(recording, pads=pads), source="g")
    for one, other in zip(sound.pads, wider.pads, strict=True):
        expected = np.hypot(one.displacement_noise.sd, 0.05)
        assert other.displacement_noise.sd == pytest.approx(expected)
        assert other.displacement_noise.lag1 > 0.9
        assert other.force_noise.sd == one.force_noise.sd
