"""Files in a folder of photos that are not read as photos, and why."""

import os
from collections import defaultdict
from contextlib import suppress
from pathlib import Path

from pipeline.files.plain_file import NotReadable, listed, not_plain, printable, read_head
from recon.cameras.photos import SUFFIXES, photo_paths, picture_kind

NO_PHOTOS = frozenset(
    {
        ".txt", ".md", ".pdf", ".rtf", ".doc", ".docx", ".odt", ".html", ".htm", ".csv", ".xlsx", ".log",
        ".json", ".toml", ".xml", ".xmp", ".aae", ".thm", ".ini", ".db", ".gpx", ".lnk", ".url", ".py", ".sh",
        ".mov", ".mp4", ".m4v", ".avi", ".3gp", ".wav", ".m4a", ".mp3", ".lrv",
    }
)  # fmt: skip
"""Suffixes that need no warning: notes, and what cameras write beside a photo (edits, copies and films)."""
READ_KINDS = {"JPEG": ".jpg", "PNG": ".png", "HEIC": ".heic"}
"""Kinds of pictures that are read, and the suffix that each should have."""
MOST_ENTRIES = 2000
"""Most entries of a folder that are inspected, so that a link to a whole disk costs no time."""


def unused_photos(folder: Path, *, pictures_alone: bool = False) -> list[str]:
    """Sentences on the unused files in a folder of photos, one for each cause. `pictures_alone`: only on
    those that are pictures by their first bytes, in a folder that may hold other files too.

    No sentence names NO_PHOTOS, hidden files, or files beside a photo of the same name, such as raw pictures.
    The first bytes determine the kind of a picture.
    """
    used = {path.stem.lower() for path in photo_paths(folder)}
    causes: dict[str, list[str]] = defaultdict(list)
    for path in _entries(folder):
        if why := _why_unused(path, used, pictures_alone=pictures_alone):
            causes[why].append(printable(path.name))
    return [
        f"{listed(names)} {'is' if len(names) == 1 else 'are'} not used: {why}."
        for why, names in causes.items()
    ]


def _why_unused(path: Path, used: set[str], *, pictures_alone: bool) -> str:
    """Why a file or folder is not used; empty if it is used, or if nobody expects it to be."""
    suffix, wrong = path.suffix.lower(), not_plain(path)
    if suffix in SUFFIXES:
        if not wrong or wrong.startswith("has a name"):  # its reader refuses such a name
            return ""
        return f"it {wrong}; put the file itself there, or remove it"
    if path.is_dir():
        inside = () if pictures_alone else photo_paths(path)
        within = f"a folder within photos/ is not read ({len(inside)} photos); move the photos up"
        return within if inside else ""
    if wrong or suffix in NO_PHOTOS:
        return ""
    kind = _kind(path)
    if kind in READ_KINDS:
        return f"drupe reads a {kind} only with a photo's suffix; rename it to {READ_KINDS[kind]}"
    if path.stem.lower() in used or (pictures_alone and not kind):
        return ""
    what = f"drupe does not read {kind} pictures" if kind else "it is no JPEG, PNG or HEIC"
    return f"{what}; convert it to JPEG or PNG, or move it away"


def _entries(folder: Path) -> list[Path]:
    """Visible entries by name, none if unreadable. Storage and office files begin with @, #, $ or ~."""
    with suppress(OSError), os.scandir(folder) as entries:
        names = sorted(entry.name for entry, _ in zip(entries, range(MOST_ENTRIES), strict=False))
        return [folder / name for name in names if name[0] not in ".@#$~"]
    return []


def _kind(path: Path) -> str:
    try:
        return picture_kind(read_head(path, 64))
    except NotReadable:
        return ""
