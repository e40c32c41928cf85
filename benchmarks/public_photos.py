"""The photo route on public photographs of real objects: held-out silhouettes and published sizes.

    python benchmarks/public_photos.py FOLDER --format middlebury|vgg [--views 24] [--mesh OUT]
    python benchmarks/public_photos.py FOLDER --format board --board duplo|bear [--views 24] [--mesh OUT]

middlebury: a folder of dino, dinoRing, dinoSparseRing, temple, ... (vision.middlebury.edu/mview/data) with
its *_par.txt. vgg: viff.*.ppm with dino_Ps.mat, or image_*.jpg with viff.xml. board: a checkout of the
repository that benchmarks/public_sets.py names. None of these data are shipped.

With published cameras and masks by colour (benchmarks/public_sets.py), --views of the photos, spread around
the object, go through recon's outlines, hull, settled surface and closed mesh; all others are held out. One
row a stage: overlap of mesh and mask there (intersection over union), distance between their rims (px:
median, 95 %, and the mean, outward positive), the box of the mesh less the published one. `grid` is the same
hull on a grid of 128 cells without recon's ray from the centre: what the silhouettes allow for a shape that
is not star-shaped.

A board goes the product's whole way too (`reconstruct`, with the board as its mat); a crash or a refusal is a
row with its sentence. The Duplo brick of one board has a known shape: it is placed, turned and scaled (the
board's unit is not published) so that its rims lie on the masks of all photos, and each mesh is compared with
it in mm, sides and top apart; the row `true brick` is what masks and poses leave of it. Its flat top cannot
come from silhouettes seen from above alone: hulls rise over it.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv
from public_sets import (
    BOARDS,
    Board,
    PublicSet,
    View,
    board_photos,
    brick,
    brick_points,
    middlebury,
    red_mask,
    spread,
    vgg,
    whole,
)
from recon_score import signed_distance_mm
from scipy.optimize import minimize
from shape_agreement import Mesh, agreement, rims

from recon.cameras.camera import Camera, straightened
from recon.cameras.mat_poses import cameras_from_mat
from recon.cameras.photos import Photo
from recon.fruit_mesh import closed_surface, reconstruct
from recon.recon_failure import ReconFailure
from recon.silhouettes.hull import Silhouette, ball, silhouette_of_mask, split, visual_hull
from recon.silhouettes.mask import Window
from recon.silhouettes.outline import outline_of, sharpened, silhouette_of_outline
from recon.silhouettes.tangent import fitted_to_outlines
from recon.stage_clock import one_thread
from recon.surface.mesh_file import write_mesh
from recon.triangle_mesh import vertex_normals

GRID = 128
LEVEL, FIT_LEVEL = 6, 5
OUTLIER_SHARE = 0.03
MAX_FACES = 6000
"""Levels of the ball, share of views that may be wrong, faces: as in recon.silhouettes.all_views and
ReconOptions."""


def grid_hull(
    silhouettes: Sequence[Silhouette], low: np.ndarray, high: np.ndarray
) -> tuple[Mesh, np.ndarray]:
    """Where the least depth inside all cones is nought, on a grid; and the middle of the cells inside.

    Every view holds the object whole, so that what a window does not show is outside.
    """
    for cells in (GRID // 2, GRID):
        step = float((high - low).max()) / cells
        shape = np.ceil((high - low) / step).astype(int) + 1
        points = low + np.indices(shape).reshape(3, -1).T * step
        phi = np.full(len(points), np.inf)
        for s in silhouettes:
            at = s.window.into_small(s.camera.project(points))
            shown = ((at >= 0) & (at <= np.array(s.window.small_size_px) - 1)).all(1)
            phi = np.minimum(phi, np.where(shown, s.depth_mm(points), -step))
        if not (phi > 0).any():
            raise SystemExit("No point lies inside all silhouettes: cameras and masks do not fit.")
        low = np.maximum(points[phi > 0].min(0) - 2 * step, low)
        high = points[phi > 0].max(0) + 2 * step
    image = pv.ImageData(dimensions=tuple(shape.tolist()), spacing=(step,) * 3, origin=tuple(points[0]))
    image.point_data["phi"] = -phi.reshape(shape).ravel(order="F")
    surface = image.contour([0.0], scalars="phi").extract_largest().triangulate()
    vertices, faces = np.asarray(surface.points, float), surface.faces.reshape(-1, 4)[:, 1:]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    if np.einsum("ij,ij->", a - points.mean(0), np.cross(b, c)) < 0:
        faces = faces[:, ::-1]
    return (vertices, faces), points[phi > 0].mean(0)


def around(views: Sequence[View]) -> tuple[np.ndarray, np.ndarray]:
    """A box that holds the object: about where the rays through the masks' middles meet, and 1.5 times as
    wide as the widest mask.
    """
    A, b = np.zeros((3, 3)), np.zeros(3)
    for v in views:
        pixel = np.argwhere(v.mask)[:, ::-1].mean(0) + v.window.corner_px
        ray = v.camera.cam_from_world[:3, :3].T @ np.linalg.inv(v.camera.intrinsics) @ [*pixel, 1.0]
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        A, b = A + across, b + across @ v.camera.place
    middle = np.linalg.solve(A, b)
    widest = max(
        float(np.ptp(np.argwhere(v.mask), axis=0).max())
        * v.camera.into(middle[None])[0, 2]
        / v.camera.focal_px
        for v in views
    )
    return middle - 0.75 * widest, middle + 0.75 * widest


def stages(views: Sequence[View], *, floor_mm: float | None) -> Iterator[tuple[str, Mesh]]:
    """The mesh after each stage of recon, from masks by colour; the last is left out where it stays open."""
    masks = [silhouette_of_mask(v.mask, v.window, v.camera) for v in views]
    low, high = around(views)
    if floor_mm is not None:
        low[2] = floor_mm
    mesh, centre = grid_hull(masks, low, high)
    yield "grid", mesh
    longest = float(np.linalg.norm(high - low))

    def hull(silhouettes: Sequence[Silhouette], level: int) -> Mesh:
        return visual_hull(
            silhouettes,
            centre_mm=centre,
            longest_mm=longest,
            floor_mm=floor_mm,
            level=level,
            outlier_share=OUTLIER_SHARE,
        )

    yield "hull of masks", hull(masks, LEVEL)
    outlines = [_sharp(v) for v in views]
    yield "hull", hull(outlines, LEVEL)
    coarse = hull(outlines, FIT_LEVEL)
    found = fitted_to_outlines(*coarse, outlines, floor_mm=floor_mm)
    vertices, faces = split(found.vertices, FIT_LEVEL, LEVEL), ball(LEVEL)[1]
    yield "settled", (vertices, faces)
    try:
        closed = closed_surface(vertices, vertex_normals(vertices, faces), max_faces=MAX_FACES)
    except ReconFailure as failure:
        print(f"{'closed':14} {failure}")
        return
    yield "closed", (closed.vertices, closed.faces)


def main() -> int:
    """Prints the table; exit status 1 where the whole route gave no mesh of a board set."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--format", choices=("middlebury", "vgg", "board"), required=True)
    parser.add_argument("--board", choices=sorted(BOARDS))
    parser.add_argument("--views", type=int, default=24, help="photos used; the others are held out")
    parser.add_argument("--mesh", type=Path, help="folder for the mesh of each stage, PLY")
    options = parser.parse_args()
    if (options.format == "board") != (options.board is not None):
        parser.error("--board goes with --format board")
    with one_thread():
        if options.format == "board":
            return of_board(options.folder, BOARDS[options.board], options.views, options.mesh)
        read = middlebury if options.format == "middlebury" else vgg
        of_published_cameras(read(options.folder), options.views, options.mesh)
    return 0


