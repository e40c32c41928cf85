"""Meshes for the independent solver: graded bricks where everything is a box, tetrahedra where it is not.

A specimen is a box around a rigid core; mirror planes through the origin cut it down to the part that is
solved. `bricks` needs NumPy alone. `tetrahedra` needs gmsh (GPL, never needed by the product itself).
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A square of a face of the box: the face's axis and side (+1, -1), its centre (3), its edge length."""

    axis: int
    side: int
    centre_mm: tuple[float, float, float]
    edge_mm: float

    def holds(self, points_mm: np.ndarray) -> np.ndarray:
        """Which points lie on the patch, rim included."""
        across = [k for k in range(3) if k != self.axis]
        off = np.abs(points_mm - np.array(self.centre_mm))
        return (off[:, across].max(axis=1) < self.edge_mm / 2 + 1e-6) & (off[:, self.axis] < 1e-6)


@dataclass(frozen=True, kw_only=True)
class Core:
    """A rigid core; `size_mm` is a ball's radius or a cube's edge; polyhedra have the volume of that cube."""

    shape: str
    size_mm: float
    centre_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Specimen:
    """The box [low, high], its core, the axes whose mirror plane is used, and the patches on its faces."""

    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    core: Core
    mirrors: tuple[int, ...]
    patches: tuple[Patch, ...]
    base_fixed: bool


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Nodes, elements (C3D20 or C3D10 order, from 0), and the sorted nodes of the core's surface."""

    nodes_mm: np.ndarray
    elements: np.ndarray
    core_nodes: np.ndarray = field(repr=False)

    @property
    def edges(self) -> np.ndarray:
        """Rows of two corners and the node between them."""
        if self.elements.shape[1] == 20:
            ring = [(0, 1), (1, 2), (2, 3), (3, 0)]
            pairs = ring + [(a + 4, b + 4) for a, b in ring] + [(a, a + 4) for a in range(4)]
        else:
            pairs = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
        first = self.elements.shape[1] - len(pairs)
        rows = [self.elements[:, [a, b, first + k]] for k, (a, b) in enumerate(pairs)]
        edges = np.concatenate(rows)
        return np.unique(np.column_stack([np.sort(edges[:, :2], axis=1), edges[:, 2]]), axis=0)


def solved_box(specimen: Specimen) -> tuple[np.ndarray, np.ndarray]:
    """The corners of the part that is left when the mirror planes have cut the box."""
    low, high = np.array(specimen.low_mm), np.array(specimen.high_mm)
    low[list(specimen.mirrors)] = 0.0
    return low, high


def graded(
    marks: dict[float, float], through: np.ndarray, low: float, high: float, *, growth: float, largest: float
) -> np.ndarray:
    """Grid lines from low to high through every mark and through those further places.

    Beside a mark the spacing is its own, then grows.
    """
    places = np.concatenate([[low, high], list(marks), through])
    at = np.unique(places[(places >= low) & (places <= high)].round(9))
    fine = np.array(list(marks)), np.array(list(marks.values()))

    def spacing(x: float) -> float:
        return min(largest, float(np.min(fine[1] + growth * np.abs(fine[0] - x))))

    lines = [low]
    for a, b in pairwise(at):
        x = np.linspace(a, b, 2001)
        count = np.concatenate([[0], np.cumsum(np.diff(x) / [spacing(m) for m in (x[1:] + x[:-1]) / 2])])
        n = max(1, int(np.ceil(count[-1] - 1e-9)))
        lines += list(np.interp(np.linspace(0, count[-1], n + 1)[1:], count, x))
    return np.array(lines)


