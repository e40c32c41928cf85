"""The faults of `recon_faults.py`: what each does to a good set of photos, its mat.json and its numbers."""

import copy
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import fault_pictures as do
import numpy as np
from fault_pictures import Picture, TrueView
from jaxtyping import Bool, Float
from PIL import Image


@dataclass(frozen=True, kw_only=True)
class PhotoSet:
    """What a user hands in: pictures by name, or the bytes of a file; the mat's mapping; his own numbers."""

    pictures: dict[str, Picture]
    views: dict[str, TrueView]
    masks: dict[str, Bool[np.ndarray, "h w"]]
    mat: dict[str, Any] | None
    skin: Float[np.ndarray, "n 3"]
    height_mm: float | None = None
    diameter_mm: float | None = None
    mass_g: float | None = None
    files: dict[str, bytes] = field(default_factory=dict)
    dropped: frozenset[str] = frozenset()

    def content(self) -> dict[str, bytes]:
        """Every file of the folder, by name."""
        coded = {
            n: jpeg(p) for n, p in self.pictures.items() if n not in self.files and n not in self.dropped
        }
        return coded | self.files


Fault = Callable[[PhotoSet], PhotoSet]


@dataclass(frozen=True)
class FaultCase:
    """A fault, and on what it is tried: "mat" or "height" route; whether any second source can tell."""

    name: str
    fault: Fault
    route: str = "mat"
    unknowable: bool = False


def jpeg(picture: Picture, quality: int = 95) -> bytes:
    """The picture as a JPEG file."""
    return bytes(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1])


def png(picture: np.ndarray) -> bytes:
    """The picture as a PNG file, 8 or 16 bits, with or without alpha."""
    return bytes(cv2.imencode(".png", picture)[1])


def cmyk(picture: Picture) -> bytes:
    """The picture as a JPEG in printer's inks."""
    out = io.BytesIO()
    Image.fromarray(picture[:, :, ::-1]).convert("CMYK").save(out, "JPEG", quality=95)
    return out.getvalue()


def oriented(data: bytes, orientation: int) -> bytes:
    """A JPEG with the EXIF tag Orientation (1, 3, 6 or 8) put in."""
    tag = b"\x01\x12\x00\x03\x00\x00\x00\x01" + orientation.to_bytes(2, "big") + b"\x00\x00"
    body = b"Exif\x00\x00MM\x00*\x00\x00\x00\x08\x00\x01" + tag + b"\x00\x00\x00\x00"
    return data[:2] + b"\xff\xe1" + (len(body) + 2).to_bytes(2, "big") + body + data[2:]


def each(change: Callable[[Picture], Picture], *, every: int = 1, first: int = 0) -> Fault:
    """The change on every n-th picture."""

    def fault(given: PhotoSet) -> PhotoSet:
        chosen = set(sorted(given.pictures)[first::every])
        pictures = {n: change(p) if n in chosen else p for n, p in given.pictures.items()}
        return replace(given, pictures=pictures)

    return fault


def viewed(change: Callable[[PhotoSet, str], Picture], *, every: int = 1, first: int = 0) -> Fault:
    """A change that needs to know where the photo was taken from."""

    def fault(given: PhotoSet) -> PhotoSet:
        chosen = set(sorted(given.pictures)[first::every])
        pictures = {n: change(given, n) if n in chosen else p for n, p in given.pictures.items()}
        return replace(given, pictures=pictures)

    return fault


def files(
    change: Callable[[Picture], bytes], *, suffix: str = ".jpg", every: int = 1, first: int = 0
) -> Fault:
    """Pictures written in another way."""

    def fault(given: PhotoSet) -> PhotoSet:
        chosen = sorted(given.pictures)[first::every]
        made = {n.replace(".jpg", suffix): change(given.pictures[n]) for n in chosen}
        return replace(given, files=made, dropped=frozenset(set(chosen) - set(made)))

    return fault


def only(keep: Callable[[PhotoSet, list[str]], list[str]]) -> Fault:
    """Some of the pictures alone."""

    def fault(given: PhotoSet) -> PhotoSet:
        kept = set(keep(given, sorted(given.pictures)))
        return replace(given, dropped=frozenset(set(given.pictures) - kept))

    return fault


def spread(count: int) -> Fault:
    """`count` photos, spread evenly over the list."""
    return only(
        lambda _, names: [names[i] for i in np.linspace(0, len(names) - 1, count).round().astype(int)]
    )