def of_published_cameras(photos: PublicSet, count: int, out: Path | None) -> None:
    """Rows of a set with published cameras."""
    views = [v for v in photos.views if v.whole]
    used, held = parted(views, count)
    middle = np.mean(around(used), axis=0)
    scale = float(np.median([v.camera.into(middle[None])[0, 2] / v.camera.focal_px for v in used]))
    print(
        f"{len(photos.views)} photos, {len(views)} with the object whole and well lit; {len(used)} used, "
        f"{len(held)} held out; 1 px is {scale:.3g} {photos.unit} at the object"
    )
    if photos.box is not None:
        print(f"published box: {_triple(photos.box[0])} to {_triple(photos.box[1])} mm")
    for name, mesh in stages(used, floor_mm=None):
        line = rims(name, mesh, held)
        if photos.box is not None:
            away = np.stack([mesh[0].min(0), mesh[0].max(0)]) - photos.box
            line += f"  low {_triple(away[0])} high {_triple(away[1])} size {_triple(away[1] - away[0])} mm"
        else:
            line += f"  size {_triple(np.ptp(mesh[0], axis=0))} {photos.unit}"
        print(line, flush=True)
        _keep(out, name, mesh)


def of_board(folder: Path, board: Board, count: int, out: Path | None) -> int:
    """Rows of a board set: the stages from masks by colour where the object is red, then the whole route."""
    photos, mat = board_photos(folder, board), board.mat()
    poses = cameras_from_mat(photos, mat)
    lens = poses.cameras[0]
    print(
        f"{len(photos)} photos, {len(poses.used)} placed by the board ({mat.dictionary}, tags "
        f"{mat.tag_mm:.2f} mm): {poses.reprojection_px:.2f} px, focal length {lens.focal_px:.0f} ± "
        f"{poses.focal_sd_px:.1f} px, k1 {lens.k1:+.4f}, scale ± {100 * poses.scale_sd:.2f} %"
    )
    chosen = [photos[i] for i in poses.used.tolist()]
    if not board.brick:
        return _whole_route("whole route", chosen, board, [], None, out)
    views = [v for v in (_red_view(p, c) for p, c in zip(chosen, poses.cameras, strict=True)) if v.whole]
    used, held = parted(views, count)
    truth = placed_brick(views)
    print(
        f"{len(used)} used, {len(held)} held out; the brick fits with a unit of "
        f"{board.unit_mm / truth.scale:.3f} mm"
    )
    print(rims("true brick", truth.mesh(), held))
    for name, mesh in stages(used, floor_mm=0.0):
        print(rims(name, mesh, held), _distances(mesh, truth), flush=True)
        _keep(out, name, mesh)
    names = {v.camera.name for v in used}
    some = [p for p in chosen if p.name in names]
    some_failed = _whole_route("whole route", some, board, held, truth, out)
    all_failed = _whole_route("whole, all", chosen, board, held, truth, out)
    return max(some_failed, all_failed)


