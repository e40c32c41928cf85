"""Checks of photos before reconstruction: which are unusable, which need even light, and why."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.files.plain_file import listed
from recon.cameras.mat_poses import FEWEST_TAGS
from recon.cameras.photos import FEWEST_PHOTOS, Photo, require_enough
from recon.cameras.printed_mat import BORDERS, Mat, detect_tags, standard_mat
from recon.picture_values import sampled
from recon.recon_failure import ReconFailure, ReconProblem

STEPS = 33
"""Samples across an edge, a sixteenth of the side to either side: a few tenths of a pixel apart."""
ROWS = 9
"""Profiles along the middle half of an edge, averaged to reduce noise. Set by hand."""
LEAST_CONTRAST = 10.0
"""Least grey levels (of 255) between paper and ink to measure an edge's width. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class TagOptics:
    """Blur of edges (standard deviation, px), and median grey of the paper beside the tags (0 to 255)."""

    blur_px: float
    white: float


def tag_optics(grey: UInt8[np.ndarray, "h w"], corners: Float[np.ndarray, "t 4 2"]) -> TagOptics | None:
    """Blur and paper's grey from profiles across the edges of tags; None if no edge has contrast.

    A step blurred by a Gaussian of standard deviation s has its steepest slope (white - black) / (s sqrt(2
    pi)). Profiles reach a sixteenth of the tag's side, half of the narrowest printed cell, to each side. Blur
    above about half of that is underestimated.
    """
    middle = corners.mean(axis=1, keepdims=True)
    a, b = corners, np.roll(corners, -1, axis=1)
    side = np.linalg.norm(b - a, axis=2, keepdims=True)
    out = (a + b) / 2 - middle
    out = out / np.linalg.norm(out, axis=2, keepdims=True)
    along = np.linspace(0.25, 0.75, ROWS)[:, None]
    across = np.linspace(-1, 1, STEPS)
    at = (a + 0 * b)[:, :, None, None] + along[..., None] * (b - a)[:, :, None, None]
    at = at + (across[:, None] * (side / 16)[:, :, None] * out[:, :, None])[:, :, None]
    profile = sampled(grey.astype(np.float32), at).reshape(-1, ROWS, STEPS).mean(axis=1)
    white, black = np.percentile(profile, [95, 5], axis=1)
    good = white - black > LEAST_CONTRAST
    if not good.any():
        return None
    step = side.reshape(-1) / 16 * (across[1] - across[0])
    slope = np.abs(np.diff(profile, axis=1)).max(axis=1) / step
    smear = (white - black)[good] / (slope[good] * np.sqrt(2 * np.pi))
    return TagOptics(blur_px=float(np.median(smear)), white=float(np.median(white[good])))


ENOUGH_VIEWS = 12
"""Number of good photos from which doubtful ones are left out. Meshes from 12 are 0.09 to 0.15 mm off."""
MOST_BLUR_PX = 1.25
"""Largest standard deviation of the blur on printed edges, px. Set by hand."""
LEAST_SHARP = 0.35
"""Sharpness over the set's median, below which a photo is blurred. Set by hand."""
LEAST_SHARP_ALONE = 0.06
"""Least sharpness in any set: a sharp photo of a mat has 0.5, one blurred by 4 px 0.025."""
MOST_CLIPPED = 0.35
"""Largest share of a photo's pixels at full white. Set by hand."""
LEAST_WHITE = 90.0
"""Least grey level (of 255) of the paper; a darker photo is too dark. Set by hand."""
MOST_UNEVEN = 0.12
"""Relative difference of the paper's white between photos that is not corrected. Set by hand."""
LEAST_MAT_SEEN = 0.75
"""Least share of the mat's tags that all photos together show, unless some are covered. Set by hand."""
LEAST_BRIGHT = 45.0
"""Least grey level (of 255) of a photo's brightest 5 %; a darker photo is too dark. Set by hand."""


