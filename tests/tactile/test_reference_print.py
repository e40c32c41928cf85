"""Prints on pictures of a gel."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_gel import PITCH_PX, SHAPE, bulged, drawn, grid
from injected_grasp import with_pads
from jaxtyping import Float
from raw_folder import CENTRE, PRESS, SENSOR, write_camera, write_log, write_raw
from turned_camera import SMALL, turned_camera

from samples.gel_images import GelLight, GelLook, gel_image
from tactile.contact import find_contact
from tactile.from_frames import recording_of
from tactile.markers.smooth_lattice import coherent_misfit_px, fitted_lens, lattice_places
from tactile.markers.tracking import reference_of
from tactile.readers.raw_grasp import read_raw_grasp
from tactile.readers.recording import read_recording, write_recording
from tactile.reference_print import ShownPrint, becomes_flatter, shown_print
from tactile.sensors import marker_grid


def pressed(places: Float[np.ndarray, "n 2"], px: float) -> Float[np.ndarray, "n 2"]:
    return bulged(places, px, middle=CENTRE, wide=50.0)


def shown_on(picture: np.ndarray) -> ShownPrint:
    return shown_print(picture, reference_of(picture, source="drawn"))


def jittered(sd_px: float, seed: int) -> Float[np.ndarray, "n 2"]:
    """Markers printed by hand: each off by itself."""
    return grid() + np.random.default_rng(seed).normal(scale=sd_px, size=grid().shape)


@pytest.mark.parametrize("seed", range(3))
def test_an_empty_gel_with_badly_printed_dots_and_uneven_light_shows_nothing(seed: int) -> None:
    picture = drawn(jittered(0.5, seed), noise=2.0, tilt=0.8, light=1.3, seed=seed)
    assert shown_on(picture).evidence < 1.0


def test_a_print_is_seen_by_its_markers_alone() -> None:
    shown = shown_on(drawn(pressed(jittered(0.5, 1), 3.0), noise=2.0))
    assert shown.bulge > 1.3
    assert shown.shading < 1.0
    assert shown.seen_by.startswith("its markers bulge (")


def test_a_print_is_seen_by_its_shading_alone() -> None:
    picture = drawn(grid(), noise=2.0).astype(float)
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ridge = sum(np.exp(-(((columns + 0.5 * rows - middle) / 6.0) ** 2)) for middle in (120.0, 200.0, 290.0))
    picture *= 1.0 + ridge[..., None] * [0.35, -0.1, -0.25]
    shown = shown_on(np.clip(picture, 0, 255).astype(np.uint8))
    assert shown.shading > 1.3
    assert shown.bulge < 1.0


def test_a_change_of_exposure_changes_nothing() -> None:
    bulge = pressed(grid(), 2.0)
    dark, light = (shown_on(drawn(bulge, light=k)) for k in (0.7, 1.6))
    assert dark.bulge == pytest.approx(light.bulge, rel=0.05)


def test_a_lens_bends_the_lattice_and_is_no_bulge() -> None:
    """A homography with Brown and Conrady's terms, in closed form, is fitted to rounding."""
    reference = reference_of(drawn(grid()), source="drawn")
    ideal, known = lattice_places(reference.lattice)
    assert known.all()
    away = (grid() - [159.5, 119.5]) / 200.0
    warped = away / (1.0 + away @ [[0.06], [-0.04]])
    x, y = warped.T
    r = x**2 + y**2
    tangential = np.stack([2 * 0.01 * x * y - 0.02 * (r + 2 * x**2), 0.01 * (r + 2 * y**2) - 0.04 * x * y], 1)
    seen = 200.0 * (warped * (1.0 - 0.1 * r[:, None]) + tangential) + [159.5, 119.5]
    order = np.lexsort((grid()[:, 0].round(), grid()[:, 1].round()))
    ours = np.lexsort((ideal[:, 0], ideal[:, 1]))
    misfit = np.zeros_like(seen)
    lens = fitted_lens(ideal[ours], seen[order], SHAPE)
    misfit[ours] = seen[order] - lens.places_px(ideal[ours])
    assert np.abs(misfit).max() < 1e-3
    assert np.abs(coherent_misfit_px(reference.lattice, misfit)).max() < 1e-3


