"""Draw a bank of path-traced photo sets with known truth, for judging the reconstruction.

    python benchmarks/photo_bank.py draw OUT [--family mat|phone] [--sets 64] [--first 0] [--photos 24]
        [--half work|scored] [--share 1/2] [--one-thread]

Every set gets OUT/<set>/ with photos/, mat.json, fruit_truth.ply (mm), cameras_truth.json and
scene.json. Sets that are complete are skipped, so a run that was broken off goes on. Even sets (half work)
come first, then odd ones (half scored: kept for the final score, nobody tunes on them). --share 1/2 and
--share 2/2 in two processes divide the sets between them. Needs the extra `samples`.
"""

import importlib
import os
import time
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path

import cv2

from samples.scenes.draw import FAMILIES, draw_scene
from samples.scenes.render import RenderOptions
from samples.scenes.write import complete, write_scene


def main() -> None:
    """Draws the sets that are not there."""
    parser = ArgumentParser(description=__doc__, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("do", choices=("draw",))
    parser.add_argument("out", type=Path)
    parser.add_argument("--family", choices=FAMILIES, default="mat")
    parser.add_argument("--sets", type=int, default=64)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--photos", type=int, default=24)
    parser.add_argument("--half", choices=("work", "scored"))
    parser.add_argument("--share", default="1/1", metavar="PART/PARTS")
    parser.add_argument("--one-thread", action="store_true", help="render and denoise with one thread")
    options = parser.parse_args()
    if options.one_thread:
        os.environ["OIDN_NUM_THREADS"] = "1"
        cv2.setNumThreads(1)
        importlib.import_module("drjit").set_thread_count(1)
    numbers = range(options.first, options.first + options.sets)
    order = [k for k in numbers if k % 2 == 0] + [k for k in numbers if k % 2]
    if options.half is not None:
        order = [k for k in order if k % 2 == (options.half == "scored")]
    part, parts = (int(number) for number in options.share.split("/"))
    mine = order[part - 1 :: parts]
    start = time.monotonic()
    for done, k in enumerate(mine, start=1):
        scene = draw_scene(k, photos=options.photos, family=options.family)
        if complete(options.out / scene.name, photos=options.photos):
            continue
        before = time.process_time()
        write_scene(options.out, scene, options=RenderOptions())
        each = (time.process_time() - before) / options.photos
        print(
            f"{scene.name} ({done} of {len(mine)}): {each:.2f} processor s a photo,"
            f" {time.monotonic() - start:.0f} s since the start",
            flush=True,
        )


if __name__ == "__main__":
    main()
