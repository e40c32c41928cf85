"""Files in a folder of photos that are not read as photos, and why: none is left out without a word."""

import os
from collections import defaultdict
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from pipeline.files.plain_file import NotReadable, not_plain, printable, read_head
from recon.cameras.photos import SUFFIXES, photo_paths
from recon.cameras.picture_size import picture_kind
from recon.wording import listed

NO_PHOTOS = frozenset(
    {
        ".txt", ".md", ".pdf", ".rtf", ".doc", ".docx", ".odt", ".html", ".htm", ".csv", ".xlsx", ".log",
        ".json", ".toml", ".xml", ".xmp", ".aae", ".thm", ".ini", ".db", ".gpx", ".lnk", ".url", ".py", ".sh",
        ".mov", ".mp4", ".m4v", ".avi", ".3gp", ".wav", ".m4a", ".mp3", ".lrv",
    }
)  # fmt: skip
"""Notes, and what cameras write beside a photo: edits, a film's small copy, the film of a moving photo."""
READ_KINDS = {"JPEG": ".jpg", "PNG": ".png", "HEIC": ".heic"}
"""Kinds of pictures that are read, and the suffix that each should have."""
MOST_ENTRIES = 2000
"""Entries of a folder that are looked at, so that a link to a whole disk costs nothing."""


def unused_photos(folder: Path, *, pictures_alone: bool = False) -> list[str]:
    """Sentences on the files of a folder of photos that are not used, one for each cause. `pictures_alone`:
    on those that are pictures by their first bytes, in a folder that may hold other files too.

    Left out are notes and what cameras write beside a photo (NO_PHOTOS), hidden files, and a raw picture or
    the like beside a photo of the same name. The kind of a picture is told by its first bytes.
    """
    causes: dict[str, list[str]] = defaultdict(list)
    for path, why in _unused(folder, pictures_alone=pictures_alone):
        causes[why].append(printable(path.name))
    return [
        f"{listed(names)} {'is' if len(names) == 1 else 'are'} not used: {why}."
        for why, names in causes.items()
    ]


def _unused(folder: Path, *, pictures_alone: bool) -> Iterator[tuple[Path, str]]:
    """Each file and folder that is not used, with the reason."""
    used = {path.stem.lower() for path in photo_paths(folder)}
    for path in _entries(folder):
        suffix = path.suffix.lower()
        wrong = not_plain(path)
        if suffix in SUFFIXES:
            if wrong and not wrong.startswith("has a name"):  # its reader refuses such a name
                yield path, f"it {wrong}; put the file itself there, or remove it"
        elif path.is_dir():
            if not pictures_alone and (inside := photo_paths(path)):
                yield (
                    path,
                    f"a folder within photos/ is not read ({len(inside)} photos); move the photos up",
                )
        elif not wrong and suffix not in NO_PHOTOS:
            kind = _kind(path)
            if kind in READ_KINDS:
                yield (
                    path,
                    f"drupe reads a {kind} only with a photo's suffix; rename it to {READ_KINDS[kind]}",
                )
            elif path.stem.lower() not in used and (kind or not pictures_alone):
                what = f"drupe does not read {kind} pictures" if kind else "it is no JPEG, PNG or HEIC"
                yield path, f"{what}; convert it to JPEG or PNG, or move it away"


def _entries(folder: Path) -> list[Path]:
    """Visible entries by name, none if unreadable; @, #, $ and ~ begin names of storage and offices."""
    with suppress(OSError), os.scandir(folder) as found:
        names = sorted(one.name for one, _ in zip(found, range(MOST_ENTRIES), strict=False))
        return [folder / name for name in names if name[0] not in ".@#$~"]
    return []


def _kind(path: Path) -> str:
    try:
        return picture_kind(read_head(path, 64))
    except NotReadable:
        return ""