@dataclass(frozen=True, kw_only=True)
class CheckedPhotos:
    """The photos to use, and sentences about those that were left out or are doubtful."""

    photos: tuple[Photo, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Look:
    """Measures of one photo before reconstruction."""

    photo: Photo
    sharpness: float
    clipped: float
    bright: float
    tags: tuple[int, ...]
    optics: TagOptics | None
    mirrored: bool


def checked_photos(photos: Sequence[Photo], mat: Mat | None) -> CheckedPhotos:
    """The usable photos, at one brightness, and sentences about the others.

    Left out, by name and with the reason, are mirrored photos and those with fewer than four tags of the mat.
    Blurred, overexposed or dark ones are left out while twelve good ones remain. Copies of a photo count
    once. If the mat's paper shows that photos are dark, or differ in brightness by more than 12 %, all are
    brought to one level. Raises ReconFailure: mat-not-found (mirrored photos, no tags), too-few-views,
    no-overlap (without a mat, an unusable first photo).
    """
    known, on_mat = (mat, True) if mat is not None else (standard_mat(), False)
    distinct, copies = _without_copies(photos)
    _require_distinct(len(distinct), copies)
    looks = [_look(p, known, on_mat=on_mat) for p in distinct]
    _refuse_mirrored(looks, on_mat=on_mat)
    usual = float(np.median([look.sharpness for look in looks]))
    any_tags = any(len(look.tags) >= FEWEST_TAGS for look in looks)
    lost, weak = {}, {}
    for look in looks:
        if loss := _loss(look, usual, others_show_it=any_tags, on_mat=on_mat):
            lost[look.photo.name] = loss
        if weakness := _weakness(look, usual, on_mat=on_mat):
            weak[look.photo.name] = weakness
    good = [look for look in looks if look.photo.name not in lost]
    best = [look for look in good if look.photo.name not in weak]
    warnings = [*copies]
    for reason, names in _by_reason(lost).items():
        warnings.append(f"Left out: {listed(names)}: {reason}.")
    kept = best if len(best) >= ENOUGH_VIEWS else good
    if mat is None:
        kept = _with_first(distinct[0], good, kept, lost)
    used = {look.photo.name for look in kept}
    for done, these in (("left out", False), ("used anyway, because there are no better photos", True)):
        reasons = {n: r for n, r in weak.items() if n not in lost and (n in used) == these}
        for reason, names in _by_reason(reasons).items():
            warnings.append(f"{listed(names)}: {reason}; {done}.")
    if len(kept) < FEWEST_PHOTOS:
        _refuse_rest(looks, lost, known)
    optics = [look.optics for look in kept if look.optics is not None]
    if mat is not None:
        warnings += _mat_doubts([look.tags for look in kept], mat)
    return CheckedPhotos(photos=_evened([look.photo for look in kept], optics), warnings=tuple(warnings))


def _with_first(first: Photo, good: list[_Look], kept: list[_Look], lost: dict[str, str]) -> list[_Look]:
    """The kept photos and the first (without a mat it shows the suture); raises ReconFailure (no-overlap)."""
    if first.name in lost:
        raise ReconProblem.NO_OVERLAP.failure(
            f"The first photo, {first.name}, is unusable ({lost[first.name]}). Without a mat it "
            "defines the suture's direction: retake it from the suture's side, or use the mat (drupe "
            "mat)."
        )
    names = {look.photo.name for look in kept} | {first.name}
    return [look for look in good if look.photo.name in names]


def _without_copies(photos: Sequence[Photo]) -> tuple[list[Photo], list[str]]:
    """Photos without exact copies of an earlier one, and a sentence on the copies."""
    first: dict[bytes, Photo] = {}
    copies = []
    for photo in photos:
        original = first.setdefault(photo.image.tobytes(), photo)
        if original is not photo:
            copies.append(f"{photo.name} = {original.name}")
    if not copies:
        return list(photos), []
    noun = "photo is a copy" if len(copies) == 1 else "photos are copies"
    return list(first.values()), [
        f"{len(copies)} {noun} of another ({listed(copies)}), so drupe uses each view once; take a photo "
        "from every direction."
    ]


def _require_distinct(count: int, copies: Sequence[str]) -> None:
    """Raise ReconFailure (too-few-views) with the sentence on copies if too few different photos remain."""
    try:
        require_enough(count, where="The set without copies" if copies else "The set")
    except ReconFailure as failure:
        raise failure.problem.failure(" ".join([*copies, failure.detail])) from None


def _look(photo: Photo, mat: Mat, *, on_mat: bool) -> _Look:
    """Tags, sharpness and light of a photo."""
    grey = cv2.cvtColor(photo.image, cv2.COLOR_BGR2GRAY)
    borders = BORDERS if on_mat else BORDERS[:1]
    tags, corners = detect_tags(photo.image, mat, borders=borders)
    mirrored = False
    if len(tags) < FEWEST_TAGS:
        back = np.ascontiguousarray(photo.image[:, ::-1])
        mirrored = len(detect_tags(back, mat, borders=borders)[0]) >= FEWEST_TAGS
    small = cv2.resize(grey, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    edges = np.abs(cv2.Laplacian(grey, cv2.CV_16S))
    bright = float(np.percentile(small, 95))
    brightest = reduce(cv2.max, cv2.split(photo.image))
    return _Look(
        photo=replace(photo, tags=(tags, corners)) if on_mat else photo,
        sharpness=float(np.percentile(edges, 99)) / max(bright, 1.0),
        clipped=float((brightest >= 254).mean()),
        bright=bright,
        tags=tuple(tags.tolist()),
        optics=tag_optics(grey, corners) if on_mat and len(tags) >= FEWEST_TAGS else None,
        mirrored=mirrored,
    )


def _refuse_mirrored(looks: list[_Look], *, on_mat: bool) -> None:
    """Raise ReconFailure (mat-not-found) if only mirrored photos show tags; without a mat, if most do."""
    mirrored = [look for look in looks if look.mirrored]
    upright = [look for look in looks if len(look.tags) >= FEWEST_TAGS]
    if mirrored and (not upright if on_mat else len(mirrored) > len(upright)):
        raise ReconProblem.MAT_NOT_FOUND.failure(
            f"{len(mirrored)} of {len(looks)} photos are mirrored "
            f"({listed([m.photo.name for m in mirrored])}): the mat's tags are readable only in a "
            "mirror. Turn the camera's mirroring off, or flip the files back."
        )


def _loss(look: _Look, usual: float, *, others_show_it: bool, on_mat: bool) -> str:
    """Why a photo cannot be placed; empty if it can."""
    if look.mirrored:
        return "mirrored (the mat's tags are readable only in a mirror); flip it back"
    if not on_mat or len(look.tags) >= FEWEST_TAGS:
        return ""
    what = "shows fewer than four tags of the mat"
    if look.sharpness < max(LEAST_SHARP * usual, LEAST_SHARP_ALONE):
        what = "shows no tags of the mat (too blurred, or another scene)"
        if look.tags or not others_show_it:
            what = "too blurred for drupe to read its tags"
    return f"{what}; retake it, in focus and with the mat in view"


def _weakness(look: _Look, usual: float, *, on_mat: bool) -> str:
    """Why a photo shows the fruit badly, though it can be placed; empty if it does not."""
    optics = look.optics
    if look.clipped > MOST_CLIPPED:
        return "overexposed (more than a third of the picture is pure white); retake it with less exposure"
    if (optics is not None and optics.white < LEAST_WHITE) or look.bright < LEAST_BRIGHT:
        return "too dark (white paper should exceed 90 of 255); retake it with more exposure"
    again = "retake it with a steady camera and in focus"
    if optics is not None and optics.blur_px > MOST_BLUR_PX:
        return f"blurred (edges of the tags spread over several pixels); {again}"
    if not on_mat and look.sharpness < LEAST_SHARP * usual:
        return f"more blurred than the other photos; {again}"
    return ""


def _refuse_rest(looks: list[_Look], lost: dict[str, str], mat: Mat) -> None:
    """Raise ReconFailure (mat-not-found, too-few-views): fewer than three photos can be placed."""
    most = max(len(look.tags) for look in looks)
    if most == 0 and not any("blurred" in reason for reason in lost.values()):
        raise ReconProblem.MAT_NOT_FOUND.failure(
            f"No marker of the mat ({mat.dictionary}, {len(mat.corners_mm)} tags) is visible in any "
            f"of {len(looks)} photos; check that mat.json belongs to the printed mat, and that the "
            "photos show the mat in focus."
        )
    why = "; ".join(f"{len(names)} {reason.split(';')[0]}" for reason, names in _by_reason(lost).items())
    raise ReconFailure(
        ReconProblem.TOO_FEW_VIEWS if most >= FEWEST_TAGS else ReconProblem.MAT_NOT_FOUND,
        f"Only {len(looks) - len(lost)} of {len(looks)} photos can be placed ({why}: "
        f"{listed(sorted(lost))}); expected at least {FEWEST_PHOTOS}, better 24. Retake them.",
    )


def _by_reason(reasons: dict[str, str]) -> dict[str, list[str]]:
    grouped: dict[str, list[str]] = defaultdict(list)
    for name, reason in reasons.items():
        grouped[reason].append(name)
    return dict(grouped)


def _mat_doubts(tags: Sequence[Sequence[int]], mat: Mat) -> list[str]:
    """A sentence if over a quarter of the mat's tags are in no photo; `tags` are those seen in each."""
    seen = {tag for each in tags for tag in each}
    if not seen or len(seen) >= LEAST_MAT_SEEN * len(mat.corners_mm):
        return []
    missing = [str(t) for t in mat.corners_mm if t not in seen]
    return [
        f"{len(missing)} of the mat's {len(mat.corners_mm)} tags are in no photo (tags "
        f"{listed(missing)}): clear the mat, or check that mat.json belongs to the printed mat."
    ]


def _evened(photos: Sequence[Photo], optics: Sequence[TagOptics]) -> tuple[Photo, ...]:
    """All photos, scaled to the median white of the paper if they differ by over 12 % or are dark."""
    whites = np.array([o.white for o in optics])
    if len(whites) < len(photos) or len(whites) == 0:
        return tuple(photos)
    gains = max(float(np.median(whites)), 1.7 * LEAST_WHITE) / whites
    if np.abs(gains - 1).max() <= MOST_UNEVEN:
        return tuple(photos)
    evened = []
    for photo, gain in zip(photos, gains.tolist(), strict=True):
        levels: Float[np.ndarray, 256] = np.clip(np.arange(256) * gain + 0.5, 0, 255)
        image = cv2.LUT(photo.image, levels.astype(np.uint8))
        evened.append(replace(photo, image=np.asarray(image, np.uint8)))
    return tuple(evened)
