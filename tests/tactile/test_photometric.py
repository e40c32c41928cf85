from pathlib import Path

import cv2
import numpy as np
import pytest
from turned_camera import turned_camera

from samples.gel_images import Field, GelLook, gel_image, seen_at
from tactile.gel.ball_press import ball_lookup, ball_print
from tactile.gel.photometric import PhotometricDepth, SlopeLookup, lambert_lookup
from tactile.gel.shading_file import shading_of, write_lookup
from tactile.io.sensor_file import read_sensor
from tactile.sensors import GelCamera, GelLight, marker_grid
from tactile.tactile_failure import TactileFailure

AMBIENT = 0.35
DOTS = marker_grid(7, 10, pitch_mm=(1.2, 1.2), first_mm=None)
LOOK = GelLook(rest_mm=DOTS, dot_mm=0.35, ambient=AMBIENT)
LIGHTS = tuple(
    GelLight(direction=np.array([0.8 * np.cos(a), 0.8 * np.sin(a), -0.6]), colour=0.9 * np.eye(3)[k])
    for k, a in enumerate(2 * np.pi * np.arange(3) / 3)
)


def eye(turn_rad: float = 0.0) -> GelCamera:
    return turned_camera(
        turn_rad, away_mm=22.0, image_px=(480, 360), focal_px=(720.0, 721.0), centre_px=(241.0, 178.0)
    )


def flat(at: np.ndarray) -> np.ndarray:
    return np.zeros((len(at), 3))


def dent(at: np.ndarray) -> np.ndarray:
    """0.5 mm deep, steepest slope 0.26, nothing left of it at the border; off centre and skewed."""
    away = at - [0.5, 0.3]
    depth = np.exp(-(away**2).sum(axis=1) / 3.3)
    return np.stack([0.03 * away[:, 0] * depth, 0.04 * depth, -0.5 * depth], axis=1)


def ball(radius_mm: float, contact_mm: float) -> Field:
    """A cap of the ball that goes over into a skirt without a kink."""
    edge = contact_mm / np.sqrt(radius_mm**2 - contact_mm**2)

    def field(at: np.ndarray) -> np.ndarray:
        r = np.linalg.norm(at - [-0.4, 0.6], axis=1)
        cap = radius_mm - np.sqrt(radius_mm**2 - np.minimum(r, contact_mm) ** 2)
        skirt = edge * 0.8 * (1 - np.exp(-np.maximum(r - contact_mm, 0) / 0.8))
        rise = cap + skirt
        whole = radius_mm - np.sqrt(radius_mm**2 - contact_mm**2) + edge * 0.8
        return np.stack([0 * r, 0 * r, rise - whole], axis=1)

    return field


def image(camera: GelCamera, shape: Field, seed: int) -> np.ndarray:
    return gel_image(camera, LIGHTS, LOOK, shape, np.random.default_rng(seed))


def depth_error_um(camera: GelCamera, lookup: SlopeLookup) -> np.ndarray:
    shading = PhotometricDepth(camera, image(camera, flat, 0), lookup)
    places = DOTS + dent(DOTS[:, :2])
    return 1e3 * (shading.at(image(camera, dent, 1), seen_at(camera, places)) - places)


@pytest.mark.parametrize("turn_rad", [0.0, 0.2])
def test_depth_of_a_dent_by_lights_of_known_direction(turn_rad: float) -> None:
    miss = depth_error_um(eye(turn_rad), lambert_lookup(LIGHTS, ambient=AMBIENT))
    assert np.sqrt((miss[:, 2] ** 2).mean()) < 8
    assert np.abs(miss).max() < 20


def test_the_untouched_gel_is_flat_within_two_micrometres() -> None:
    shading = PhotometricDepth(eye(), image(eye(), flat, 0), lambert_lookup(LIGHTS, ambient=AMBIENT))
    face = shading.face(image(eye(), flat, 5))
    assert np.sqrt(((face - 22.0) ** 2).mean()) < 2e-3


def test_a_ball_finds_its_place_and_gives_the_look_up() -> None:
    """Neither lights nor ambient light are told."""
    imprint = ball_print(
        eye(), image(eye(), flat, 0), image(eye(), ball(5.0, 2.0), 2), radius_mm=5.0, source="b"
    )
    np.testing.assert_allclose(imprint.centre_mm, [-0.4, 0.6], atol=0.06)
    assert imprint.contact_mm == pytest.approx(2.0, rel=0.15)
    miss = depth_error_um(eye(), ball_lookup([imprint]))
    assert np.sqrt((miss[:, 2] ** 2).mean()) < 15


def test_a_print_wider_than_the_ball_is_refused() -> None:
    with pytest.raises(TactileFailure, match=r"b: found an imprint of .* ball's radius of 1 mm"):
        ball_print(eye(), image(eye(), flat, 0), image(eye(), ball(5.0, 2.0), 2), radius_mm=1.0, source="b")


def ridge(at: np.ndarray) -> np.ndarray:
    """A rod's print: the same all along y."""
    return ball(5.0, 2.0)(np.stack([at[:, 0], np.full(len(at), 0.6)], axis=1))


