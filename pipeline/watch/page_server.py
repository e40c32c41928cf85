"""Serves the page of `drupe watch` to browsers on this machine, or over TLS to devices of the plant.

By default it listens on the loopback interface. Every address begins with a token, which drupe prints on the
terminal only. On a network a device sends its own token first (pipeline.watch.device_login). The page can add
verdicts (pipeline.watch.verdict_desk) and change nothing else. It serves only results that drupe wrote.
"""

import asyncio
import hmac
import ipaddress
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import (
    HTMLResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route
from uvicorn.protocols.http.h11_impl import H11Protocol

from pipeline.batch.layout import Results
from pipeline.files.manifest import is_ours
from pipeline.problem import refused
from pipeline.watch.device_login import HEADERS, DeviceLogin, Network, form_of
from pipeline.watch.verdict_desk import VerdictDesk
from reports.language import ENGLISH

MOST_CONNECTIONS = 64
"""Most simultaneous connections. A browser opens at most six for one page."""
QUEUE = 256
"""Most connections that wait in the operating system; they occupy no file descriptor of this process."""
MOST_OF_ADDRESS = 16
"""Most simultaneous connections of one network address: enough for two browsers with six each."""
REQUEST_S = 10.0
"""Seconds within which a connection must send the complete head of its next request."""


class CappedSocket(socket.socket):
    """A listening socket that closes new connections beyond MOST_CONNECTIONS, or `most_of_address` of one
    address.
    """

    most_of_address: int
    _open: list[tuple[socket.socket, str]]

    def capped(self, *, most_of_address: int) -> Self:
        """Sets the limit per address and returns the socket."""
        self.most_of_address, self._open = most_of_address, []
        return self

    def accept(self) -> tuple[socket.socket, Any]:
        """Accepts a connection. Raises ConnectionAbortedError, which asyncio ignores, beyond a limit."""
        connection, address = super().accept()
        self._open = [(held, host) for held, host in self._open if held.fileno() >= 0]
        of_address = sum(host == address[0] for _, host in self._open)
        if len(self._open) >= MOST_CONNECTIONS or of_address >= self.most_of_address:
            connection.close()
            raise ConnectionAbortedError
        self._open.append((connection, address[0]))
        return connection, address


class PromptHTTP(H11Protocol):
    """A protocol for uvicorn that closes a connection if the head of a request is incomplete after REQUEST_S,
    even if single bytes arrive.
    """

    def connection_made(self, transport: Any) -> None:
        """Starts the time limit of the first request."""
        super().connection_made(transport)
        self._deadline: asyncio.TimerHandle = self.loop.call_later(REQUEST_S, self._end_if_waiting)

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancels the time limit."""
        self._deadline.cancel()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """Starts the time limit of the next request."""
        self._deadline.cancel()
        self._deadline = self.loop.call_later(REQUEST_S, self._end_if_waiting)
        super().on_response_complete()

    def _end_if_waiting(self) -> None:
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()


Answer = Callable[[Request], Awaitable[Response]]
LOOPBACK = "127.0.0.1"
NEWS_S = 0.2
"""Seconds between two checks for news for an open page."""
SIGN_OF_LIFE_S = 15.0
"""Seconds without news after which the server sends a comment, so that it detects a dead connection."""
STARTS_WITHIN_S = 10.0
"""Seconds within which the server must listen."""
CIPHERS = "DEFAULT:!aNULL:!eNULL"
"""OpenSSL's default ciphers of TLS; uvicorn 0.40 alone also offers some without encryption or certificate."""
MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".csv": "text/csv; charset=utf-8",
    ".json": "application/json",
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".webp": "image/webp",
    ".ply": "application/octet-stream",
    ".glb": "model/gltf-binary",
}
"""Suffixes of the files that the server sends, with their media types."""


