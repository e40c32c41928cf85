"""Print how well images of a gel give back displacement and force: rendered gels with known answers.

    python benchmarks/gel_image_errors.py [--out gel_images.csv] [--keep gel.npz] [--draws 6 --seed 1]
        [--distance 1.0] [--only markers-stereo|markers-mono]

Truth: 26 x 22 x 4 mm of gel (E 0.2 MPa, nu 0.48) in 27-node bricks, pressed 0.7 mm deep by a rigid ball of
15 mm radius with friction, pushed 0.45 mm aside, turned by 3 degrees and let go (`samples/gel_press.py`).
Images: 640 x 480, 221 dots, lens distortion, noise of 1.5 grey levels (`samples/gel_images.py`). `--keep`
keeps the finite elements' compliance between runs (a minute of work). `--draws`: dots alone under so many
presses drawn at random (ball of 8 to 30 mm radius, 0.07 to 1.1 mm deep, pushed and turned) and, beside
them, with a gel whose outline nobody says. `--distance` is a factor on the camera's distance and focal length
that the reader assumes. `--only` measures one of the two sensors. Time is CPU time of one thread: tracking,
depth and force of a frame, once the strength is chosen.
"""

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree
from script import run
from threadpoolctl import threadpool_limits

from samples.gel_images import Field, GelLook, gel_image, smooth_field
from samples.gel_press import BallPose, GelBlock, Pressed, gel_block, pressed
from tactile.gel.fields import DEPTH_ROUNDS, GelFields, fields_of
from tactile.gel.gel_sides import GelOutline
from tactile.gel_camera import on_face
from tactile.markers.tracking import TrackedMarkers, follow, reference_of
from tactile.sensors import GelCamera, Sensor, marker_grid

E_MPA, NU, THICKNESS_MM, FRICTION = 0.2, 0.48, 4.0, 0.6
BALL_MM, DEPTH_MM = 15.0, 0.7
LENS = (-0.12, 0.03, 0.001, -0.001, 0.0)
GRID = marker_grid(13, 17, pitch_mm=(1.0, 1.0), first_mm=None)
OUTLINE = GelOutline((26.0, 22.0))


@dataclass(frozen=True)
class KnownGel:
    """The pressed gel over time."""

    block: GelBlock
    frames: list[Pressed]


def truth(keep: Path | None) -> KnownGel:
    """Press the gel; the block's compliance is kept in `keep`."""
    if keep is not None and keep.exists():
        with np.load(keep) as stored:
            block = GelBlock(**{name: stored[name] for name in stored.files})
    else:
        block = gel_block(thickness_mm=THICKNESS_MM, E_MPa=E_MPA, nu=NU, reach_mm=6.2)
        if keep is not None:
            np.savez(keep, **vars(block))
    still = [BallPose(centre_mm=(0, 0, BALL_MM + 0.05))] * 6
    down = [BallPose(centre_mm=(0, 0, BALL_MM - d)) for d in np.linspace(0.05, DEPTH_MM, 14)]
    aside = [
        BallPose(centre_mm=(0.04 * k, 0.02 * k, BALL_MM - DEPTH_MM), turn_rad=0.005 * k) for k in range(1, 11)
    ]
    up = [BallPose(centre_mm=(0.4, 0.2, BALL_MM - d), turn_rad=0.05) for d in np.linspace(0.6, -0.05, 8)]
    poses = [*still, *down, *aside, *up]
    return KnownGel(block, pressed(block, poses, radius_mm=BALL_MM, friction=FRICTION))


def drawn(block: GelBlock, rng: np.random.Generator) -> KnownGel:
    """A press at random: down, aside and up in eighteen frames."""
    radius_mm, across_mm = 8 * 3.75 ** rng.uniform(), rng.uniform(2.0, 4.2)
    depth_mm = across_mm**2 / (2 * radius_mm)
    x, y = rng.uniform(-0.8, 0.8, 2)
    way, aside_mm, turn = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.5), rng.uniform(-0.06, 0.06)

    def pose(depth: float, share: float) -> BallPose:
        at = (x + share * aside_mm * np.cos(way), y + share * aside_mm * np.sin(way), radius_mm - depth)
        return BallPose(centre_mm=at, turn_rad=share * turn)

    down = [pose(depth, 0.0) for depth in np.linspace(0.05, depth_mm, 7)]
    aside = [pose(depth_mm, share) for share in (0.25, 0.5, 0.75, 1.0)]
    up = [pose(depth_mm * share, 1.0) for share in (0.75, 0.5, 0.25)]
    poses = [pose(-0.05, 0.0)] * 4 + down + aside + up
    print(f"ball of {radius_mm:.1f} mm, {depth_mm:.2f} mm deep, {aside_mm:.2f} mm aside")
    return KnownGel(block, pressed(block, poses, radius_mm=radius_mm, friction=rng.uniform(0.3, 1.0)))