def bumps(at: np.ndarray) -> np.ndarray:
    """Something woven: waves of 0.1 mm, 2.2 mm long."""
    wave = np.sin(2 * np.pi * at[:, 0] / 2.2) * np.sin(2 * np.pi * at[:, 1] / 2.2)
    return np.stack([0 * wave, 0 * wave, 0.1 * wave - 0.1], axis=1)


def pole(at: np.ndarray) -> np.ndarray:
    """A pin of 0.3 mm: a print smaller than the look-up needs."""
    return 0.2 * ball(0.3, 0.2)(at)


@pytest.mark.parametrize("shape", [ridge, bumps, pole])
def test_what_is_no_ball_is_refused(shape: Field) -> None:
    with pytest.raises(TactileFailure, match=r"b\.png: (found an imprint|colours change)"):
        ball_print(eye(), image(eye(), flat, 0), image(eye(), shape, 2), radius_mm=5.0, source="b.png")


def test_a_soft_stain_is_no_ball() -> None:
    rng = np.random.default_rng(4)
    stain = cv2.GaussianBlur(rng.normal(size=(360, 480)), (0, 0), rng.uniform(10, 40))
    coloured = 1 + 0.5 * stain[..., None] / stain.max() * rng.uniform(-1, 1, 3)
    press = np.clip(image(eye(), flat, 0) * coloured, 0, 255).astype(np.uint8)
    with pytest.raises(TactileFailure, match=r"whose colours explain only 70% of a ball's slopes"):
        ball_print(eye(), image(eye(), flat, 0), press, radius_mm=5.0, source="b.png")


def test_a_picture_of_another_sensor_is_no_ball() -> None:
    other = GelLook(rest_mm=DOTS, dot_mm=0.35, ambient=0.8)
    turned = tuple(GelLight(direction=light.direction[[1, 0, 2]], colour=light.colour) for light in LIGHTS)
    press = gel_image(eye(), turned, other, flat, np.random.default_rng(2))
    press[:, :160] //= 2
    with pytest.raises(TactileFailure, match=r"b\.png: found an imprint"):
        ball_print(eye(), image(eye(), flat, 0), press, radius_mm=5.0, source="b.png")


def test_beside_the_gel_nothing_is_looked_for() -> None:
    """The gel fills the left two thirds; beside it the camera sees a dark wall that flickers."""
    rng = np.random.default_rng(4)
    reference, press = image(eye(), flat, 0), image(eye(), ball(5.0, 2.0), 2)
    for picture, level in ((reference, 2), (press, 12)):
        picture[:, 330:] = rng.integers(0, level, picture[:, 330:].shape)
    imprint = ball_print(eye(), reference, press, radius_mm=5.0, source="b.png")
    np.testing.assert_allclose(imprint.centre_mm, [-0.4, 0.6], atol=0.1)
    assert imprint.contact_mm == pytest.approx(2.0, rel=0.15)


def test_a_look_up_that_is_not_finite_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(TactileFailure, match=r"look\.npz: found coefficients that are not finite"):
        write_lookup(tmp_path / "look.npz", SlopeLookup(coefficients=np.full((19, 2), np.nan)))
    assert not (tmp_path / "look.npz").exists()


def test_a_picture_without_a_ball_is_refused() -> None:
    with pytest.raises(TactileFailure, match=r"press-3\.png: colours change by"):
        ball_print(eye(), image(eye(), flat, 0), image(eye(), flat, 3), radius_mm=5.0, source="press-3.png")


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_a_description_by_lights_gives_the_depth_of_a_dent(tmp_path: Path, gamma: float) -> None:
    """The room's light and the pictures' gamma are told by the file."""
    lights = "".join(
        f"[[lights]]\ndirection = {light.direction.tolist()}\ncolour = {light.colour.tolist()}\n"
        for light in LIGHTS
    )
    path = tmp_path / "sensor.toml"
    path.write_text(
        f'kind = "photometric"\nname = "lit"\nambient = {AMBIENT}\ngamma = {gamma}\n'
        "[gel]\nthickness_mm = 4.0\nE_MPa = 0.2\nnu = 0.48\n[camera]\n"
        "image_px = [480, 360]\nfocal_px = [720.0, 721.0]\n"
        "centre_px = [241.0, 178.0]\ndistortion = [-0.12, 0.03, 0.001, -0.001, 0.0]\n"
        f"gel_from_camera = {eye().gel_from_camera.tolist()}\n{lights}"
    )
    sensor = read_sensor(path)
    rest, pressed = (
        np.rint(255 * (image(eye(), shape, seed) / 255) ** (1 / gamma)).astype(np.uint8)
        for seed, shape in enumerate((flat, dent))
    )
    shading = shading_of(sensor, sensor.camera, rest)
    places = DOTS + dent(DOTS[:, :2])
    miss = 1e3 * (shading.at(pressed, seen_at(eye(), places)) - places)
    assert np.sqrt((miss[:, 2] ** 2).mean()) < 8
