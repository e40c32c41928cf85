"""The code on a printed sheet, for a lot or one of its fruit; the page of `drupe watch` accepts it."""

from __future__ import annotations

import io
from functools import lru_cache
from urllib.parse import quote, unquote

import segno

HEAD = "drupe"
MOST_BYTES = 300
"""Most bytes of a code: longer names have no code, and a symbol of this size (69 modules) is easy to scan."""


def sheet_code(lot: str, fruit_id: str = "") -> str:
    """The text of a sheet's code; empty if the names are too long for one.

    >>> sheet_code("H/07", "N 1")
    'drupe/H%2F07/N%201'
    """
    text = "/".join((HEAD, *(quote(name, safe="", errors="surrogatepass") for name in (lot, fruit_id))))
    return text if len(text) <= MOST_BYTES else ""


def read_sheet_code(text: str) -> tuple[str | None, str]:
    """Lot (None: not named) and fruit (empty: the whole lot) in a scanned or typed text.

    >>> read_sheet_code("drupe/H%2F07/N%201"), read_sheet_code(" N 1 ")
    (('H/07', 'N 1'), (None, 'N 1'))
    """
    parts = text.strip().split("/")
    if len(parts) == 3 and parts[0].lower() == HEAD:
        return unquote(parts[1]), unquote(parts[2])
    return None, text.strip()


@lru_cache(maxsize=4096)
def qr_png(text: str) -> bytes:
    """PNG of the code, made once (2 ms): one pixel per module, and the standard's quiet zone of four."""
    written = io.BytesIO()
    segno.make_qr(text, error="m").save(written, kind="png", scale=1, border=4)
    return written.getvalue()
