"""Serves what `drupe watch` shows, to browsers on this machine alone.

It listens on the loopback interface. Every address begins with a token that only the person at the terminal
is given. Through it verdicts can be added (pipeline.watch.verdict_desk) and nothing else changed; of the
results only files that drupe wrote are given.
"""

import asyncio
import hmac
import secrets
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path
from typing import Protocol, Self
from urllib.parse import parse_qsl

import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    HTMLResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route

from pipeline.batch.layout import Results
from pipeline.files.manifest import is_ours
from pipeline.problem import refused
from pipeline.watch.connections import BACKLOG, QUEUE, connections_at_once, limited_http

LOOPBACK = "127.0.0.1"
NEWS_S = 0.2
"""Seconds between two looks for news to tell a page."""
SIGN_OF_LIFE_S = 15.0
"""Seconds after which an open page hears that there is no news, so that a dead connection shows."""
STARTS_WITHIN_S = 10.0
"""Seconds within which the server must listen."""
AGAIN_S = 5.0
"""Seconds after which a page that stopped is started again."""
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
"""Kinds of files that are given, and as what."""
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Cross-Origin-Resource-Policy": "same-origin",
}
"""Of every answer: kept nowhere, shown in no other site's frame, the token passed on to nobody."""


MOST_FORM_BYTES, FORM_S = 20_000, 10.0
"""Of a form: 1,200 characters of 12 bytes each (percent encoding), and the seconds that sending may take."""


class Desk(Protocol):
    """Takes verdicts of people."""

    def form(self, fruit_id: str) -> str | None:
        """The page with the form for a fruit; None where there is no such fruit."""

    def judge(self, fruit_id: str, written: Mapping[str, str]) -> str | None:
        """Keeps a verdict, or gives the page that says why not."""