def camera(turn_rad: float, *, distance_mm: float, focal_px: float) -> GelCamera:
    """A camera `distance_mm` behind the gel's centre, turned about y and looking at it."""
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    pose = np.eye(4)
    pose[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
    pose[:3, 3] = -distance_mm * pose[:3, 2]
    return GelCamera(
        image_px=(640, 480),
        focal_px=(focal_px, focal_px + 2),
        centre_px=(322.0, 237.0),
        distortion=LENS,
        gel_from_camera=pose,
    )


def sensor(kind: str) -> Sensor:
    """One of the two sensors."""
    first_camera, second_camera = camera(0.0, distance_mm=22.0, focal_px=760.0), None
    if kind == "markers-stereo":
        first_camera, second_camera = (camera(t, distance_mm=24.0, focal_px=740.0) for t in (0.35, -0.35))
    return Sensor(
        kind=kind,  # type: ignore[arg-type]
        name=f"rendered {kind}",
        camera=first_camera,
        second_camera=second_camera,
        thickness_mm=THICKNESS_MM,
        E_MPa=E_MPA,
        nu=NU,
        outline=OUTLINE,
        rest_mm=GRID,
    )


def tracked(eye: GelCamera, images: list[np.ndarray], reference: np.ndarray) -> tuple[TrackedMarkers, float]:
    """The grid's markers through the images, and CPU seconds per frame."""
    start = reference_of(reference, source="reference")
    centre_px = start.markers.centre_px
    _, which = cKDTree(on_face(eye, centre_px)[:, :2]).query(GRID[:, :2])
    began = time.process_time()
    frames = list(follow(start, images))
    spent = (time.process_time() - began) / len(images)
    return TrackedMarkers(
        time_s=np.arange(len(images)) / 30.0,
        reference_px=centre_px[which],
        position_px=np.stack([frame.position_px[which] for frame in frames]),
        rest_mm=GRID,
    ), spent


def rendered(eye: GelCamera, shapes: list[Field], rng: np.random.Generator) -> list[np.ndarray]:
    """What this camera sees of every shape, and of the untouched gel at last."""
    look = GelLook(rest_mm=GRID)
    return [gel_image(eye, (), look, shape, rng) for shape in (*shapes, lambda at: np.zeros((len(at), 3)))]


def measured(
    kind: str,
    known: KnownGel,
    rng: np.random.Generator,
    *,
    outline: GelOutline | None = OUTLINE,
    distance: float = 1.0,
) -> tuple[GelFields, float]:
    """Render, track and invert; the fields, and CPU seconds per frame.

    `distance`: factor on the camera's distance, and on its focal length, that is taken for the true one.
    """
    gel_sensor = replace(sensor(kind), outline=outline)
    block = known.block

    def shape_of(press: Pressed) -> Field:
        return smooth_field(block.x_mm, block.y_mm, press.displacement_mm)

    shapes = [shape_of(press) for press in known.frames]
    eye = gel_sensor.camera
    assert eye is not None
    *images, reference = rendered(eye, shapes, rng)
    markers, spent = tracked(eye, images, reference)
    kept = np.isfinite(markers.position_px[..., 0]).mean()
    print(f"{kind}: {100 * kept:.2f} % of markers followed, {1e3 * spent:.1f} ms of CPU a frame")
    if distance != 1.0:
        pose = eye.gel_from_camera.copy()
        pose[:3, 3] *= distance
        focal = distance * eye.focal_px[0], distance * eye.focal_px[1]
        gel_sensor = replace(gel_sensor, camera=replace(eye, focal_px=focal, gel_from_camera=pose))
    second = None
    if gel_sensor.second_camera is not None:
        *others, untouched = rendered(gel_sensor.second_camera, shapes, rng)
        second, more = tracked(gel_sensor.second_camera, others, untouched)
        spent += more
    chosen = fields_of(gel_sensor, markers, second=second)
    began = time.process_time()
    before = None
    for moved in chosen.displacement_mm:
        for _ in range(1 + DEPTH_ROUNDS if kind == "markers-mono" else 1):
            contact = chosen.solver.solve(moved, before=before)
            before = contact.touching
    return chosen, spent + (time.process_time() - began) / len(images)


def row(kind: str, fields: GelFields, known: KnownGel, seconds: float) -> dict[str, object]:
    """The table's row; the peak is the frame of greatest force."""
    block, at = known.block, GRID[:, :2]
    true_u = np.stack([smooth_field(block.x_mm, block.y_mm, p.displacement_mm)(at) for p in known.frames])
    traction = [p.force_N / block.weights_mm2[:, None] for p in known.frames]
    true_f = np.stack([block.at(t, at) for t in traction]) * fields.solver.grid.cell_mm2
    total = np.stack([p.force_N.sum(axis=0) for p in known.frames])
    miss_u = 1e3 * (fields.displacement_mm - true_u)
    miss_total = np.linalg.norm(fields.force_N.sum(axis=1) - total, axis=1)
    size = np.linalg.norm(total, axis=1)
    peak, loaded = int(np.argmax(size)), size > 0.1 * size.max()

    def rms(values: np.ndarray) -> float:
        return float(np.sqrt(np.nanmean(values**2)))

    def correlation(forces: np.ndarray, true_forces: np.ndarray) -> float:
        return float(np.corrcoef(forces.ravel(), true_forces.ravel())[0, 1])

    return {
        "sensor": kind,
        "frames": len(size),
        "plane_um_peak": rms(miss_u[peak, :, :2]),
        "plane_um_all": rms(miss_u[..., :2]),
        "depth_um_peak": rms(miss_u[peak, :, 2]),
        "depth_um_all": rms(miss_u[..., 2]),
        "force_percent_peak": 100 * miss_total[peak] / size[peak],
        "force_percent_all": 100 * rms(miss_total[loaded] / size[loaded]),
        "correlation_peak": correlation(fields.force_N[peak], true_f[peak]),
        "correlation_all": correlation(fields.force_N[loaded], true_f[loaded]),
        "frames_per_s": 1.0 / seconds,
    }


def print_draws(block: GelBlock, count: int, rng: np.random.Generator) -> None:
    """Dots alone under presses at random: median and worst of every column, outline said and not."""
    rows: dict[GelOutline | None, list[dict[str, object]]] = {OUTLINE: [], None: []}
    for press in [drawn(block, rng) for _ in range(count)]:
        for outline, table_rows in rows.items():
            fields, seconds = measured("markers-mono", press, np.random.default_rng(5), outline=outline)
            table_rows.append(row("markers-mono", fields, press, seconds))
    for outline, table_rows in rows.items():
        table = pd.DataFrame(table_rows).iloc[:, 2:-1].agg(["min", "median", "max"]).T
        print(f"{outline}:\n{table.to_string(float_format='{:.3g}'.format)}")


def main(
    out: Path | None = None,
    keep: Path | None = None,
    draws: int = 0,
    seed: int = 0,
    distance: float = 1.0,
    only: str | None = None,
) -> None:
    """Measure both sensors and print the table."""
    rows: list[dict[str, object]] = []
    with threadpool_limits(1):
        known = truth(keep)
        if draws:
            print_draws(known.block, draws, np.random.default_rng(seed))
            return
        for kind in ("markers-stereo", "markers-mono"):
            if only in (None, kind):
                fields, seconds = measured(kind, known, np.random.default_rng(5), distance=distance)
                print(fields.hyperparameters)
                rows.append(row(kind, fields, known, seconds))
                print(
                    pd.DataFrame(rows[-1:]).T.to_string(header=False, float_format="{:.3f}".format),
                    flush=True,
                )
    if out is not None:
        pd.DataFrame(rows).to_csv(out, index=False, float_format="%.4g")


if __name__ == "__main__":
    run(main)
