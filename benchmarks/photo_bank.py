"""Draw a bank of path-traced photo sets with known truth, for judging the reconstruction.

    python benchmarks/photo_bank.py OUT [--family mat|phone] [--sets 64] [--first 0] [--photos 24]
        [--half work|scored]

Every set gets OUT/<set>/ with photos/, mat.json, fruit_truth.ply (mm), cameras_truth.json and
scene.json. Sets that are complete are skipped, so a run that was broken off goes on. Even sets (half work)
come first, then odd ones (half scored: kept for the final score, nobody tunes on them). Needs the extra
`samples`.
"""

import time
from pathlib import Path
from typing import Literal

from script import run

from samples.scenes.draw import draw_scene
from samples.scenes.render import RenderOptions
from samples.scenes.write import complete, write_scene


def main(
    out: Path,
    family: Literal["mat", "phone", "turntable"] = "mat",
    sets: int = 64,
    first: int = 0,
    photos: int = 24,
    half: Literal["work", "scored"] | None = None,
) -> None:
    """Draws the sets that are not there."""
    numbers = range(first, first + sets)
    wanted = [k for k in numbers if half is None or k % 2 == (half == "scored")]
    order = sorted(wanted, key=lambda k: k % 2)
    start = time.monotonic()
    for done, k in enumerate(order, start=1):
        scene = draw_scene(k, photos=photos, family=family)
        if complete(out / scene.name, photos=photos):
            continue
        before = time.process_time()
        write_scene(out, scene, options=RenderOptions())
        each = (time.process_time() - before) / photos
        print(
            f"{scene.name} ({done} of {len(order)}): {each:.2f} processor s a photo,"
            f" {time.monotonic() - start:.0f} s since the start",
            flush=True,
        )


if __name__ == "__main__":
    run(main)
