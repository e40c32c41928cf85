"""Readers for files that a user names: only plain files up to a given size, without waiting for pipes."""

import errno
import json
import os
import re
import stat
import tomllib
import unicodedata
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

DEEPEST = 20
"""Most levels of nested lists and tables: drupe's files need 4; a parser's stack overflows near 1000."""
_KEY_PART = r"""(?:"(?:[^"\\\n]++|\\.)*"?|'[^'\n]*+'?|[\w-]++)"""


def _whole(pattern: str, name: str) -> str:
    """An atomic group, by a lookahead and a back-reference: `(?:a|b)*+` may backtrack before Python 3.11.5
    (python/cpython issue 106052).
    """
    return rf"(?=(?P<{name}>{pattern}))(?P={name})"


_TOML_TOKEN = re.compile(
    r'''"""(?:[^"\\]++|\\.|"(?!""))*(?:"{3,5}|\\?\Z)|#[^\n]*+|[^"'#\w-]++|'''
    r"""'''(?:[^']++|'(?!''))*(?:'{3,5}|\Z)|"""
    rf"(?P<deep_key>{_whole(_KEY_PART, 'first')}"
    rf"(?:[ \t]*+\.[ \t]*+{_whole(_KEY_PART, 'next')}){{{DEEPEST}}})|{_KEY_PART}",
    re.DOTALL,
)
"""A multi-line string, a comment, punctuation, a key of more than DEEPEST parts, or one part of a key, word
or string (TOML 1.0). Every character is in exactly one token, so that the search takes linear time. An
unterminated string extends to the end of the line or file, where the TOML reader stops."""

LFS_POINTER = b"version https://git-lfs.github.com/spec/"
"""First bytes of the pointer that Git LFS puts in the place of a large file (its specification, v1)."""
NO_LFS_FILE = "is a Git LFS pointer, not the file itself: fetch the file with `git lfs pull`"

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class NotReadable(Exception):
    """Raised for an unreadable file; its text is a predicate such as "is a named pipe, not a file"."""


