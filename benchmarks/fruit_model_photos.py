"""Draw the pictures that the fruit model (recon/learned/fruit_model.py) is trained on: close-ups of drawn
scenes.

    python benchmarks/fruit_model_photos.py OUT [--first 0] [--scenes 400] [--each 6]

Scene k has the seed 100000 + k: none is a scene of benchmarks/photo_bank.py. Every third is of the family
phone (no mat). Each gives OUT/<k>.npz: images (n, 192, 192, 3) BGR and cover (n, 192, 192), 0 to 255.
Scenes that are there are skipped. Needs the extra `samples`.
"""

import time
from pathlib import Path

import numpy as np
from script import run

from samples.scenes.draw import FIRST_SEED, draw_scene
from samples.scenes.render import RenderOptions, close_ups

FIRST = 100_000
SIDE_PX = 192
SAMPLES = 8


def main(out: Path, first: int = 0, scenes: int = 400, each: int = 6) -> None:
    """Draws."""
    out.mkdir(parents=True, exist_ok=True)
    for k in range(first, first + scenes):
        path = out / f"{k:05d}.npz"
        if path.exists():
            continue
        before = time.process_time()
        family = "phone" if k % 3 == 2 else "mat"
        scene = draw_scene(FIRST + k - FIRST_SEED[family], photos=each, family=family)
        made = list(close_ups(scene, side_px=SIDE_PX, samples=SAMPLES, options=RenderOptions(skin_cells=120)))
        part = path.with_suffix(".part.npz")
        np.savez_compressed(
            part, images=np.stack([c.image for c in made]), cover=np.stack([c.cover for c in made])
        )
        part.rename(path)
        print(f"scene {k}: {time.process_time() - before:.1f} processor s", flush=True)


if __name__ == "__main__":
    run(main)
