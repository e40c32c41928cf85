from dataclasses import replace

import numpy as np
import pytest
from turned_camera import turned_camera

from samples.gel_images import seen_at
from tactile.gel.fields import GelFields, fields_of, frame_noise, slab_of
from tactile.gel.gel_sides import GelOutline
from tactile.gel.slab import GelSlab
from tactile.markers.tracking import TrackedMarkers
from tactile.sensors import GelCamera, Sensor, marker_grid
from tactile.tactile_failure import TactileFailure

REST = marker_grid(11, 13, pitch_mm=(1.0, 1.0), first_mm=None)
DEPTHS = np.concatenate([np.zeros(6), np.linspace(0.05, 0.6, 8)])

SENSOR = Sensor(
    kind="markers-stereo",
    name="stereo gel",
    camera=turned_camera(0.35),
    second_camera=turned_camera(-0.35),
    thickness_mm=4.0,
    E_MPa=0.2,
    nu=0.48,
)


def motion(depth_mm: float) -> np.ndarray:
    """A face pressed by a paraboloid and dragged along x."""
    r = np.minimum(np.linalg.norm(REST[:, :2], axis=1) / 3.6, 1.0)
    return np.outer(1 - r**2, [0.3 * depth_mm, 0.0, -depth_mm])


def tracked(camera: GelCamera, seed: int) -> TrackedMarkers:
    rng = np.random.default_rng(seed)
    pixels = np.stack([seen_at(camera, REST + motion(d)) for d in DEPTHS])
    return TrackedMarkers(
        time_s=np.arange(len(DEPTHS)) / 30,
        reference_px=seen_at(camera, REST),
        position_px=pixels + rng.normal(scale=0.03, size=pixels.shape),
        rest_mm=REST,
    )


@pytest.fixture(scope="module")
def fields() -> GelFields:
    return fields_of(SENSOR, tracked(turned_camera(0.35), 1), second=tracked(turned_camera(-0.35), 2))


def test_displacement_is_seen_to_micrometres(fields: GelFields) -> None:
    truth = np.stack([motion(d) for d in DEPTHS])
    error = fields.displacement_mm - truth
    assert np.sqrt((error[..., :2] ** 2).mean()) < 0.002
    assert np.sqrt((error[..., 2] ** 2).mean()) < 0.005


def test_the_air_has_noise_and_no_force(fields: GelFields) -> None:
    air = DEPTHS == 0
    assert 0 < fields.displacement_mm[air].std() < 0.005
    assert not fields.force_N[air].any()
    assert not fields.touching[air].any()


def test_a_press_pushes_back_along_both_axes(fields: GelFields) -> None:
    total = fields.force_N[-1].sum(axis=0)
    assert total[2] > 0
    assert total[0] < 0
    assert abs(total[1]) < 0.05 * total[2]


def test_a_dome_is_refused_with_what_to_do() -> None:
    dome = replace(
        tracked(turned_camera(0.0), 1), rest_mm=REST - np.outer((REST**2).sum(axis=1), [0, 0, 0.03])
    )
    mono = replace(SENSOR, kind="markers-mono", camera=turned_camera(0.0), second_camera=None)
    with pytest.raises(TactileFailure, match=r"stereo gel: its gel is a dome .*Give face_radius_mm"):
        fields_of(mono, dome)


def test_markers_beyond_the_gels_outline_are_refused() -> None:
    outline = GelOutline((2.6, 2.2))
    mono = replace(
        SENSOR, kind="markers-mono", camera=turned_camera(0.0), second_camera=None, outline=outline
    )
    with pytest.raises(TactileFailure, match=r"markers outside the gel .* size_mm \[2.6, 2.2\]"):
        fields_of(mono, tracked(turned_camera(0.0), 1))


def test_stereo_without_the_second_camera_is_refused() -> None:
    with pytest.raises(TactileFailure, match="the second camera's markers are missing"):
        fields_of(SENSOR, tracked(turned_camera(0.35), 1))


def test_a_gel_without_its_law_is_refused() -> None:
    assert slab_of(SENSOR) == GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)
    with pytest.raises(TactileFailure, match=r"forces need the gel: .* nu None, expected all three"):
        slab_of(replace(SENSOR, nu=None))


def test_noise_is_told_from_motion() -> None:
    rng = np.random.default_rng(3)
    t = np.linspace(0, 1, 60)[:, None, None]
    moving = np.concatenate([np.zeros((20, 1, 1)), 5 * t**2]) * np.ones((1, 200, 2))
    noisy = moving + rng.normal(scale=0.03, size=moving.shape)
    assert frame_noise(noisy) == pytest.approx(0.03, rel=0.1)
