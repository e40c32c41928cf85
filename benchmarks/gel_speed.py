"""Frames per second of one pad at 640 x 480 on one core.

    OMP_NUM_THREADS=1 python benchmarks/gel_speed.py [--frames 240] [--runs 3]

Frames are drawn: a grid of dots on a gel that is pressed and let go, displaced as the slab is by Hertz's
pressure over a circle and shear of a third of it. They are tracked and taken to displacement and force. What
is done once for a recording (the gel's compliance, the prior) is timed apart from what each frame takes;
medians over the runs.
"""

import itertools
import time

import cv2
import numpy as np
from script import run

from tactile.gel.fields import GelFields, fields_of, slab_of
from tactile.gel.grid import gel_grid
from tactile.markers.tracking import TrackedMarkers, places_of, reference_of, track
from tactile.sensors import GelCamera, Sensor, marker_grid

SIZE = (640, 480)
PX_PER_MM, DEPTH_MM = 30.0, 16.0
MOMENTS, DEEPEST_MM, LOST = 24, 0.5, 0.01


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


def pressed_mm(sensor: Sensor, radius_mm: float) -> list[np.ndarray]:
    """Displacement of the markers while a circle grows to this radius and shrinks again."""
    assert sensor.rest_mm is not None
    grid = gel_grid(slab_of(sensor), sensor.rest_mm)
    away = np.linalg.norm(grid.nodes_mm, axis=1)
    moved = []
    for share in np.sin(np.linspace(0, np.pi, MOMENTS)):
        a = max(radius_mm * np.sqrt(share), 1e-3)
        pressure = np.sqrt(share) * np.sqrt(np.maximum(1 - (away / a) ** 2, 0))
        force = pressure[:, None] * [0.3, 0.1, 1.0] * grid.pitch_mm**2
        moved.append((grid.compliance @ force.ravel()).reshape(-1, 3))
    deepest = max(float(-field_mm[:, 2].min()) for field_mm in moved)
    return [DEEPEST_MM / deepest * field_mm for field_mm in moved]


def picture(sensor: Sensor, moved_mm: np.ndarray, radius_px: float, rng: np.random.Generator) -> np.ndarray:
    """Dark dots on a lit gel."""
    assert sensor.rest_mm is not None
    place = sensor.rest_mm + moved_mm
    scale = PX_PER_MM * DEPTH_MM / (DEPTH_MM + place[:, 2:])
    gel = np.tile(np.linspace(120, 170, SIZE[0])[None], (SIZE[1], 1))
    for x, y in place[:, :2] * scale + [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]:
        centre = (round(x * 256), round(y * 256))
        cv2.circle(gel, centre, round(radius_px * 256), 40.0, -1, cv2.LINE_8, shift=8)
    gel = cv2.GaussianBlur(gel, (0, 0), 0.7)
    noisy = gel[..., None] * [1.0, 0.9, 0.8] + rng.normal(scale=2.0, size=(*gel.shape, 3))
    return np.clip(noisy, 0, 255).astype(np.uint8)


def timed(
    pictures: list[np.ndarray], sensor: Sensor, frames: int, *, lost: bool
) -> tuple[float, float, float, GelFields]:
    """Seconds of CPU a frame of tracking and of force, and once for the recording; and the fields.

    `lost`: other markers are hidden in every frame.
    """
    assert sensor.camera is not None
    reference = reference_of(pictures[0], source="drawn")
    start = time.process_time()
    position = track(reference, itertools.islice(itertools.cycle(pictures), frames))
    tracking_s = (time.process_time() - start) / frames
    if lost:
        position[np.random.default_rng(2).random(position.shape[:2]) < LOST] = np.nan
    rest_px = reference.lattice.rest_px
    places = places_of(sensor.camera, rest_px, sensor.rest_mm, shape=reference.shape, source="drawn")

    def first(count: int) -> TrackedMarkers:
        return TrackedMarkers(
            time_s=np.arange(count) / 30,
            reference_px=rest_px[places.kept],
            position_px=position[:count, places.kept],
            rest_mm=places.rest_mm,
        )

    start = time.process_time()
    gel_fields = fields_of(sensor, first(frames))
    all_s = time.process_time() - start
    start = time.process_time()
    fields_of(sensor, first(MOMENTS), hyperparameters=gel_fields.hyperparameters)
    few_s = time.process_time() - start
    start = time.process_time()
    fields_of(sensor, first(frames), hyperparameters=gel_fields.hyperparameters)
    force_s = (time.process_time() - start - few_s) / (frames - MOMENTS)
    return tracking_s, force_s, all_s - frames * force_s, gel_fields


def main(frames: int = 240, runs: int = 3) -> None:
    """One table."""
    cv2.setNumThreads(1)
    for rows, columns, pitch, radius, contact_mm, lost in (
        (7, 9, 2.0, 10.0, 3.5, False),
        (14, 18, 1.1, 5.0, 3.5, False),
        (14, 18, 1.1, 5.0, 3.5, True),
        (14, 18, 1.1, 5.0, 6.5, False),
    ):
        rng = np.random.default_rng(1)
        sensor = sensor_of(rows, columns, pitch)
        pictures = [picture(sensor, moved, radius, rng) for moved in pressed_mm(sensor, contact_mm)]
        times = [timed(pictures, sensor, frames, lost=lost) for _ in range(runs)]
        tracking_s, force_s, once_s = np.median([each[:3] for each in times], axis=0)
        gel_fields = times[0][3]
        most, nodes = gel_fields.touching.sum(axis=1).max(), gel_fields.touching.shape[1]
        hidden = f", {LOST:.0%} of them hidden" if lost else ""
        print(
            f"{rows * columns} markers{hidden}, contact of {contact_mm} mm radius ({most} of {nodes} nodes): "
            f"tracking {1e3 * tracking_s:.1f} ms, force {1e3 * force_s:.1f} ms, both "
            f"{1 / (tracking_s + force_s):.0f} frames/s; once {once_s:.1f} s",
            flush=True,
        )


if __name__ == "__main__":
    run(main)
