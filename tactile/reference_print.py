"""Whether a picture of a gel, above all its reference, shows that something is pressed into it.

There are two indicators, each over its detection limit. The first is the markers' bulge: the part of their
misfit to a regular lattice behind a smooth lens that neighbours share (tactile.markers.smooth_lattice).

The second is shading. A sloping face turns to one light and away from another. The ratio of a picture's
channels then changes within a fraction of the markers' spacing. Uneven light and a change of exposure do not
do so. The logarithm of each channel minus their mean is therefore compared with itself twice as blurred. A
pattern that repeats at every marker (its halo and rim) is subtracted: it is the median over markers at the
same place beside each. If all channels are equal (grey pictures), the logarithm itself is used.

With an imprint on the reference, every displacement lacks the imprint's own: a gel that is loaded throughout
then seems never to be touched.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial import cKDTree

from tactile.gel_camera import project
from tactile.markers.marker_detection import spacing_of
from tactile.markers.marker_lattice import lattice_of
from tactile.markers.smooth_lattice import FEWEST, coherent_misfit_px, fitted_lens, lattice_places
from tactile.markers.tracking import ReferenceMarkers, places_of, reference_of
from tactile.readers.pictures import refuse_saturated
from tactile.readers.raw_grasp import RawCamera, RawGrasp
from tactile.sensors import GelCamera, Sensor
from tactile.square_pixels import with_square_pixels
from tactile.tactile_failure import TactileFailure

SCALE = 0.2
"""Share of the markers' spacing: standard deviation of the finer blur. Of 0.1, 0.2 and 0.3 it separates most
first frames with an imprint from empty ones (benchmarks/gel_references.py FOLDER --half even)."""
HIDDEN_RADII, HIDDEN_SPACING = 1.5, 0.22
"""A marker hides the gel within this many of its radii, or this share of the spacing if that is more: lens
and codec blur its edge. Set by hand."""
RIM = 0.3
"""Width of the picture's edge, in spacings, where blurs see half. Set by hand."""
CELLS = 11
"""Places beside a marker, in each direction, that are distinguished: a ninth of the spacing each."""
CELL_SPAN = 1.3
"""Share of the spacing that they cover: the corners of a square between markers lie 0.71 from the nearest
one."""
DARKEST = 8.0
"""Grey levels: darker pixels count as this, whose noise of one level is an eighth. Set by hand."""
QUANTILE = 0.95
"""Over the pixels: an imprint on a twentieth of the face counts."""
GREY_TO = 1.0
"""Mean difference of the channels in grey levels, below which a picture is grey."""
LEAST_BULGE = 0.0085
"""Root mean square of the markers' shared misfit, in spacings. Of 39 empty first frames the largest is
0.0054, of four empty pictures of two more gels 0.0075. Of 120 with a visible imprint 88 have more
(benchmarks/gel_references.py FOLDER --half even; the four are of the clips of benchmarks/gel_video.py)."""
LEAST_SHADING = 0.055
"""As a relative change of colour: the same 43 have at most 0.049, 74 of the 120 more."""
SOMETHING, FLATTER = 0.7, 0.7
"""Multiple of the limit above which a reference may show an imprint, and share of it that remains later if
the imprint goes. The first frames of 39 empty gels show at most 0.64, four more pictures up to 0.88. Of 29
loaded ones that show less than 1, ten are found so (the same command)."""
SURE = 1.3
"""Multiple of the limit above which no modulus is computed: empty gels reach 0.89 of the limit."""

WHAT_TO_DO = (
    "name a picture or a clip of the empty gel (reference = ... in grasp.toml), or frames of it "
    "(reference_frames = [k, m])"
)
"""The end of every sentence about a reference that does not show an untouched gel."""


