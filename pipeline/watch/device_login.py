"""Login of devices that open the page of `drupe watch` over a network: each sends its token over TLS."""

import asyncio
import secrets
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qsl

from starlette.requests import ClientDisconnect, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from pipeline.problem import BatchRefused, refused
from pipeline.watch.devices import KnownDevice, device_with, hash_of, read_devices
from reports.kiosk_page import login_html

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


THIS_MACHINE = "127.0.0.1", "localhost"
"""Addresses at which the page needs no network options."""
SESSION_S = 16 * 3600
"""Seconds after which a device must send its token again."""


@dataclass(frozen=True, kw_only=True)
class Network:
    """The page on a network: address to listen at, certificate and key (PEM), file of devices."""

    host: str
    certificate: Path
    key: Path
    devices: Path


def network_of(
    host: str, *, certificate: Path | None, key: Path | None, devices: Path | None
) -> Network | None:
    """The network of the page; None for this machine alone. Raises BatchRefused if an option is missing, or
    if certificate, key or file of devices is unusable.
    """
    given = {"--certificate": certificate, "--key": key, "--devices": devices}
    if host in THIS_MACHINE and not any(given.values()):
        return None
    if certificate is None or key is None or devices is None:
        missing = " and ".join(name for name, path in given.items() if path is None)
        sentence = (
            f"needs {missing}: on a network the page is encrypted, and each device has a token. "
            "Without --host only this machine can open the page."
        )
        raise refused(f"--host {host}", sentence)
    for option, path in (("--certificate", certificate), ("--key", key)):
        if not path.is_file():
            raise refused(option, f"there is no file {path}.")
    try:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate, key, password=lambda: b"")
    except (OSError, ValueError) as fault:
        sentence = (
            f"cannot be used with {key} ({fault}); give a certificate and its key without "
            "a password, both in PEM."
        )
        raise refused(certificate, sentence) from None
    if not read_devices(devices):
        raise refused(devices, f"has no device; add one with `drupe device add {devices} NAME`.")
    return Network(host=host, certificate=certificate, key=key, devices=devices)


@dataclass(kw_only=True)
class DeviceLogin:
    """Holds a session for each device that sent its token, in memory; `clock` in seconds.

    `port`: of the page; the cookie's name contains it, because browsers send cookies to all ports of a host.
    """

    devices: Path
    port: int
    language: str
    clock: Callable[[], float] = time.monotonic
    prefix: str = ""
    _sessions: dict[str, tuple[KnownDevice, float]] = field(default_factory=dict)

    @property
    def cookie(self) -> str:
        """The cookie's name. Browsers accept the prefix __Host- only over TLS and only for this host."""
        return f"__Host-drupe-{self.port}"

    def knows(self, request: Request) -> bool:
        """Whether the request has the cookie of a current session whose device is still in the file."""
        session = self._session_of(request)
        device, until = self._sessions.get(session, (None, 0.0))
        if device in self._known() and self.clock() < until:
            return True
        self._sessions.pop(session, None)
        return False

    def device_of(self, request: Request) -> str:
        """The name of the session's device."""
        return self._sessions[self._session_of(request)][0].name

    def routes(self) -> list[Route]:
        """Routes of the login page and of the logout."""
        return [
            Route("/login", self._login, methods=["GET", "POST"]),
            Route("/logout", self._logout, methods=["POST"]),
        ]

    def refusal(self, request: Request) -> Response | None:
        """The answer without a session: for the page, a redirect to the login; otherwise None (404)."""
        return RedirectResponse("login", 303) if request.url.path == "/" else None

    async def _login(self, request: Request) -> Response:
        if request.method != "POST":
            return self._page(200)
        written = await form_of(request)
        if written is None:
            return self._page(403)
        device = device_with(self._known(), written.get("token", "").strip())
        return self._page(401) if device is None else self._begun(device)

    async def _logout(self, request: Request) -> Response:
        if await form_of(request) is None:
            return self._page(403)
        self._sessions.pop(self._session_of(request), None)
        return RedirectResponse("login", 303)

    def _begun(self, device: KnownDevice) -> Response:
        session = secrets.token_urlsafe(32)
        now_s = self.clock()
        self._sessions = {name: held for name, held in self._sessions.items() if now_s < held[1]}
        self._sessions[hash_of(session)] = device, now_s + SESSION_S
        answer = RedirectResponse("./", 303)
        answer.set_cookie(
            self.cookie, session, max_age=SESSION_S, path="/", secure=True, httponly=True, samesite="strict"
        )
        return answer

    def _session_of(self, request: Request) -> str:
        return hash_of(request.cookies.get(self.cookie, ""))

    def _page(self, status: int) -> Response:
        return HTMLResponse(login_html(status, language=self.language), status)

    def _known(self) -> tuple[KnownDevice, ...]:
        """The devices that the file lists now; empty if it is unreadable."""
        try:
            return read_devices(self.devices)
        except (OSError, BatchRefused):
            return ()