def bricks(specimen: Specimen, *, rim_mm: float, growth: float, largest_mm: float) -> Mesh:
    """Quadratic bricks on a tensor grid graded towards the patch's rim; the core is a box.

    A line runs at every tenth of the patch, so that forces go to markers there without interpolation.
    """
    low, high = solved_box(specimen)
    centre, half = np.array(specimen.core.centre_mm), specimen.core.size_mm / 2
    lines = []
    for axis in range(3):
        marks = {float(centre[axis] + s * half): largest_mm / 2 for s in (-1, 1)}
        through = np.empty(0)
        for patch in specimen.patches:
            for s in (-1, 1) if axis != patch.axis else (0,):
                marks[patch.centre_mm[axis] + s * patch.edge_mm / 2] = rim_mm
            if axis != patch.axis:
                tenths = np.linspace(-0.5, 0.5, 11) * patch.edge_mm
                through = np.concatenate([through, patch.centre_mm[axis] + tenths])
        lines.append(graded(marks, through, low[axis], high[axis], growth=growth, largest=largest_mm))
    n = np.array([len(line) - 1 for line in lines])
    fine = [np.sort(np.concatenate([line, (line[1:] + line[:-1]) / 2])) for line in lines]
    cell = np.stack(np.meshgrid(*[np.arange(k) for k in n], indexing="ij"), axis=-1).reshape(-1, 3)
    middle = np.column_stack([fine[k][2 * cell[:, k] + 1] for k in range(3)])
    cell = cell[~(np.abs(middle - centre) < half).all(axis=1)]
    ring = [(0, 0), (1, 0), (1, 1), (0, 1)]
    between = [(1, 0), (2, 1), (1, 2), (0, 1)]
    offset = [(2 * i, 2 * j, 2 * k) for k in (0, 1) for i, j in ring]
    offset += [(i, j, 2 * k) for k in (0, 1) for i, j in between] + [(2 * i, 2 * j, 1) for i, j in ring]
    lattice = 2 * cell[:, None] + np.array(offset)
    number = lattice @ np.array([(2 * n[1] + 1) * (2 * n[2] + 1), 2 * n[2] + 1, 1])
    used, elements = np.unique(number, return_inverse=True)
    index = np.unravel_index(used, tuple(2 * n + 1))
    nodes = np.column_stack([fine[k][index[k]] for k in range(3)])
    inside = np.flatnonzero((np.abs(nodes - centre) < half + 1e-6).all(axis=1))
    return Mesh(nodes_mm=nodes, elements=elements.reshape(number.shape), core_nodes=inside)


def polyhedron(core: Core) -> tuple[np.ndarray, np.ndarray]:
    """Corners and outward triangles of a cube, a tetrahedron or a star of the core cube's volume.

    Tetrahedron: two opposite edges level, along x (above) and y (below). Star: Kepler's stella octangula,
    two tetrahedra through each other, its eight points towards the corners of a cube.
    """
    volume = core.size_mm**3
    cube = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    if core.shape == "cube":
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = [(a, b, c) for a, b, c, d in quads] + [(a, c, d) for a, b, c, d in quads]
        corners, scale = cube, (volume / 8) ** (1 / 3)
    elif core.shape == "tetrahedron":
        r = np.sqrt(2)
        corners = np.array([(r, 0, 1), (-r, 0, 1), (0, r, -1), (0, -r, -1)])
        faces = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
        scale = (volume / (8 / 3)) ** (1 / 3)
    elif core.shape == "star":
        tips = cube
        hubs = np.array([(s * (k == 0), s * (k == 1), s * (k == 2)) for k in range(3) for s in (-1, 1)])
        corners = np.vstack([tips, hubs])
        faces = []
        for t, tip in enumerate(tips):
            near = [8 + 2 * k + int(tip[k] > 0) for k in range(3)]
            faces += [(t, near[i], near[(i + 1) % 3]) for i in range(3)]
        scale = (volume / 4) ** (1 / 3)
    else:
        raise ValueError(f"found the core shape {core.shape}, expected cube, tetrahedron or star")
    corners = scale * corners
    turned = [
        face
        if np.dot(np.cross(*(corners[list(face[1:])] - corners[face[0]])), corners[list(face)].sum(0)) > 0
        else face[::-1]
        for face in faces
    ]
    return corners + np.array(core.centre_mm), np.array(turned)


