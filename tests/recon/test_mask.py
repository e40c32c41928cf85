"""What a pixel's colour says: nothing against a dark fruit where dark skin stands before dark ink."""

import numpy as np

from recon.mask import lab, looks_like


def test_ink_as_dark_as_the_skin_is_alike_and_paper_is_not():
    rng = np.random.default_rng(0)
    skin = lab(np.clip(rng.normal([40, 30, 35], 4, (60, 60, 3)), 0, 255).astype(np.uint8)).reshape(-1, 3)
    scene = np.zeros((10, 30, 3), np.uint8)
    scene[:, :10], scene[:, 10:20], scene[:, 20:] = (38, 32, 33), (225, 228, 230), (40, 60, 150)
    alike = looks_like(lab(scene), skin)
    assert alike[:, :10].all()
    assert not alike[:, 10:].any()


def test_nine_tenths_of_a_sample_look_like_it():
    rng = np.random.default_rng(1)
    sample = rng.normal([40.0, 50.0, 30.0], 6.0, (5000, 3)).astype(np.float32)
    share = looks_like(sample[None], sample).mean()
    assert 0.88 < share < 0.97