def print_shading(
    picture: UInt8[np.ndarray, "h w 3"],
    markers_px: Float[np.ndarray, "n 2"],
    *,
    spacing_px: float,
    disc_px: float,
) -> float:
    """Relative change of colour within a fraction of a spacing that a twentieth of the gel exceeds.

    `markers_px`: the markers' places in the picture, of radius `disc_px`. 0 if they hide all of the gel.
    """
    height, width = picture.shape[:2]
    light = np.log(np.maximum(cv2.GaussianBlur(picture, (0, 0), 1.0).astype(np.float32), DARKEST))
    grey = float(np.ptp(picture.astype(np.int16), axis=2).mean()) < GREY_TO
    colour = light[..., :1] if grey else light - light.mean(axis=2, keepdims=True)
    clear = np.ones((height, width), dtype=np.float32)
    hidden = round(max(HIDDEN_RADII * disc_px, HIDDEN_SPACING * spacing_px))
    for x, y in np.rint(markers_px[np.isfinite(markers_px[:, 0])]).astype(int).tolist():
        cv2.circle(clear, (x, y), hidden, 0.0, -1)
    detail = _blurred(colour, clear, SCALE * spacing_px) - _blurred(colour, clear, 2 * SCALE * spacing_px)
    rim = int(RIM * spacing_px)
    inner = np.zeros_like(clear)
    inner[rim : height - rim, rim : width - rim] = clear[rim : height - rim, rim : width - rim]
    rows, columns = np.nonzero(inner)
    if not len(rows):
        return 0.0
    excess = detail[rows, columns] - _usual(detail[rows, columns], rows, columns, markers_px, spacing_px)
    return float(np.quantile(np.linalg.norm(excess, axis=1), QUANTILE))


def _blurred(
    values: Float[np.ndarray, "h w c"], clear: Float[np.ndarray, "h w"], sigma: float
) -> Float[np.ndarray, "h w c"]:
    """Mean over the clear pixels around, by a Gaussian."""
    share = np.maximum(cv2.GaussianBlur(clear, (0, 0), sigma), 1e-6)
    total = cv2.GaussianBlur(values * clear[..., None], (0, 0), sigma).reshape(values.shape)
    return np.asarray(total / share[..., None])


def _usual(
    detail: Float[np.ndarray, "p c"],
    rows: np.ndarray,
    columns: np.ndarray,
    markers_px: Float[np.ndarray, "n 2"],
    spacing_px: float,
) -> Float[np.ndarray, "p c"]:
    """For each pixel, the median of `detail` over all pixels at the same offset from their nearest marker."""
    known = markers_px[np.isfinite(markers_px[:, 0])]
    place = np.stack([columns, rows], axis=1).astype(np.float64)
    offset = (place - known[np.asarray(cKDTree(known).query(place)[1])]) / (CELL_SPAN * spacing_px)
    cell = np.clip(np.floor((offset + 0.5) * CELLS), 0, CELLS - 1).astype(np.int64) @ [CELLS, 1]
    order = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[order], prepend=-1))
    usual = np.zeros((CELLS * CELLS, detail.shape[1]))
    for first, end in zip(starts, [*starts[1:], len(order)], strict=True):
        usual[cell[order[first]]] = np.median(detail[order[first:end]], axis=0)
    return np.asarray(usual[cell])


@dataclass(frozen=True, kw_only=True)
class ShownPrint:
    """Signs of an imprint in a picture, over the detection limit: by its markers and by its shading.

    `bulge` is nan if fewer than FEWEST markers are on a grid.
    """

    bulge: float
    shading: float

    @property
    def evidence(self) -> float:
        """The clearer of the two: 1 is the detection limit."""
        return float(np.nanmax([self.bulge, self.shading]))

    @property
    def seen_by(self) -> str:
        """What shows the imprint, as words of a sentence; empty if nothing does."""
        seen_by = [
            text
            for text, value in (
                ((f"its markers bulge ({100 * LEAST_BULGE * self.bulge:.1f} % of their spacing; empty "
f"gels stay below {100 * LEAST_BULGE:.2g} %)"), self.bulge),
                ((f"its shading has edges ({100 * LEAST_SHADING * self.shading:.1f} % of its colour; "
f"empty gels stay below {100 * LEAST_SHADING:.2g} %)"), self.shading),
            )
            if value >= 1.0
        ]  # fmt: skip
        return " and ".join(seen_by)


def shown_print(
    picture: UInt8[np.ndarray, "h w 3"],
    reference: ReferenceMarkers,
    *,
    camera: GelCamera | None = None,
    described_mm: Float[np.ndarray, "m 3"] | None = None,
    position_px: Float[np.ndarray, "n 2"] | None = None,
) -> ShownPrint:
    """The imprint in a picture with the markers of `reference`, at `position_px` (None: at rest; NaN: lost).

    If the sensor's description has the markers' places (`described_mm`), the camera should see those;
    otherwise a regular grid.
    """
    place = reference.lattice.rest_px if position_px is None else position_px
    spacing = reference.lattice.spacing_px
    shading = print_shading(picture, place, spacing_px=spacing, disc_px=reference.disc_px)
    ideal, known = _ideal(reference, camera, described_mm)
    return ShownPrint(
        bulge=bulge_of(reference, ideal, known & np.isfinite(place[:, 0]), place) / LEAST_BULGE,
        shading=shading / LEAST_SHADING,
    )


