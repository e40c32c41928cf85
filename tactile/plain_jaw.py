"""One finger with a gel against a plain rigid jaw: the jaw's action on the fruit, as markers of a stiff gel.

A plain jaw has no sensor, but its action follows. Its force is the gel's, equal and opposite (the fruit is at
rest, its weight neglected). Its face is rigid, so that skin that touches it moves with it. It touches the
fruit's outermost point towards it. Pressure there is Hertz's, p ~ sqrt(1 - r^2/a^2), over a contact radius a.
For a force F on skin of mean radius R, a^3 = 3 F R / (4 E*) with E* = E / (1 - nu^2) (Johnson, "Contact
Mechanics", 1985, eq. 4.22). Until E is known, a = sqrt(R d) for the approach d on that side. The fruit's
approach f is the jaws' travel minus the gel's compression. Each side takes a share in inverse proportion to
its contact radius, d = f / (1 + a / a_gel). That is 10 to 20 % too wide, since a part of the approach lies
deeper in the fruit. E is 6 to 12 % too low with it (benchmarks/one_gel_finger.py).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from tactile.readers.recording import GelPad, IndenterPad, Recording, marker_area_mm2
from tactile.tactile_failure import TactileProblem

RIGID_MPA_PER_MM = 1000.0
"""Stiffness per area of a rigid face, normal and shear: no gel comes near it."""
PLACE_SD_MM = 0.01
"""Standard deviation of the face's place: of a machined jaw. Set by hand."""
PER_RADIUS = 6
"""Markers per contact radius. Set by hand: 113 then carry the pressure."""
BEYOND = 1.5
"""Contact radii up to which there are markers. Set by hand."""
FINEST_MM = 0.3
"""Least distance of markers. Set by hand."""
FITTED_MM = 8.0
"""Skin around the outermost point to which its radii are fitted, mm, on a fruit of 30 mm radius; scaled with
it."""
SUBSAMPLES = 5
"""Points along a marker's cell at which the pressure is averaged."""
IN_CONTACT = 0.05
"""Share of the greatest marker force, and of the peak force, above which there is contact. Set by hand."""
FIRST_FORCE = 0.01
"""Share of the peak force that counts as touch; the last frame below it is the first touch: by Hertz 5 % of
the greatest approach. Set by hand."""
DEEPEST = 0.95
"""Quantile of the pressed markers' compression used for the deepest: of a paraboloid it is 0.95 of it, and no
single marker's noise decides. Set by hand."""
LEAST_OWN = 0.1
"""Least share of the jaws' travel that the fruit takes. Set by hand."""
ROUNDS = 30
"""Iterations of the fixed point for the radius; each at least halves the error."""


def has_plain_jaw(recording: Recording) -> bool:
    """Whether one jaw has a gel and the other is a plate without markers."""
    gels = [pad for pad in recording.pads if isinstance(pad, GelPad)]
    plates = [pad for pad in recording.pads if isinstance(pad, IndenterPad) and pad.indenter == "plate"]
    return recording.loading == "grasp" and len(gels) == len(plates) == 1


def with_plain_jaw(
    recording: Recording,
    vertices: Float[np.ndarray, "v 3"],
    *,
    source: str,
    plane_strain_MPa: float | None = None,
) -> Recording:
    """The recording with a GelPad in the plain jaw's place; unchanged if there is no such jaw.

    `vertices`: the fruit's skin, fruit frame; `plane_strain_MPa`: E* of the flesh, if it is known. Raises
    TactileFailure (pads-off-fruit) if the jaw does not face the fruit.
    """
    if not has_plain_jaw(recording):
        return recording
    gel = next(pad for pad in recording.pads if isinstance(pad, GelPad))
    jaw = next(pad for pad in recording.pads if isinstance(pad, IndenterPad))
    on_fruit_N = np.einsum("tij,tj->ti", gel.pose[:, :3, :3], gel.force_N.sum(axis=1))
    force_N = -np.einsum("tji,tj->ti", jaw.pose[:, :3, :3], on_fruit_N)
    total = np.abs(gel.force_N[:, :, 2].sum(axis=1))
    peak = int(np.argmax(total))
    touch = max(int(np.argmax(total > FIRST_FORCE * total[peak])) - 1, 0)
    centre_mm, radius_mm = _outermost(vertices, jaw.pose[touch], source=f"{source}: pads/{jaw.name}")
    if plane_strain_MPa is None:
        approach_mm = _fruits_own_mm(recording, gel, touch)
        contact_mm = _contact_radius_mm(radius_mm, approach_mm, _gel_contact_mm(gel))
    else:
        of_force = np.cbrt(0.75 * np.maximum(force_N[:, 2], 0.0) * radius_mm / plane_strain_MPa)
        contact_mm = np.maximum(of_force, FINEST_MM)
    rest_mm, share = _pressure(centre_mm, contact_mm)
    pushed = np.where(force_N[:, 2] > 0, 1.0, 0.0)[:, None, None] * force_N[:, None, :] * share[..., None]
    stiff = GelPad(
        name=jaw.name,
        pose=jaw.pose,
        rest_mm=rest_mm,
        displacement_mm=np.zeros((len(force_N), len(rest_mm), 3)),
        force_N=pushed,
        gel_kn_MPa_per_mm=RIGID_MPA_PER_MM,
        gel_kt_MPa_per_mm=RIGID_MPA_PER_MM,
        place_sd_mm=PLACE_SD_MM,
        force_scale_sd=gel.force_scale_sd,
    )
    return replace(recording, pads=tuple(stiff if pad is jaw else pad for pad in recording.pads))


