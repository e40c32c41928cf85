"""Draw a bank of path-traced photo sets with known truth, for judging the reconstruction.

    python benchmarks/photo_bank.py draw OUT [--family mat|phone] [--sets 64] [--first 0] [--photos 24]
        [--half work|scored] [--share 1/2] [--one-thread]
    python benchmarks/photo_bank.py sheet OUT PICTURE [--half work]

draw: every set gets OUT/<set>/ with photos/, mat.json, fruit_truth.ply (mm), cameras_truth.json and
scene.json. Sets that are complete are skipped, so a run that was broken off goes on. Even sets (half work)
come first, then odd ones (half scored: kept for the final score, nobody tunes on them). --share 1/2 and
--share 2/2 in two processes divide the sets between them. sheet: a contact sheet of the sets' photos. Needs
the extra `samples`.
"""

import argparse
import importlib
import json
import os
import time
from pathlib import Path

import cv2
import numpy as np

from samples.scenes.draw import FAMILIES, draw_scene
from samples.scenes.render import RenderOptions
from samples.scenes.write import complete, write_scene


def main() -> None:
    """Dispatches."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(required=True)
    draw = commands.add_parser("draw")
    draw.set_defaults(run=_draw)
    draw.add_argument("out", type=Path)
    draw.add_argument("--family", choices=FAMILIES, default="mat")
    draw.add_argument("--sets", type=int, default=64)
    draw.add_argument("--first", type=int, default=0)
    draw.add_argument("--photos", type=int, default=24)
    draw.add_argument("--half", choices=("work", "scored"))
    draw.add_argument("--share", default="1/1", metavar="PART/PARTS")
    draw.add_argument("--one-thread", action="store_true", help="render and denoise with one thread")
    sheet = commands.add_parser("sheet")
    sheet.set_defaults(run=_sheet)
    sheet.add_argument("out", type=Path)
    sheet.add_argument("picture", type=Path)
    sheet.add_argument("--half", choices=("work", "scored"), default="work")
    sheet.add_argument("--each", type=int, default=4, help="photos of a set (default 4)")
    options = parser.parse_args()
    options.run(options)


def _draw(options: argparse.Namespace) -> None:
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


def _sheet(options: argparse.Namespace) -> None:
    rows = []
    for facts in sorted(options.out.glob("*/scene.json")):
        scene = json.loads(facts.read_text())
        if scene["half"] != options.half:
            continue
        paths = sorted((facts.parent / "photos").glob("*.jpg"))
        chosen = [paths[round(i)] for i in np.linspace(0, len(paths) - 1, options.each)]
        row = [cv2.resize(cv2.imread(str(p)), (400, 300), interpolation=cv2.INTER_AREA) for p in chosen]
        kind = "-".join(
            str(scene[a][b]) for a, b in (("fruit", "kind"), ("skin", "colour"), ("skin", "gloss"))
        )
        where = f"{scene['ground']['kind']} {scene['light']['kind']} {scene['pipeline']['kind']}"
        state = scene["mat"]["state"] if scene["mat"] else "no mat"
        for line, text in enumerate((f"{scene['name']} {kind}", f"{where} {state}")):
            cv2.putText(row[0], text, (4, 14 + 15 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 255), 1)
        rows.append(np.hstack(row))
    cv2.imwrite(str(options.picture), np.vstack(rows))


if __name__ == "__main__":
    main()
