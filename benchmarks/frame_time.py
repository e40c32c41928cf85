"""Print how long a frame and a recording take once a fruit's compliance is condensed: 2 x 400 markers.

    python benchmarks/frame_time.py [--markers 400] [--frames 75]

A nectarine of 30 mm radius with a pit between two pads, each a grid of markers 1 mm apart, all of them in
contact at the peak; forces and places are made up by the model itself, since only the time matters here.
"""

import argparse
import resource
import time

import numpy as np
from scipy.spatial import ConvexHull

from fem.estimation.error_budget import ErrorBudget
from fem.estimation.grasp_model import grasp_model
from fem.estimation.live_modulus import FirstTouch, LiveModel, frame_modulus
from fem.estimation.modulus import estimate_modulus
from fem.grasp_history import GraspHistory, PadHistory
from fem.mesh.flesh_mesh import tetrahedralise
from fem.solid.linear_solid import UnitModulusSolid
from fem.solid.pad_link import contact_nodes

E_MPA, NU = 0.5, 0.45


def ellipsoid(points: int, semi_axes_mm: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """A closed surface on a spiral of points."""
    k = np.arange(points) + 0.5
    z, turn = 1 - 2 * k / points, np.pi * (1 + np.sqrt(5)) * k
    ring = np.sqrt(1 - z**2)
    unit = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
    faces = ConvexHull(unit).simplices.astype(np.int64)
    a, b, c = np.moveaxis(unit[faces], 1, 0)
    inward = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0
    faces[inward] = faces[inward][:, ::-1]
    return unit * np.asarray(semi_axes_mm), faces


def recording(markers: int, frames: int, rng: np.random.Generator) -> GraspHistory:
    """Two square pads at +-x; forces of a bowl that grows and shrinks again."""
    side = round(np.sqrt(markers))
    axis = np.arange(side) - (side - 1) / 2
    y, z = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    x = np.sqrt(30.0**2 - y**2 - z**2)
    air = 15
    load = np.concatenate([np.zeros(air), np.sin(np.linspace(0.1, np.pi - 0.1, frames - air))])
    pads = []
    for name, sign in (("left", -1.0), ("right", 1.0)):
        place = np.column_stack([sign * x, y, z])
        reach = np.maximum(load[:, None] * 1.05 - (y**2 + z**2) / (2 * axis.max() ** 2) / 1.2, 0.0)
        force = np.zeros((frames, len(place), 3))
        force[:, :, 0] = -sign * 0.08 * reach
        noise = rng.normal(size=force.shape) * 1e-3
        gel = -force / 0.2
        pads.append(
            PadHistory(
                name=name,
                rest_mm=np.column_stack([y, z, np.zeros(len(y))]),
                surface_mm=place,
                position_mm=place + 0.0 * gel,
                gel_displacement_mm=gel,
                force_N=force + noise,
                episode=np.where(reach > 0, 0, -1),
                displacement_sd_mm=0.004,
                force_sd_N=1e-3,
                lag1=0.0,
            )
        )
    return GraspHistory(time_s=np.arange(frames) / 30.0, phase=("load",) * frames, pads=tuple(pads))


def main() -> None:
    """Condense once, then time frames and recordings."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--markers", type=int, default=400)
    parser.add_argument("--frames", type=int, default=75)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    rng = np.random.default_rng(0)
    history = recording(args.markers, args.frames, rng)
    touched = np.vstack([pad.surface_mm for pad in history.pads])
    mesh = tetrahedralise(
        *ellipsoid(6000, (30.0, 30.0, 30.0)),
        *ellipsoid(3000, (13.0, 9.5, 15.5)),
        edge_mm=5.0,
        refine_at_mm=touched,
        refine_edge_mm=1.7,
    )
    nodes = contact_nodes(mesh, [history])
    times: dict[str, float] = {}

    def lap(name: str, started: float) -> None:
        times[name] = time.process_time() - started

    started = time.process_time()
    solid = UnitModulusSolid.factorise(mesh, poisson_ratio=NU, support="free", contact_nodes=nodes)
    lap("assembly and factorisation", started)
    started = time.process_time()
    _ = solid.contact_compliance
    lap(f"compliance of {3 * len(nodes)} contact dofs", started)
    started = time.process_time()
    model = grasp_model(history, solid)
    lap("model of the grasp with its sensitivities", started)
    force = np.concatenate([pad.force_N for pad in history.pads], axis=1)
    place = np.concatenate([pad.position_mm for pad in history.pads], axis=1)
    touching = np.concatenate([pad.episode >= 0 for pad in history.pads], axis=1)
    place = place + model.unit_displacement(force) / E_MPA + rng.normal(size=place.shape) * 0.004
    split = np.cumsum([len(pad.rest_mm) for pad in history.pads])[:-1]
    pads = tuple(
        PadHistory(**{**vars(pad), "position_mm": own})
        for pad, own in zip(history.pads, np.split(place, split, axis=1), strict=True)
    )
    seen = GraspHistory(time_s=history.time_s, phase=history.phase, pads=pads)
    whole = []
    for _ in range(args.repeats):
        started = time.process_time()
        found = estimate_modulus(seen, model, budget=ErrorBudget())
        whole.append(time.process_time() - started)
    live, before, single, estimates = LiveModel.of(model), FirstTouch.none(force.shape[1]), [], []
    for frame in range(args.frames):
        started = time.perf_counter()
        estimate, before = frame_modulus(
            live,
            before,
            position_mm=place[frame],
            force_N=force[frame],
            touching=touching[frame],
            sd_mm=0.004,
        )
        single.append(time.perf_counter() - started)
        estimates.append(estimate.E_MPa)
    peak = int(np.linalg.norm(force, axis=2).sum(axis=1).argmax())
    print(
        f"{3 * len(mesh.nodes_mm)} dofs, {force.shape[1]} markers, {touching.any(axis=0).sum()} of them touch"
    )
    for name, seconds in times.items():
        print(f"  {name:44s} {seconds:8.2f} s CPU")
    print(
        f"  {'one frame, median (longest)':44s} {1e3 * np.median(single):8.2f} ms ({1e3 * max(single):.2f})"
    )
    print(f"  {f'a recording of {args.frames} frames, median':44s} {np.median(whole):8.3f} s CPU")
    print(
        f"  E: injected {E_MPA}, frame at the peak {estimates[peak]:.4f}, recording {found.E_MPa:.4f} "
        f"+- {found.E_sd_MPa:.4f} MPa"
    )
    print(f"  peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    main()