def tetrahedra(specimen: Specimen, *, rim_mm: float, growth: float, largest_mm: float) -> Mesh:
    """Quadratic tetrahedra by gmsh, graded towards the patch's rim and the core; a ball's are curved."""
    import gmsh

    low, high = solved_box(specimen)
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    box = occ.addBox(*low, *(high - low))
    core = specimen.core
    if core.shape == "ball":
        inner = [(3, occ.addSphere(*core.centre_mm, core.size_mm))]
    else:
        corners, faces = polyhedron(core)
        points = [occ.addPoint(*c) for c in corners]
        pairs = {tuple(sorted((f[i], f[i - 1]))) for f in faces for i in range(3)}
        curve = {pair: occ.addLine(points[pair[0]], points[pair[1]]) for pair in pairs}
        skin = [
            occ.addPlaneSurface(
                [occ.addCurveLoop([curve[tuple(sorted((int(f[i]), int(f[(i + 1) % 3]))))] for i in range(3)])]
            )
            for f in faces
        ]
        inner = [(3, occ.addVolume([occ.addSurfaceLoop(skin)]))]
    flesh, _ = occ.cut([(3, box)], inner)
    squares = []
    for patch in specimen.patches:
        across = [k for k in range(3) if k != patch.axis]
        first, last = np.array(patch.centre_mm), np.array(patch.centre_mm)
        first[across] = np.maximum(first[across] - patch.edge_mm / 2, low[across])
        last[across] = np.minimum(last[across] + patch.edge_mm / 2, high[across])
        ring = []
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
            corner = first.copy()
            corner[across[0]] = (first, last)[a][across[0]]
            corner[across[1]] = (first, last)[b][across[1]]
            ring.append(occ.addPoint(*corner))
        sides = [occ.addLine(ring[k], ring[(k + 1) % 4]) for k in range(4)]
        squares.append((2, occ.addPlaneSurface([occ.addCurveLoop(sides)])))
    flesh, _ = occ.fragment(flesh, squares)
    occ.synchronize()
    rims, skins = [], []
    for _, tag in gmsh.model.getEntities(1):
        ends = np.array(gmsh.model.getBoundingBox(1, tag)).reshape(2, 3)
        for patch in specimen.patches:
            across = [k for k in range(3) if k != patch.axis]
            off = np.abs(ends - np.array(patch.centre_mm))
            on_rim = (np.abs(off[:, across] - patch.edge_mm / 2) < 1e-4).all(axis=0).any()
            same = (np.ptp(ends[:, across], axis=0) < 1e-4) & (
                np.abs(off[0, across] - patch.edge_mm / 2) < 1e-4
            )
            if off[:, patch.axis].max() < 1e-4 and on_rim and same.any():
                rims.append(tag)
    for _, tag in gmsh.model.getEntities(2):
        ends = np.array(gmsh.model.getBoundingBox(2, tag)).reshape(2, 3)
        on_face = (np.ptp(ends, axis=0) < 1e-4).any() and (
            (np.abs(ends - low) < 1e-4).all(axis=0) | (np.abs(ends - high) < 1e-4).all(axis=0)
        ).any()
        if not on_face:
            skins.append(tag)
    fields = gmsh.model.mesh.field
    sizes = []
    for kind, tags, size in (("CurvesList", rims, rim_mm), ("SurfacesList", skins, largest_mm / 2)):
        distance = fields.add("Distance")
        fields.setNumbers(distance, kind, tags)
        fields.setNumber(distance, "Sampling", 100)
        math = fields.add("MathEval")
        fields.setString(math, "F", f"min({size} + {growth}*F{distance}, {largest_mm})")
        sizes.append(math)
    smallest = fields.add("Min")
    fields.setNumbers(smallest, "FieldsList", sizes)
    fields.setAsBackgroundMesh(smallest)
    for name in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
        gmsh.option.setNumber(f"Mesh.{name}", 0)
    gmsh.option.setNumber("Mesh.Algorithm3D", 1)
    gmsh.option.setNumber("Mesh.HighOrderOptimize", 2)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("Netgen")
    gmsh.model.mesh.setOrder(2)
    tags, xyz, _ = gmsh.model.mesh.getNodes()
    kinds, _, connectivity = gmsh.model.mesh.getElements(3)
    (tets,) = [np.array(c).reshape(-1, 10) for k, c in zip(kinds, connectivity, strict=True) if k == 11]
    on_core = np.unique(
        np.concatenate([gmsh.model.mesh.getNodes(2, s, includeBoundary=True)[0] for s in skins])
    )
    gmsh.finalize()
    used, elements = np.unique(tets, return_inverse=True)
    row = np.full(int(tags.max()) + 1, -1)
    row[tags.astype(int)] = np.arange(len(tags))
    nodes = xyz.reshape(-1, 3)[row[used.astype(int)]]
    elements = elements.reshape(tets.shape)[:, [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]]
    return Mesh(nodes_mm=nodes, elements=elements, core_nodes=np.flatnonzero(np.isin(used, on_core)))