def _outermost(
    vertices: Float[np.ndarray, "v 3"], pose: Float[np.ndarray, "4 4"], *, source: str
) -> tuple[Float[np.ndarray, "2"], float]:
    """The fruit's point that the jaw's plane meets first (jaw frame, mm), and the skin's mean radius of
    curvature."""
    seen = (vertices - pose[:3, 3]) @ pose[:3, :3]
    first = seen[seen[:, 2].argmin()]
    size = float(np.ptp(seen, axis=0).mean())
    near = seen[np.linalg.norm(seen - first, axis=1) < FITTED_MM * size / 60.0]
    x, y = (near[:, :2] - first[:2]).T
    terms = np.column_stack([np.ones(len(near)), x, y, x * x / 2, x * y, y * y / 2])
    fit = np.linalg.lstsq(terms, near[:, 2], rcond=None)[0]
    bend = np.array([[fit[3], fit[4]], [fit[4], fit[5]]])
    curved = np.linalg.eigvalsh(bend)
    if len(near) < len(fit) or first[2] < -size / 2 or curved[0] <= 0:
        raise TactileProblem.PADS_OFF_FRUIT.failure(
            f"{source}: found a plain jaw without round skin in front of it, expected the fruit "
            "there. z of its pose must point into the fruit, and the mesh must be closed there. "
            "Correct the pose.",
        )
    apex = first[:2] - np.linalg.solve(bend, fit[1:3])
    return apex, float(np.prod(curved) ** -0.5)


def _fruits_own_mm(recording: Recording, gel: GelPad, touch: int) -> Float[np.ndarray, " t"]:
    """The fruit's whole approach: the jaws' travel since first touch minus the gel's compression on the axis
    of the grasp, where it is deepest.
    """
    closed = recording.aperture_mm[touch] - recording.aperture_mm
    compressed = np.where(_pressed(gel), -gel.displacement_mm[:, :, 2], np.nan)
    compressed[~_pressed(gel).any(axis=1), 0] = 0.0
    given = np.nanquantile(compressed, DEEPEST, axis=1)
    return np.asarray(np.maximum(closed - given, np.maximum(LEAST_OWN * closed, 0.0)))


def _pressed(gel: GelPad) -> np.ndarray:
    normal = gel.force_N[:, :, 2]
    greatest = normal.max(axis=1, keepdims=True)
    return np.asarray((normal > IN_CONTACT * greatest) & (greatest > IN_CONTACT * normal.max()))


def _gel_contact_mm(gel: GelPad) -> Float[np.ndarray, " t"]:
    """Radius of the gel's contact, as a circle of the area of its pressed markers."""
    area = marker_area_mm2(gel.rest_mm) or 1.0
    return np.asarray(np.sqrt(np.maximum(_pressed(gel).sum(axis=1), 1) * area / np.pi))


def _contact_radius_mm(
    radius_mm: float, approach_mm: Float[np.ndarray, " t"], gel_mm: Float[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """a = sqrt(R f / (1 + a / a_gel)), by a fixed-point iteration that at least halves the error in each
    step."""
    a = np.sqrt(radius_mm * approach_mm / 2)
    for _ in range(ROUNDS):
        a = np.sqrt(radius_mm * approach_mm / (1 + a / gel_mm))
    return np.asarray(np.maximum(a, FINEST_MM))


def _pressure(
    centre_mm: Float[np.ndarray, "2"], contact_mm: Float[np.ndarray, " t"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "t n"]]:
    """Markers around the centre, jaw frame, and each one's share of the force in each frame."""
    widest = float(contact_mm.max())
    pitch = max(widest / PER_RADIUS, FINEST_MM)
    line = pitch * np.arange(-np.ceil(BEYOND * widest / pitch), np.ceil(BEYOND * widest / pitch) + 1)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= BEYOND * widest]
    fine = pitch * ((np.arange(SUBSAMPLES) + 0.5) / SUBSAMPLES - 0.5)
    within = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    r2 = ((grid[:, None] + within) ** 2).sum(axis=-1)
    share = np.sqrt(np.maximum(1 - r2 / contact_mm[:, None, None] ** 2, 0.0)).mean(axis=2)
    share /= np.maximum(share.sum(axis=1, keepdims=True), 1e-12)
    return np.column_stack([grid + centre_mm, np.zeros(len(grid))]), share