def not_plain(path: Path) -> str:
    """Why `path` is not a readable plain file, found without opening it; empty if it is one.

    A link to a plain file is accepted, wherever the file is. A pipe, a socket or a device is not: opening one
    can block forever, and a device never ends. A name that is not UTF-8 is not accepted either.
    """
    if not named_in_utf8(path):
        return "has a name that is not UTF-8"
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return f"is a link to nothing ({path.readlink()})" if path.is_symlink() else "does not exist"
    except (OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno == errno.ELOOP:
            return "is a link that leads back to itself"
        return f"cannot be opened ({_why(error)})"
    return _kind(mode)


def stands(path: Path) -> bool:
    """Whether anything has this name; a broken link counts."""
    return path.is_symlink() or path.exists()


def named_in_utf8(path: Path) -> bool:
    """Whether a file's name is UTF-8. On Linux it can be any bytes, which tables and pages cannot contain."""
    return not any(_undecoded(c) for c in path.name)


def read_bytes(path: Path, *, most_bytes: int) -> bytes:
    """All bytes of a plain file. Raises NotReadable, also above `most_bytes` and for a Git LFS pointer."""
    data = read_head(path, most_bytes + 1)
    if data.startswith(LFS_POINTER):
        raise NotReadable(NO_LFS_FILE)
    if len(data) > most_bytes:
        raise NotReadable(f"is larger than {size(most_bytes)}, the most that is read")
    return data


def read_head(path: Path, count: int) -> bytes:
    """The first `count` bytes of a plain file; raises NotReadable."""
    if wrong := not_plain(path):
        raise NotReadable(wrong)
    try:
        with open_plain(path) as file:
            return file.read(count)
    except OSError as error:
        raise NotReadable(f"cannot be opened ({_why(error)})") from error


def open_plain(path: Path) -> BinaryIO:
    """Opens a plain file without waiting for a pipe; raises OSError, or NotReadable if it is not plain."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if wrong := _kind(os.fstat(handle).st_mode):
        os.close(handle)
        raise NotReadable(wrong)
    return os.fdopen(handle, "rb")


def is_lfs_pointer(path: Path) -> bool:
    """Whether the plain file at `path` is a pointer to a file that Git LFS has not fetched."""
    with path.open("rb") as file:
        return file.read(len(LFS_POINTER)) == LFS_POINTER


def read_text(path: Path, *, most_bytes: int) -> str:
    """The text of a UTF-8 file, without a byte order mark; raises NotReadable."""
    data = read_bytes(path, most_bytes=most_bytes)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise NotReadable(f"is not UTF-8 text (byte 0x{data[error.start]:02x} in line {line})") from error
    if "\0" in text:
        raise NotReadable("is no text (it holds zero bytes)")
    return text


def text_or_empty(path: Path, *, most_bytes: int) -> str:
    """The text of a UTF-8 file; empty if it cannot be read."""
    try:
        return read_text(path, most_bytes=most_bytes)
    except NotReadable:
        return ""


def toml_of(text: str) -> dict[str, Any]:
    """The table in a TOML text; raises NotReadable if invalid, too deep, or with integers beyond 64 bits."""
    if line := _line_of_deep_key(text):
        raise NotReadable(f"is nested too deep: line {line} holds a key of more than {DEEPEST} parts")
    try:
        held = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise NotReadable(f"is not valid TOML: {printable(str(error))[:200]}") from error
    except RecursionError as error:
        raise NotReadable(f"is nested too deep (more than {DEEPEST} levels)") from error
    except ValueError as error:  # Python's limit on the digits of an integer
        raise NotReadable("is not valid TOML: it holds a number of thousands of digits") from error
    _require_shallow(held)
    return held


def json_of(text: str) -> Any:
    """The value in a JSON text; raises NotReadable if invalid, too deep, or with integers beyond 64 bits."""
    try:
        held = json.loads(text)
    except json.JSONDecodeError as error:
        where = f"line {error.lineno}, column {error.colno}"
        raise NotReadable(f"is not valid JSON ({where}: {error.msg[:60].lower()})") from error
    except RecursionError as error:
        raise NotReadable(f"is nested too deep (more than {DEEPEST} levels)") from error
    except ValueError as error:
        raise NotReadable("is not valid JSON (a number of thousands of digits)") from error
    _require_shallow(held)
    return held


def _line_of_deep_key(text: str) -> int:
    """The line of the first dotted key of more than DEEPEST parts; 0 if there is none.

    The TOML reader's time and memory grow with the square of the number of parts: 25,000 take 4 GB.
    """
    deep = next((token for token in _TOML_TOKEN.finditer(text) if token["deep_key"]), None)
    return 0 if deep is None else text.count("\n", 0, deep.start()) + 1


def _require_shallow(held: Any) -> None:
    """Raises NotReadable for nesting that may overflow a later stack, and integers beyond 64 bits."""
    level = [held]
    for _ in range(DEEPEST + 1):
        if any(isinstance(entry, int) and not -(2**63) <= entry < 2**63 for entry in level):
            raise NotReadable("holds a whole number beyond 64 bits")
        level = [
            inner
            for entry in level
            if isinstance(entry, list | dict)
            for inner in (entry.values() if isinstance(entry, dict) else entry)
        ]
        if not level:
            return
    raise NotReadable(f"is nested too deep (more than {DEEPEST} levels)")


def size(count: int) -> str:
    """A number of bytes as text, in MB or kB.

    >>> size(2_000_000), size(64_000)
    ('2 MB', '64 kB')
    """
    return f"{count / 1e6:g} MB" if count >= 1_000_000 else f"{count / 1e3:g} kB"


def listed(names: Sequence[str], most: int = 6) -> str:
    """The first `most` names, separated by commas, and the number of the others.

    >>> listed(["a", "b", "c"], 2)
    'a, b and 1 more'
    """
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def composed(text: str) -> str:
    """The text with composed letters (Unicode NFC), so that equal names are equal on every system.

    >>> len("Su\u0308d"), len(composed("Su\u0308d"))
    (4, 3)
    """
    return unicodedata.normalize("NFC", text)


def composed_texts(content: Any) -> Any:
    """The content with `composed` texts in its tables and lists, at any depth.

    >>> composed_texts({"lot": "Su\u0308d", "classes": [{"name": "fu\u0308r jetzt", "ship": True}]})
    {'lot': 'S\xfcd', 'classes': [{'name': 'f\xfcr jetzt', 'ship': True}]}
    """
    if isinstance(content, str):
        return composed(content)
    if isinstance(content, Mapping):
        return {composed_texts(name): composed_texts(inner) for name, inner in content.items()}
    if isinstance(content, list | tuple):
        return type(content)(map(composed_texts, content))
    return content


def printable(text: str) -> str:
    r"""The text without control and format characters, which move a terminal's cursor or reverse a line. Line
    breaks and tabs become spaces. Bytes of a file's name that are not UTF-8 are escaped.

    >>> printable("a\x1b[31mb\u202ec\nd")
    'a[31mbc d'
    >>> printable(b"a\xff.h5".decode(errors="surrogateescape"))
    'a\\xff.h5'
    """
    if text.isprintable():
        return text
    spaced = " ".join(text.split("\n")).replace("\t", " ").replace("\r", "")
    spaced = "".join(f"\\x{ord(c) - 0xDC00:02x}" if _undecoded(c) else c for c in spaced)
    return "".join(c for c in spaced if unicodedata.category(c) not in {"Cc", "Cf", "Cs", "Zl", "Zp"})


def _undecoded(character: str) -> bool:
    """Whether the character encodes a byte that is not UTF-8 (surrogateescape, PEP 383)."""
    return "\udc80" <= character <= "\udcff"


def _kind(mode: int) -> str:
    kind = next((word for test, word in _KINDS if test(mode)), None)
    return "" if kind is None else f"is {kind}, not a file"


def _why(error: OSError | ValueError) -> str:
    return error.strerror or "unknown" if isinstance(error, OSError) else "no name of a file"
