"""What a pixel's colour says of fruit and ground."""

import numpy as np

from recon.silhouettes.mask import (
    Behind,
    cells_of,
    colour_density,
    colour_log_odds,
    ground_density,
    ground_noise,
    lab,
    looks_like,
    strange_share,
)  # fmt: skip

SIDE = 80


def test_ink_as_dark_as_the_skin_is_alike_and_paper_is_not():
    rng = np.random.default_rng(0)
    skin = lab(np.clip(rng.normal([40, 30, 35], 4, (60, 60, 3)), 0, 255).astype(np.uint8)).reshape(-1, 3)
    scene = np.zeros((10, 30, 3), np.uint8)
    scene[:, :10], scene[:, 10:20], scene[:, 20:] = (38, 32, 33), (225, 228, 230), (40, 60, 150)
    similar = looks_like(lab(scene), skin)
    assert similar[:, :10].all()
    assert not similar[:, 10:].any()


def paper(level: float) -> Behind:
    colours = np.tile(np.array([level, 1.0, 6.0], np.float32), (SIDE, SIDE, 1))
    return Behind(colours, colours, colours, np.zeros((SIDE, SIDE, 2)), np.ones((SIDE, SIDE), bool))


def in_shadow(colours: np.ndarray, light: float) -> np.ndarray:
    """CIE Lab of the same surface under a share of the light, where every L* is above 8."""
    k = light ** (1 / 3)
    return np.stack(
        [k * (colours[..., 0] + 16) - 16, k * colours[..., 1], k * colours[..., 2]], axis=-1
    ).astype(np.float32)


def test_a_shadow_that_moved_is_ground_and_dark_skin_in_its_place_is_not():
    rng = np.random.default_rng(3)
    behind = paper(85.0)
    seen = behind.colours + rng.normal(0, 0.8, behind.colours.shape).astype(np.float32)
    seen[:, 40:] = in_shadow(seen[:, 40:], 0.4)  # half of the ground
    noise = ground_noise(seen, behind, np.ones((SIDE, SIDE), bool))
    assert 0.4 < noise.shadow_share < 0.6
    skin = rng.normal([22.0, 14.0, 6.0], 3.0, (4000, 3)).astype(np.float32)
    palette = colour_density(cells_of(skin))
    nothing = np.zeros((SIDE, SIDE))
    picture = seen.copy()
    picture[:20] = skin[: 20 * SIDE].reshape(20, SIDE, 3)
    log_odds = colour_log_odds(
        palette[cells_of(picture)], ground_density(picture, behind, noise), nothing, nothing
    )
    assert (log_odds[:20] > 2).mean() > 0.98
    assert (log_odds[20:] < -2).mean() > 0.98


def test_ground_that_the_plate_does_not_tell_is_strange_nearby_and_nowhere_else():
    sure = np.ones((400, 400), bool)
    sure[150:250, 150:250] = False
    on_background = np.full((400, 400), 1e-3)
    on_background[:, :150] = 1e-9
    share = strange_share(on_background, np.full((400, 400), 1e-4), sure)
    assert share[:, :60].min() > 0.5
    assert share[200, 160] > share[200, 240]
    assert share[:, 340:].max() < 0.05
