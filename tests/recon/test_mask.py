"""What a pixel's colour says of fruit and ground."""

import numpy as np

from recon.silhouettes.mask import Behind, cells_of, colour_density, plate_log_odds

SIDE = 80


def test_a_palette_is_a_density():
    rng = np.random.default_rng(2)
    density = colour_density(cells_of(rng.normal([50.0, 10.0, 10.0], 8.0, (20000, 3)).astype(np.float32)))
    cell = (100 / 24) * (200 / 24) ** 2
    assert abs(density.sum() * cell - 1) < 1e-3


def test_what_is_unlike_the_plate_is_fruit_and_nothing_is_told_where_the_plate_is_not_known():
    rng = np.random.default_rng(3)
    colours = np.tile(np.array([85.0, 1.0, 6.0], np.float32), (SIDE, SIDE, 1))
    known = np.ones((SIDE, SIDE), bool)
    known[-10:] = False
    behind = Behind(colours, colours, colours, known)
    seen = colours + rng.normal(0, 0.8, colours.shape).astype(np.float32)
    seen[:20] = rng.normal([40.0, 50.0, 30.0], 3.0, (20, SIDE, 3))
    seen[20:40, :, 0] -= 15.0  # in a faint shadow
    log_odds = plate_log_odds(seen, behind)
    assert (log_odds[:20] > 2).mean() > 0.98
    assert (log_odds[20:70] < 0).mean() > 0.98
    assert (log_odds[70:] == 0).all()