def bulge_of(
    reference: ReferenceMarkers,
    ideal: Float[np.ndarray, "n 2"],
    known: Bool[np.ndarray, " n"],
    place_px: Float[np.ndarray, "n 2"],
) -> float:
    """Root mean square of the misfit to a smooth lens that neighbours share, in spacings; nan for few
    markers.

    `ideal`: the markers' places without a lens, in any unit; `known`: the markers that are fitted.
    """
    if known.sum() < FEWEST:
        return float("nan")
    lens = fitted_lens(ideal[known], place_px[known], reference.shape)
    off = place_px[known] - lens.places_px(ideal[known])
    margin = reference.lattice.margin_px
    spacing = spacing_of(reference.lattice.rest_px)
    among = lattice_of(reference.lattice.rest_px[known], spacing, shape=reference.shape, margin_px=margin)
    common = coherent_misfit_px(among, off)
    return float(np.sqrt((common**2).sum(axis=1).mean()) / spacing)


def _ideal(
    reference: ReferenceMarkers,
    camera: GelCamera | None,
    described_mm: Float[np.ndarray, "m 3"] | None,
) -> tuple[Float[np.ndarray, "n 2"], Bool[np.ndarray, " n"]]:
    """The markers' places in a flat picture, in spacings, and for which markers they are known."""
    if camera is None or described_mm is None:
        return lattice_places(reference.lattice)
    rest_px = reference.lattice.rest_px
    places = places_of(camera, rest_px, described_mm, shape=reference.shape, source="")
    ideal, known = np.zeros_like(rest_px), np.zeros(len(rest_px), dtype=bool)
    expected = project(camera, described_mm)[places.described]
    ideal[places.kept] = (expected - expected.mean(axis=0)) / reference.lattice.spacing_px
    known[places.kept] = True
    return ideal, known


def becomes_flatter(before: ShownPrint, after: ShownPrint) -> bool:
    """Whether the gel is flatter in the second picture, while the first shows signs of an imprint."""
    pairs = ((before.bulge, after.bulge), (before.shading, after.shading))
    return any(
        sign_before >= SOMETHING and sign_after <= FLATTER * sign_before for sign_before, sign_after in pairs
    )


@dataclass(frozen=True, kw_only=True)
class PadReference:
    """The markers at rest; `shown`: the imprint in their picture."""

    markers: ReferenceMarkers
    shown: ShownPrint
    notes: tuple[str, ...]


def pad_reference(sensor: Sensor, view: RawCamera, camera: GelCamera, *, source: str) -> PadReference:
    """The markers of the reference's picture.

    Raises TactileFailure: gel-saturated, no-markers if there are too few, wrong-sensor if they are not as the
    description has them.
    """
    refuse_saturated(view.reference, f"{source}: reference")
    markers = reference_of(view.reference, source=f"{source}: reference")
    rest_px = markers.lattice.rest_px
    places_of(camera, rest_px, sensor.rest_mm, shape=markers.shape, source=source)
    shown = shown_print(view.reference, markers, camera=camera, described_mm=sensor.rest_mm)
    note = (
        f"{source}: the reference shows a contact imprint: {shown.seen_by} (in {view.reference_from}). An "
        f"object touched it, or the gel is under load from the first frame: {WHAT_TO_DO}."
    )
    return PadReference(markers=markers, shown=shown, notes=(note,) if shown.evidence >= 1.0 else ())


def references_said(raw: RawGrasp) -> list[str]:
    """A sentence on each pad whose reference shows an imprint; raises as `pad_reference` does."""
    said: list[str] = []
    for pad in with_square_pixels(raw).pads:
        if pad.sensor.camera is not None:
            source = f"{raw.source}/{pad.name}"
            try:
                reference = pad_reference(pad.sensor, pad.view, pad.sensor.camera, source=source)
            except TactileFailure as failure:
                read = f"drupe read {pad.view.reference_from} and {pad.described_in}"
                raise TactileFailure(failure.problem, f"{failure.detail} ({read})") from None
            said += reference.notes
    return said