class _Server(uvicorn.Server):
    """Accepts BACKLOG connections a turn; the others wait in the system."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        for one in sockets or ():
            one.listen(QUEUE)


class PageServer:
    """A page that changes, and the report beside it; used as a context.

    `port` 0: any free one. `tell` gets one sentence when the page stops by itself; it is then started again
    at the same address, every AGAIN_S. Grading does not depend on it. Raises BatchRefused where the port is
    taken, or the server does not start.
    """

    def __init__(
        self,
        results: Results,
        *,
        port: int = 0,
        token: str | None = None,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._results = results
        self._token = token or secrets.token_urlsafe(16)
        self.desk: Desk | None = None
        self._page, self._version, self._closed = "", 0, threading.Event()
        self._tell, self._stopped = tell, False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self._socket.bind((LOOPBACK, port))
            self._socket.listen(QUEUE)
        except OSError as error:
            self._socket.close()
            sentence = f"is not available ({error.strerror}); choose another port, or 0 for any free one."
            raise refused(f"--port {port}", sentence) from None
        self._server = self._new_server()
        self._thread = threading.Thread(target=self._serve, name="drupe page", daemon=True)

    def _new_server(self) -> uvicorn.Server:
        return _Server(
            uvicorn.Config(
                self._app(),
                log_config=None,
                access_log=False,
                lifespan="off",
                http=limited_http(connections_at_once()),  # type: ignore[arg-type]  # a protocol's factory
                ws="none",
                backlog=BACKLOG,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )

    def _serve(self) -> None:
        """Runs the server until the context ends, and again where it stops before."""
        started = False
        while not self._closed.is_set():
            try:
                with self._socket.dup() as listening:
                    self._server.run(sockets=[listening])
                why = "its server ended"
            except (Exception, SystemExit) as error:  # noqa: BLE001 - whatever it is, grading goes on
                why = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
            if self._closed.is_set() or not (started or self._server.started):
                return
            if not self._stopped:
                self._tell(f"the page stopped ({why}); grading continues, and drupe restarts the page")
            started = self._stopped = True
            self._closed.wait(AGAIN_S)
            self._server = self._new_server()

    @property
    def address(self) -> str:
        """Where the page is."""
        return f"http://{LOOPBACK}:{self._socket.getsockname()[1]}/{self._token}/"

    def show(self, page: str) -> None:
        """The page from now on; browsers that have it open show it within a second."""
        self._page, self._version = page, self._version + 1

    def __enter__(self) -> Self:
        """Listens; raises BatchRefused where the server does not start."""
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
        """Stops listening."""
        self._closed.set()
        self._server.should_exit = True
        self._thread.join(STARTS_WITHIN_S)
        self._socket.close()

    def _app(self) -> Starlette:
        return Starlette(
            routes=[
                Route("/{token}/", self._kiosk),
                Route("/{token}/events", self._events),
                Route("/{token}/judge", self._judge, methods=["GET", "POST"]),
                Route("/{token}/{path:path}", self._file),
            ],
            middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[LOOPBACK, "localhost"])],
        )

    def _knows(self, request: Request) -> bool:
        return hmac.compare_digest(request.path_params["token"].encode(), self._token.encode())

    async def _kiosk(self, request: Request) -> Response:
        return HTMLResponse(self._page, headers=HEADERS) if self._knows(request) else _nothing()

    async def _judge(self, request: Request) -> Response:
        """The form for a fruit, or its verdict kept; a form of another site is not taken."""
        fruit_id, desk = request.query_params.get("fruit", ""), self.desk
        if not self._knows(request) or desk is None:
            return _nothing()
        if request.method != "POST":
            page = await asyncio.to_thread(desk.form, fruit_id)
            return _nothing() if page is None else HTMLResponse(page, headers=HEADERS)
        written = await _form(request)
        if written is None or await asyncio.to_thread(desk.form, fruit_id) is None:
            return _nothing()
        page = await asyncio.to_thread(desk.judge, fruit_id, written)
        if page is not None:
            return HTMLResponse(page, status_code=422, headers=HEADERS)
        return RedirectResponse("./", status_code=303, headers=HEADERS)

    async def _events(self, request: Request) -> Response:
        if not self._knows(request):
            return _nothing()
        return StreamingResponse(self._news(), media_type="text/event-stream", headers=HEADERS)

    async def _news(self) -> AsyncIterator[str]:
        sent, quiet_s = -1, 0.0
        while not self._closed.is_set():
            if sent != self._version:
                sent, quiet_s = self._version, 0.0
                yield f"event: changed\ndata: {sent}\n\n"
            elif quiet_s >= SIGN_OF_LIFE_S:
                quiet_s = 0.0
                yield ": no news\n\n"
            await asyncio.sleep(NEWS_S)
            quiet_s += NEWS_S

    async def _file(self, request: Request) -> Response:
        path = self._given(request.path_params["path"]) if self._knows(request) else None
        if path is None:
            return _nothing()
        try:
            content = await asyncio.to_thread(path.read_bytes)
        except OSError:
            return _nothing()
        return Response(content, media_type=MEDIA_TYPES[path.suffix.lower()], headers=HEADERS)

    def _given(self, named: str) -> Path | None:
        """The file of the results that an address names, where it is one that drupe wrote there."""
        parts = named.split("/")
        if any(part in ("", ".", "..") or part.startswith(".") or "\0" in part for part in parts):
            return None
        path = self._results.root.joinpath(*parts)
        own = len(parts) == 1 or (len(parts) == 3 and parts[0] == "fruits")
        folders = [path.parent] if len(parts) == 1 else [path.parent, path.parent.parent]
        if (
            not own
            or path.suffix.lower() not in MEDIA_TYPES
            or any(folder.is_symlink() for folder in folders)
        ):
            return None
        return path if is_ours(path) else None


async def _form(request: Request) -> dict[str, str] | None:
    """The fields of a form of this page; None of one from another site, too long, or too slow."""
    if request.headers.get("sec-fetch-site", "same-origin") != "same-origin":
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


def _nothing() -> Response:
    return PlainTextResponse("not found", status_code=404, headers=HEADERS)