@dataclass(frozen=True)
class PlacedBrick:
    """Where the brick stands on a board, and how many of the board's mm its own are."""

    x_mm: float
    y_mm: float
    turn_deg: float
    scale: float

    def into_board(self, points: np.ndarray) -> np.ndarray:
        """Points of the brick's frame in the board's."""
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        return np.asarray(self.scale * points @ turn.T + [self.x_mm, self.y_mm, 0.0])

    def mesh(self) -> Mesh:
        """The true brick in the board's frame."""
        vertices, faces = brick()
        return self.into_board(vertices), faces


def placed_brick(views: Sequence[View]) -> PlacedBrick:
    """Place, turn and scale of the brick for which its rims lie on the masks', by Nelder and Mead."""
    cut = [_cut(v) for v in views]
    low, high = around(views)
    middle = (low + high) / 2

    def miss(p: np.ndarray) -> float:
        return agreement(PlacedBrick(*p).mesh(), cut).mean_px

    starts = [np.array([*middle[:2], turn, 1.0]) for turn in (0.0, 22.5, 45.0, 67.5)]
    start = min(starts, key=miss)
    simplex = start + np.concatenate([np.zeros((1, 4)), np.diag([3.0, 3.0, 10.0, 0.05])])
    found = minimize(
        miss, start, method="Nelder-Mead", options={"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3}
    )
    return PlacedBrick(*found.x.tolist())


def _cut(view: View) -> View:
    """The view's window cut to its mask and half as much around."""
    rows, columns = (np.flatnonzero(view.mask.any(axis)) for axis in (1, 0))
    grow = max(np.ptp(rows), np.ptp(columns)) // 2
    y0, y1 = max(rows[0] - grow, 0), rows[-1] + grow
    x0, x1 = max(columns[0] - grow, 0), columns[-1] + grow
    at = (view.window.corner_px[0] + int(x0), view.window.corner_px[1] + int(y0))
    return View(
        Window(view.window.image[y0:y1, x0:x1], at, 1), view.camera, view.mask[y0:y1, x0:x1], view.whole
    )


def parted(views: Sequence[View], count: int) -> tuple[list[View], list[View]]:
    """Views used, spread around the object, and views held out."""
    at = spread([v.camera.place for v in views], count)
    return [views[i] for i in at], [v for i, v in enumerate(views) if i not in at]


def _whole_route(
    name: str,
    photos: list[Photo],
    board: Board,
    held: Sequence[View],
    truth: PlacedBrick | None,
    out: Path | None,
) -> int:
    start = time.perf_counter()
    try:
        made = reconstruct(photos, mat=board.mat(), height_mm=None)
    except Exception as error:  # noqa: BLE001 a crash is a result here
        print(f"{name:14} {len(photos)} photos: {type(error).__name__}: {error}", flush=True)
        return 1
    mesh, q = (made.vertices, made.faces), made.quality
    print(rims(name, mesh, held), _size(mesh) if truth is None else _distances(mesh, truth))
    print(
        f"{name:14} {q.views_used} of {q.views_given} photos, agreement {q.silhouette_iou:.3f}, outline "
        f"{q.outline_rms_mm:.2f} mm, clear {q.clear_outline_share:.2f}, relief {q.relief_share:.2f}, "
        f"{time.perf_counter() - start:.0f} s; {' '.join(made.warnings) or 'no warning'}",
        flush=True,
    )
    _keep(out, name, mesh)
    return 0


def _red_view(photo: Photo, camera: Camera) -> View:
    image, camera = straightened(photo, camera)
    mask = red_mask(image)
    return View(Window(image, (0, 0), 1), camera, mask, whole(mask))


def _sharp(view: View) -> Silhouette:
    outline = outline_of(view.mask)
    if outline is None:
        raise SystemExit(f"{view.camera.name}: no object in the mask.")
    fine, window = sharpened(outline, view.window)
    return silhouette_of_outline(fine, window, view.camera)


def _distances(mesh: Mesh, truth: PlacedBrick) -> str:
    """How far the true brick's sides and top are from the mesh, mm of the brick, outward positive; and the
    height of the mesh's lowest point over the board.
    """
    said = []
    for name, points in brick_points().items():
        away = -signed_distance_mm(truth.into_board(points), *mesh) / truth.scale
        said.append(f"{name} RMS {np.sqrt(np.mean(away**2)):.2f} outward {away.mean():+.2f}")
    return f"  {', '.join(said)}, lowest point {mesh[0][:, 2].min() / truth.scale:+.1f} mm"


def _size(mesh: Mesh) -> str:
    return f"  size {_triple(np.ptp(mesh[0], axis=0))} mm"


def _triple(values: np.ndarray, form: str = ".1f") -> str:
    return " ".join(f"{v:{form}}" for v in values)


def _keep(out: Path | None, name: str, mesh: Mesh) -> None:
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_mesh(out / f"{name.replace(', ', '-').replace(' ', '-')}.ply", *mesh)


if __name__ == "__main__":
    sys.exit(main())
