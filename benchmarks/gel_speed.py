"""Frames per second of one pad at 640 x 480 on one core, and memory against the length of the recording.

    OMP_NUM_THREADS=1 python benchmarks/gel_speed.py [--frames 300]

Frames are drawn (a grid of dots, a patch drawn aside and back), tracked, and taken to displacement and force.
"""

import argparse
import itertools
import resource
import time
from collections.abc import Iterator

import cv2
import numpy as np

from tactile.gel.fields import fields_of
from tactile.markers.reference_places import places_of
from tactile.markers.tracking import TrackedMarkers, follow, reference_of, track
from tactile.sensors import GelCamera, Sensor, marker_grid

SIZE = (640, 480)
PX_PER_MM, DEPTH_MM = 30.0, 16.0
MOMENTS = 24


def sensor_of(rows: int, columns: int, pitch_mm: float) -> Sensor:
    """A camera 16 mm behind the gel."""
    pose = np.eye(4)
    pose[2, 3] = -DEPTH_MM
    camera = GelCamera(
        image_px=SIZE,
        focal_px=(PX_PER_MM * DEPTH_MM, PX_PER_MM * DEPTH_MM),
        centre_px=((SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2),
        distortion=(0.0, 0.0, 0.0, 0.0, 0.0),
        gel_from_camera=pose,
    )
    grid = marker_grid(rows, columns, pitch_mm=(pitch_mm, pitch_mm), first_mm=None)
    return Sensor(
        kind="markers-mono", name="drawn", camera=camera, thickness_mm=4.0, E_MPa=0.25, nu=0.48, rest_mm=grid
    )


def picture(sensor: Sensor, shift_mm: float, radius_px: float, rng: np.random.Generator) -> np.ndarray:
    """Dark dots on a lit gel, a patch in the middle drawn aside."""
    assert sensor.rest_mm is not None
    rest = sensor.rest_mm[:, :2]
    moved = rest + shift_mm * np.exp(-(rest**2).sum(axis=1, keepdims=True) / 18.0) * [1.0, 0.4]
    gel = np.tile(np.linspace(120, 170, SIZE[0])[None], (SIZE[1], 1))
    centre = moved * PX_PER_MM + [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]
    for x, y in centre:
        place = (round(x * 256), round(y * 256))
        cv2.circle(gel, place, round(radius_px * 256), 40.0, -1, cv2.LINE_8, shift=8)
    gel = cv2.GaussianBlur(gel, (0, 0), 0.7)
    noisy = gel[..., None] * [1.0, 0.9, 0.8] + rng.normal(scale=2.0, size=(*gel.shape, 3))
    return np.clip(noisy, 0, 255).astype(np.uint8)


def cycled(pictures: list[np.ndarray], frames: int) -> Iterator[np.ndarray]:
    """`frames` pictures, over and over."""
    return itertools.islice(itertools.cycle(pictures), frames)


def main() -> None:
    """One table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=300)
    frames = parser.parse_args().frames
    cv2.setNumThreads(1)
    rng = np.random.default_rng(1)
    for rows, columns, pitch, radius in ((7, 9, 2.0, 10.0), (14, 18, 1.1, 5.0)):
        sensor = sensor_of(rows, columns, pitch)
        shifts = 0.6 * np.sin(np.linspace(0, np.pi, MOMENTS))
        pictures = [picture(sensor, float(s), radius, rng) for s in shifts]
        reference = reference_of(pictures[0], source="drawn")
        start = time.process_time()
        position, quality = track(reference, cycled(pictures, frames))
        tracking_s = time.process_time() - start
        assert sensor.camera is not None
        rest_px = reference.lattice.rest_px
        places = places_of(sensor.camera, rest_px, sensor.rest_mm, shape=reference.shape, source="drawn")
        tracked = TrackedMarkers(
            time_s=np.arange(frames) / 30,
            reference_px=rest_px[places.kept],
            position_px=position[:, places.kept],
            quality=quality[:, places.kept],
            rest_mm=places.rest_mm,
        )
        start = time.process_time()
        fields_of(sensor, tracked)
        force_s = time.process_time() - start
        print(
            f"{rows * columns} markers, {len(rest_px)} found, {np.isfinite(position).mean():.1%} kept: "
            f"tracking {frames / tracking_s:.0f} frames/s, force {frames / force_s:.0f}, both "
            f"{frames / (tracking_s + force_s):.0f}"
        )
        before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        for _ in follow(reference, cycled(pictures, 4 * frames)):
            pass
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"  peak memory {before:.0f} MiB after {frames} frames, {after:.0f} MiB after {5 * frames}")


if __name__ == "__main__":
    main()