def one(file: bytes | Callable[[Picture], bytes], *, which: int = 4) -> Fault:
    """One file of the folder replaced."""

    def fault(given: PhotoSet) -> PhotoSet:
        name = sorted(given.pictures)[which]
        return replace(given, files={name: file(given.pictures[name]) if callable(file) else file})

    return fault


def with_mat(change: Callable[[dict[str, Any]], None], **numbers: float | None) -> Fault:
    """Another mat.json than the one that was printed."""

    def fault(given: PhotoSet) -> PhotoSet:
        mat = copy.deepcopy(given.mat)
        if mat is not None:
            change(mat)
        return replace(given, mat=mat, **numbers)  # type: ignore[arg-type]

    return fault


def stretched(factor: float) -> Callable[[dict[str, Any]], None]:
    """mat.json says so many times what the paper shows."""

    def change(mat: dict[str, Any]) -> None:
        mat["tags"] = {k: (factor * np.array(v)).tolist() for k, v in mat["tags"].items()}
        mat["W"], mat["H"], mat["tag"] = (factor * mat[k] for k in ("W", "H", "tag"))

    return change


def shuffled(mat: dict[str, Any]) -> None:
    """The tags stand in another order than printed."""
    keys = list(mat["tags"])
    mat["tags"] = dict(zip(keys, [mat["tags"][k] for k in keys[7:] + keys[:7]], strict=True))


def renamed(given: PhotoSet) -> PhotoSet:
    """Names that are not ASCII, with blanks and quotes."""
    made = {f"Pfirsich Größe {n[:-4]}–桃 '1'.JPG": jpeg(p) for n, p in given.pictures.items()}
    return replace(given, files=made, dropped=frozenset(given.pictures))


def doubled(given: PhotoSet) -> PhotoSet:
    """Six photos three times over: eighteen files of six views."""
    names = sorted(given.pictures)[::3]
    made = {f"{n[:-4]}{copy_}.jpg": jpeg(given.pictures[n]) for n in names for copy_ in ("", " (1)", " (2)")}
    return replace(given, files=made, dropped=frozenset(given.pictures))


def noisy_middle(picture: Picture) -> bytes:
    """A JPEG with 1,500 bytes in its middle overwritten: whole at first sight."""
    data = bytearray(jpeg(picture))
    middle = len(data) // 2
    data[middle : middle + 1500] = bytes(1500)
    return bytes(data)


def fruit_moved(at_mm: tuple[float, float], size: float = 1.0) -> Callable[[PhotoSet, str], Picture]:
    """The fruit taken away and put back elsewhere, or another one put in its place."""

    def change(given: PhotoSet, name: str) -> Picture:
        picture, mask = given.pictures[name], given.masks[name]
        bare = do.without_fruit(picture, mask)
        return do.pasted(bare, picture, given.views[name], mask, at_mm=at_mm, centre_mm=CENTRE_MM, size=size)

    return change


CENTRE_MM = 27.0


def twin(at_mm: tuple[float, float]) -> Callable[[PhotoSet, str], Picture]:
    """Another fruit at (x, y)."""
    return lambda given, name: do.second_fruit(
        given.pictures[name], given.views[name], given.masks[name], at_mm, CENTRE_MM
    )


def covered(past_mm: float) -> Callable[[PhotoSet, str], Picture]:
    """Paper on the mat up to x."""
    return lambda given, name: do.covered_mat(
        given.pictures[name], given.views[name], given.masks[name], past_mm
    )


def recoloured(factors: tuple[float, float, float]) -> Callable[[PhotoSet, str], Picture]:
    """The fruit in another colour."""
    return lambda given, name: do.recoloured(given.pictures[name], given.masks[name], factors)


def shadow(*, moving: bool) -> Callable[[PhotoSet, str], Picture]:
    """A sharp shadow on the paper: of one lamp, or of one that is carried round with the camera."""

    def change(given: PhotoSet, name: str) -> Picture:
        view = given.views[name]
        azimuth = np.radians(view.azimuth_deg) + 0.7 if moving else 4.2
        return do.shaded(given.pictures[name], view, given.masks[name], given.skin, azimuth=azimuth)

    return change


def aside(degrees: float) -> Callable[[PhotoSet, str], Picture]:
    """The camera turned aside."""
    return lambda given, name: do.aimed_aside(given.pictures[name], given.views[name], degrees)