def rendered(depth_mm: float) -> np.ndarray:
    """A lit gel with a ball of 4 mm radius pressed in, rendered through a lens by samples."""
    lights = tuple(
        GelLight(direction=np.array(d) / np.linalg.norm(d), colour=np.array(c))
        for d, c in (((1, 0, -0.6), (0.9, 0.1, 0.1)), ((-0.5, 0.9, -0.6), (0.1, 0.9, 0.1)),
                     ((-0.5, -0.9, -0.6), (0.1, 0.1, 0.9)))
    )  # fmt: skip
    dots = marker_grid(7, 9, pitch_mm=(1.9, 1.9), first_mm=None)

    def field(at: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
        sunk = depth_mm * np.exp(-(at**2).sum(axis=1) / 2 / 2.0**2)
        return np.column_stack([0.35 * at * (sunk / 2.0)[:, None], -sunk])

    return gel_image(
        turned_camera(0.0, **SMALL), lights, GelLook(rest_mm=dots), field, np.random.default_rng(5)
    )


def test_a_rendered_gel_shows_a_ball_that_is_pressed_in_and_nothing_when_it_is_empty() -> None:
    assert shown_on(rendered(0.0)).evidence < 1.0
    assert shown_on(rendered(0.6)).evidence > 1.3


def test_a_gel_that_becomes_flatter_was_not_empty() -> None:
    faint, empty, noise = (ShownPrint(bulge=b, shading=s) for b, s in ((0.8, 0.5), (0.3, 0.5), (0.5, 0.5)))
    assert becomes_flatter(faint, empty)
    assert not becomes_flatter(noise, empty)
    assert not becomes_flatter(empty, faint)


def printed(folder: Path, *, reference_px: float, frames_px: list[float]) -> Path:
    """A raw press whose gel bears a print on its reference and on its frames."""
    frames = (drawn(pressed(grid(), px), noise=1.0, seed=t) for t, px in enumerate(frames_px))
    write_camera(folder / "tip", drawn(pressed(grid(), reference_px), noise=1.0, seed=90), frames)
    (folder / "sensor.toml").write_text(SENSOR.format(serial="tip"))
    (folder / "grasp.toml").write_text(PRESS)
    write_log(folder, len(frames_px))
    return folder


def test_a_recording_carries_what_its_pictures_show_and_its_file_gives_it_back(tmp_path: Path) -> None:
    folder = printed(tmp_path / "g", reference_px=0.0, frames_px=[0.0, 0.0, 1.0, 3.0, 5.0, 5.0])
    made = recording_of(read_raw_grasp(folder))
    write_recording(tmp_path / "g.h5", made.recording)
    for pad in (made.recording.pads[0], read_recording(tmp_path / "g.h5").pads[0]):
        assert pad.reference_print < 0.5
        assert (pad.print_shown[:2] < 0.5).all()
        assert (pad.print_shown[4:] > 1.3).all()
    assert not [note for note in made.notes if "reference" in note]


def test_a_faint_print_on_the_reference_is_said_when_it_goes(tmp_path: Path) -> None:
    """On the drawn gel 2.3 px of bulge are 0.83 of what counts."""
    folder = printed(tmp_path / "g", reference_px=2.3, frames_px=[2.3, 2.3, 1.5, 0.0, 0.0])
    made = recording_of(read_raw_grasp(folder))
    assert made.recording.pads[0].reference_print == 1.0
    assert any(
        "the gel is flatter. An object pressed the gel in the reference" in note for note in made.notes
    )


def test_a_described_grid_stands_for_the_regular_one(tmp_path: Path) -> None:
    """Markers that are printed askew, as the description says, are no bulge against it."""
    raw = read_raw_grasp(write_raw(tmp_path / "g"))
    sensor = raw.pads[0].sensor
    picture = drawn(pressed(grid(), 5.0))
    reference = reference_of(picture, source="drawn")
    described = sensor.rest_mm.copy()
    described[:, :2] = (pressed(grid(), 5.0) - CENTRE) / 15.0
    plain = shown_print(picture, reference)
    known = shown_print(picture, reference, camera=sensor.camera, described_mm=described)
    assert plain.bulge > 1.3
    assert known.bulge < 0.1


def test_scattered_markers_are_told_by_shading_alone() -> None:
    places = np.random.default_rng(3).uniform([20.0, 20.0], [300.0, 220.0], size=(120, 2))
    far = [places[0]]
    for place in places[1:]:
        if min(np.linalg.norm(place - other) for other in far) > 0.75 * PITCH_PX:
            far.append(place)
    shown = shown_on(drawn(np.array(far)))
    assert not shown.bulge > 1.0
    assert shown.evidence >= shown.shading


def test_the_spread_of_places_at_rest_is_in_the_displacements_noise(nectarine_grasp: Any) -> None:
    recording, _ = nectarine_grasp
    sound = find_contact(recording, source="g")
    wider = find_contact(with_pads(recording, lambda pad: replace(pad, place_sd_mm=0.05)), source="g")
    for sound_pad, wider_pad in zip(sound.pads, wider.pads, strict=True):
        expected = np.hypot(sound_pad.displacement_noise.sd, 0.05)
        assert wider_pad.displacement_noise.sd == pytest.approx(expected)
        assert wider_pad.displacement_noise.lag1 > 0.9
        assert wider_pad.force_noise.sd == sound_pad.force_noise.sd
