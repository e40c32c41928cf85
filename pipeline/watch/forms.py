"""Forms that the pages of `drupe watch` send, and the headers of every answer."""

import asyncio
from urllib.parse import parse_qsl

from starlette.requests import ClientDisconnect, Request

HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Headers of every answer: browsers do not cache it, frame it in another site or send its address elsewhere.

With "no-referrer" browsers would send the origin "null" with a form.
"""
MOST_FORM_BYTES, FORM_S = 20_000, 10.0
"""Limits of a form: 1,200 characters of 12 bytes (percent encoding) and a reserve; seconds to send it."""


async def form_of(request: Request) -> dict[str, str] | None:
    """The fields of a form; None if it is from another site, too long, too slow or invalid.

    The browser must state that this page sent the form (Sec-Fetch-Site; without it, Origin).
    """
    page_origin = f"{request.url.scheme}://{request.headers.get('host', '')}"
    site, origin = request.headers.get("sec-fetch-site"), request.headers.get("origin")
    if not (origin == page_origin if site is None else site == "same-origin"):
        return None
    body = b""
    try:
        async with asyncio.timeout(FORM_S):
            async for part in request.stream():
                body += part
                if len(body) > MOST_FORM_BYTES:
                    return None
        return dict(parse_qsl(body.decode(), keep_blank_values=True, max_num_fields=10))
    except (TimeoutError, ValueError, ClientDisconnect):
        return None
