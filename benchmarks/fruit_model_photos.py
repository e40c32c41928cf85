"""Draw the pictures that the fruit model (recon/learned/fruit_model.py) is trained on: close-ups of drawn
scenes.

    python benchmarks/fruit_model_photos.py OUT [--first 0] [--scenes 400] [--each 6] [--one-thread]

Scene k has the seed 100000 + k: none is a scene of benchmarks/photo_bank.py. Every third is of the family
phone (no mat). Each gives OUT/<k>.npz: images (n, 192, 192, 3) BGR and cover (n, 192, 192), 0 to 255.
Scenes that are there are skipped. Needs the extra `samples`.
"""

import importlib
import os
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import cv2
import numpy as np

from samples.scenes.draw import FIRST_SEED, draw_scene
from samples.scenes.render import RenderOptions, close_ups

FIRST = 100_000
SIDE_PX = 192
SAMPLES = 8


def main() -> None:
    """Draws."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--scenes", type=int, default=400)
    parser.add_argument("--each", type=int, default=6)
    parser.add_argument("--one-thread", action="store_true", help="render and denoise with one thread")
    options = parser.parse_args()
    if options.one_thread:
        os.environ["OIDN_NUM_THREADS"] = "1"
        cv2.setNumThreads(1)
        importlib.import_module("drjit").set_thread_count(1)
    options.out.mkdir(parents=True, exist_ok=True)
    for k in range(options.first, options.first + options.scenes):
        path = options.out / f"{k:05d}.npz"
        if path.exists():
            continue
        before = time.process_time()
        family = "phone" if k % 3 == 2 else "mat"
        scene = draw_scene(FIRST + k - FIRST_SEED[family], photos=options.each, family=family)
        made = list(close_ups(scene, side_px=SIDE_PX, samples=SAMPLES, options=RenderOptions(skin_cells=120)))
        part = path.with_suffix(".part.npz")
        np.savez_compressed(
            part, images=np.stack([c.image for c in made]), cover=np.stack([c.cover for c in made])
        )
        part.rename(path)
        print(f"scene {k}: {time.process_time() - before:.1f} processor s", flush=True)


if __name__ == "__main__":
    main()