def flipped(picture: Picture) -> Picture:
    """As in a mirror."""
    return np.ascontiguousarray(picture[:, ::-1])


def quarter_turned(picture: Picture) -> Picture:
    """On its side."""
    return np.ascontiguousarray(np.rot90(picture))


def given(**numbers: float | None) -> Fault:
    """Other numbers in fruits.csv."""
    return lambda photos: replace(photos, **numbers)  # type: ignore[arg-type]


def both(*faults: Fault) -> Fault:
    """One after the other."""

    def fault(photos: PhotoSet) -> PhotoSet:
        for step in faults:
            photos = step(photos)
        return photos

    return fault


def _alpha(picture: Picture) -> np.ndarray:
    return np.dstack([picture, np.full(picture.shape[:2], 128, np.uint8)])


def _deep(picture: Picture) -> np.ndarray:
    return picture.astype(np.uint16) * 257


def _half(picture: Picture) -> bytes:
    return jpeg(np.asarray(cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8))


def cases(numbers: Mapping[str, float]) -> tuple[FaultCase, ...]:
    """Every case; `numbers` are the true height_mm, diameter_mm and mass_g of the fruit."""
    tall = numbers["height_mm"]
    wide = numbers["diameter_mm"]
    one_side = only(lambda g, names: [n for n in names if abs(g.views[n].azimuth_deg) < 75])
    return (
        FaultCase("nothing", lambda g: g),
        FaultCase("nothing, height and diameter given", given(height_mm=tall, diameter_mm=wide)),
        FaultCase("all blurred, 2 px", each(lambda p: do.blurred(p, 2.0))),
        FaultCase("all blurred, 5 px", each(lambda p: do.blurred(p, 5.0))),
        FaultCase("a third blurred, 4 px", each(lambda p: do.blurred(p, 4.0), every=3)),
        FaultCase("a third shaken, 15 px", each(lambda p: do.shaken(p, 15), every=3, first=1)),
        FaultCase("all overexposed, 2 stops", each(lambda p: do.exposed(p, 2.0))),
        FaultCase("all underexposed, 4 stops", each(lambda p: do.exposed(p, -4.0))),
        FaultCase("every second one overexposed, 1.5 stops", each(lambda p: do.exposed(p, 1.5), every=2)),
        FaultCase("every third underexposed, 3 stops", each(lambda p: do.exposed(p, -3.0), every=3)),
        FaultCase("strong vignetting", each(lambda p: do.vignetted(p, 0.25))),
        FaultCase("gamma 0.7", each(lambda p: do.toned(p, 0.7))),
        FaultCase("gamma 1.4", each(lambda p: do.toned(p, 1.4))),
        FaultCase("half as bright", each(lambda p: do.tinted(p, (0.5, 0.5, 0.5)))),
        FaultCase("warm white balance", each(lambda p: do.tinted(p, (0.75, 1.0, 1.15)))),
        FaultCase("cold white balance", each(lambda p: do.tinted(p, (1.2, 1.0, 0.8)))),
        FaultCase("JPEG of quality 60", files(lambda p: jpeg(p, 60))),
        FaultCase("all blurred, 1.5 px", each(lambda p: do.blurred(p, 1.5))),
        FaultCase("green skin", viewed(recoloured((0.5, 1.6, 0.7)))),
        FaultCase("dark skin", viewed(recoloured((0.5, 0.4, 0.4)))),
        FaultCase("hard shadow", viewed(shadow(moving=False))),
        FaultCase("hard shadow that moves", viewed(shadow(moving=True))),
        FaultCase("8 photos", spread(8)),
        FaultCase("5 photos", spread(5)),
        FaultCase("2 photos", spread(2)),
        FaultCase("photos from one side only", one_side),
        FaultCase("lower ring only", only(lambda _, names: names[: len(names) // 2])),
        FaultCase("mat half covered", viewed(covered(0.0))),
        FaultCase("mat all but covered", viewed(covered(57.0))),
        FaultCase("mat printed at 97 %, height given", with_mat(stretched(1 / 0.97), height_mm=tall)),
        FaultCase("mat printed at 97 %, diameter given", with_mat(stretched(1 / 0.97), diameter_mm=wide)),
        FaultCase("mat printed at 97 %, nothing else known", with_mat(stretched(1 / 0.97)), unknowable=True),
        FaultCase("height_mm 5 % too large, mat", given(height_mm=1.05 * tall)),
        FaultCase("height_mm in cm, mat", given(height_mm=tall / 10)),
        FaultCase("diameter_mm 8 % too large, mat", given(diameter_mm=1.08 * wide)),
        FaultCase("another fruit beside the mat", viewed(twin((120.0, 40.0)))),
        FaultCase("another fruit on the mat", viewed(twin((-58.0, 30.0)))),
        FaultCase("two fruits touching", viewed(twin((0.0, 61.0)))),
        FaultCase("fruit moved by 6 mm halfway", viewed(fruit_moved((6.0, 0.0)), every=2)),
        FaultCase("fruit moved by 2 mm halfway", viewed(fruit_moved((0.0, 2.0)), every=2)),
        FaultCase("another fruit, 8 % smaller, in half the photos",
                  viewed(fruit_moved((0, 0), 0.92), every=2)),
        FaultCase("another fruit, 20 % larger, in one photo",
                  viewed(fruit_moved((0, 0), 1.2), every=99, first=5)),
        FaultCase("one photo mirrored", each(flipped, every=99, first=5)),
        FaultCase("all mirrored", each(flipped)),
        FaultCase("one photo of another scene", each(lambda p: do.another_scene(p, 3), every=99, first=5)),
        FaultCase("a third of another scene", each(lambda p: do.another_scene(p, 4), every=3)),
        FaultCase("turned by EXIF, rightly", files(lambda p: oriented(jpeg(quarter_turned(p)), 6))),
        FaultCase("turned by EXIF, all wrongly", files(lambda p: oriented(jpeg(p), 6))),
        FaultCase("turned by EXIF, one wrongly", one(lambda p: oriented(jpeg(p), 8))),
        FaultCase("portrait and landscape mixed", files(lambda p: jpeg(quarter_turned(p)), every=3)),
        FaultCase("one photo grey", each(do.grey, every=99, first=5)),
        FaultCase("all photos grey", each(do.grey)),
        FaultCase("16-bit PNG", files(lambda p: png(_deep(p)), suffix=".png")),
        FaultCase("PNG with alpha", files(lambda p: png(_alpha(p)), suffix=".png")),
        FaultCase("CMYK JPEG", files(cmyk)),
        FaultCase("an empty file", one(b"")),
        FaultCase("a JPEG cut short", one(lambda p: jpeg(p)[:20000])),
        FaultCase("a JPEG damaged in its middle", one(noisy_middle)),
        FaultCase("a text file named .jpg", one(b"Peach 4, taken on Tuesday\n" * 40)),
        FaultCase("one photo half the size", one(_half)),
        FaultCase("one photo zoomed by 1.3", each(lambda p: do.zoomed(p, 1.3), every=99, first=5)),
        FaultCase("half of the photos zoomed by 1.15", each(lambda p: do.zoomed(p, 1.15), every=2)),
        FaultCase("six photos thrice", doubled),
        FaultCase("fruit cut off in a third", viewed(aside(11.0), every=3)),
        FaultCase("fruit cut off in all", viewed(aside(13.0))),
        FaultCase("names that are not ASCII", renamed),
        FaultCase("mat.json of another dictionary", with_mat(lambda m: m.update(dict="5X5_100"))),
        FaultCase("mat.json of half the size (cherries)", with_mat(stretched(0.5))),
        FaultCase("mat.json in another order", with_mat(shuffled)),
        FaultCase("nothing, by height", given(mat=None, height_mm=tall), route="height"),
        FaultCase("by height, 5 % wrong",
                  given(mat=None, height_mm=1.05 * tall), route="height", unknowable=True),
        FaultCase("by height, 5 % wrong, diameter given",
                  given(mat=None, height_mm=1.05 * tall, diameter_mm=wide), route="height"),
        FaultCase("by height, in inches", given(mat=None, height_mm=tall / 25.4), route="height"),
        FaultCase("by height, all mirrored",
                  both(each(flipped), given(mat=None, height_mm=tall)), route="height"),
        FaultCase("by height, first photo of another scene",
                  both(each(lambda p: do.another_scene(p, 5), every=99), given(mat=None, height_mm=tall)),
                  route="height"),
        FaultCase("by height, another fruit beside it",
                  both(viewed(twin((-58.0, 30.0))), given(mat=None, height_mm=tall)), route="height"),
        FaultCase("by height, 12 photos", both(spread(12), given(mat=None, height_mm=tall)), route="height"),

    )  # fmt: skip