@dataclass(frozen=True)
class TokenInAddress:
    """Access on this machine: a browser with the address, which contains the token, may open the page."""

    token: str
    prefix: str = "/{token}"

    def knows(self, request: Request) -> bool:
        """Whether the address contains the token, by a comparison in constant time."""
        return hmac.compare_digest(request.path_params["token"].encode(), self.token.encode())

    def device_of(self, _: Request) -> str:
        """Empty: the page needs no device."""
        return ""

    def routes(self) -> list[Route]:
        """Empty: there is no login."""
        return []

    def refusal(self, request: Request) -> None:
        """None: the server answers 404."""


class PageServer:
    """Serves a changing page and the report beside it, in a thread, as a context manager.

    `port` 0: any free one. `network`: for other machines; None: this machine alone. `tell` receives one
    sentence if the page stops before the context ends; grading continues. Raises BatchRefused if the port is
    not available, or the server does not start.
    """

    def __init__(
        self,
        results: Results,
        *,
        port: int = 0,
        network: Network | None = None,
        language: str = ENGLISH,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._results = results
        self._network = network
        self.desk: VerdictDesk | None = None
        self._page, self._version, self._closed = "", 0, threading.Event()
        self._tell = tell
        self._socket = _listening(LOOPBACK if network is None else network.host, port)
        self._access: TokenInAddress | DeviceLogin = (
            TokenInAddress(secrets.token_urlsafe(16))
            if network is None
            else DeviceLogin(devices=network.devices, port=self._socket.getsockname()[1], language=language)
        )
        self._server = uvicorn.Server(
            uvicorn.Config(
                self._app(),
                log_config=None,
                access_log=False,
                loop="asyncio",
                lifespan="off",
                http=PromptHTTP,
                ws="none",
                backlog=QUEUE,
                server_header=False,
                proxy_headers=False,
                headers=list(HEADERS.items()),
                ssl_ciphers=CIPHERS,
                ssl_certfile=None if self._network is None else self._network.certificate,
                ssl_keyfile=None if self._network is None else self._network.key,
                timeout_graceful_shutdown=1,
            )
        )
        self._thread = threading.Thread(target=self._serve, name="drupe page", daemon=True)

    def _serve(self) -> None:
        """Runs the server until the context ends; tells if it stops earlier."""
        of_address = MOST_CONNECTIONS if self._network is None else MOST_OF_ADDRESS
        try:
            with CappedSocket(fileno=self._socket.dup().detach()).capped(most_of_address=of_address) as held:
                self._server.run(sockets=[held])
            why = "its server ended"
        except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, grading goes on
            why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        if self._server.started and not self._closed.is_set():
            self._tell(
                f"the page stopped ({why}); grading continues. Start drupe watch again to see the page"
            )

    @property
    def address(self) -> str:
        """The URL of the page."""
        port = self._socket.getsockname()[1]
        if isinstance(self._access, TokenInAddress):
            return f"http://{LOOPBACK}:{port}/{self._access.token}/"
        host = self._socket.getsockname()[0]
        everywhere = ipaddress.ip_address(host).is_unspecified
        named = socket.getfqdn() if everywhere else f"[{host}]" if ":" in host else host
        return f"https://{named}:{port}/"

    def show(self, page: str) -> None:
        """Replaces the page; open browsers show it within a second."""
        self._page, self._version = page, self._version + 1

    def __enter__(self) -> Self:
        """Starts the server. Raises BatchRefused if it does not listen within STARTS_WITHIN_S."""
        self._thread.start()
        until = time.monotonic() + STARTS_WITHIN_S
        while not self._server.started and self._thread.is_alive() and time.monotonic() < until:
            time.sleep(0.01)
        if not self._server.started:
            self.__exit__(None, None, None)
            sentence = (
                f"did not start within {STARTS_WITHIN_S:g} s; run the command again, or name another port "
                "with --port."
            )
            raise refused("the page of drupe watch", sentence)
        return self

    def __exit__(self, *_: object) -> None:
        """Stops the server."""
        self._closed.set()
        self._server.should_exit = True
        self._thread.join(STARTS_WITHIN_S)
        self._socket.close()

    def _app(self) -> Starlette:
        start = self._access.prefix
        known = self._for_known
        hosts = [LOOPBACK, "localhost"] if self._network is None else ["*"]
        return Starlette(
            routes=[
                Route(f"{start}/", known(self._kiosk)),
                Route(f"{start}/events", known(self._events)),
                Route(f"{start}/scan", known(self._scan)),
                Route(f"{start}/judge", known(self._judge), methods=["GET", "POST"]),
                *self._access.routes(),
                Route(f"{start}/{{path:path}}", known(self._file)),
            ],
            middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=hosts)],
        )

    def _for_known(self, answer: Answer) -> Answer:
        """Guards `answer`: requests without access get the refusal, or 404."""

        async def guarded(request: Request) -> Response:
            if self._access.knows(request):
                return await answer(request)
            return self._access.refusal(request) or _nothing()

        return guarded

    async def _kiosk(self, _: Request) -> Response:
        return HTMLResponse(self._page)

    async def _scan(self, request: Request) -> Response:
        """Redirects to the target of a scanned code: the form for a fruit, or the report of the lot."""
        if self.desk is None:
            return _nothing()
        code = request.query_params.get("code", "")
        address, page = await asyncio.to_thread(self.desk.scanned, code)
        if address:
            return RedirectResponse(address, 303)
        return HTMLResponse(page, 404)

    async def _judge(self, request: Request) -> Response:
        """Shows the form for a fruit, or stores the verdict of a sent form; refuses forms of other sites."""
        fruit_id, desk = request.query_params.get("fruit", ""), self.desk
        if desk is None:
            return _nothing()
        device = self._access.device_of(request)
        if request.method != "POST":
            page = await asyncio.to_thread(desk.form, fruit_id)
            return _nothing() if page is None else HTMLResponse(page)
        written = await form_of(request)
        if written is None or await asyncio.to_thread(desk.form, fruit_id) is None:
            return _nothing()
        page = await asyncio.to_thread(desk.judge, fruit_id, written, device)
        if page is not None:
            return HTMLResponse(page, status_code=422)
        return RedirectResponse("./", status_code=303)

    async def _events(self, request: Request) -> Response:
        return StreamingResponse(self._news(request), media_type="text/event-stream")

    async def _news(self, request: Request) -> AsyncIterator[str]:
        sent, quiet_s = -1, 0.0
        while not self._closed.is_set() and self._access.knows(request):
            if sent != self._version:
                sent, quiet_s = self._version, 0.0
                yield f"event: changed\ndata: {sent}\n\n"
            elif quiet_s >= SIGN_OF_LIFE_S:
                quiet_s = 0.0
                yield ": no news\n\n"
            await asyncio.sleep(NEWS_S)
            quiet_s += NEWS_S

    async def _file(self, request: Request) -> Response:
        path = self._given(request.path_params["path"])
        if path is None:
            return _nothing()
        try:
            content = await asyncio.to_thread(path.read_bytes)
        except OSError:
            return _nothing()
        return Response(content, media_type=MEDIA_TYPES[path.suffix.lower()])

    def _given(self, named: str) -> Path | None:
        """The file of the results that an address names; None unless drupe wrote it."""
        parts = named.split("/")
        if any(part in ("", ".", "..") or part.startswith(".") or "\0" in part for part in parts):
            return None
        path = self._results.root.joinpath(*parts)
        in_layout = len(parts) == 1 or (len(parts) == 3 and parts[0] == "fruits")
        folders = [path.parent] if len(parts) == 1 else [path.parent, path.parent.parent]
        if (
            not in_layout
            or path.suffix.lower() not in MEDIA_TYPES
            or any(folder.is_symlink() for folder in folders)
        ):
            return None
        return path if is_ours(path) else None


def _listening(host: str, port: int) -> socket.socket:
    try:
        family, *_, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.create_server(place[:2], family=family, backlog=QUEUE)
    except OSError as error:
        sentence = f"is not available ({error.strerror}); choose another port, or 0 for any free one."
        raise refused(
            f"--port {port}" if host == LOOPBACK else f"--host {host}, --port {port}", sentence
        ) from None
    return listening


def _nothing() -> Response:
    return PlainTextResponse("not found", status_code=404)
