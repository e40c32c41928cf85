"""How many connections the page of `drupe watch` accepts, and how long each may wait with its request.

uvicorn's `limit_concurrency` counts parsed requests only. A connection that never sends a whole request costs
a file descriptor all the same, and grading needs those.
"""

import asyncio
import resource
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 64
"""Connections at once. A browser opens at most six for one page."""
BACKLOG = 16
"""Connections that are accepted in one turn of the event loop, before the limit acts."""
QUEUE = 256
"""Connections that wait in the system for their turn: they cost this process no file descriptor."""
TURNS = 4
"""Turns until one beyond the limit is closed."""
RESERVED_FILES = 128
"""File descriptors that are left to grading. A fruit needs some ten; reports and records a few at a time."""
FEWEST_CONNECTIONS = 8
"""Connections at once where few file descriptors are free."""
SHARE_OF_ADDRESS = 4
"""One address of a network has at most a quarter of the connections at once: two browsers with six each."""
REQUEST_S = 10.0
"""Seconds within which a connection must send the whole head of its next request."""


def connections_at_once() -> int:
    """Connections that leave RESERVED_FILES file descriptors to grading."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limit == resource.RLIM_INFINITY:
        return MOST_CONNECTIONS
    try:
        open_now = len(list(Path("/proc/self/fd").iterdir()))
    except OSError:
        open_now = 0
    free = limit - open_now - RESERVED_FILES - TURNS * BACKLOG
    return max(FEWEST_CONNECTIONS, min(MOST_CONNECTIONS, free))


class CappedSocket(socket.socket):
    """A listening socket that closes what comes while so many of its connections are open, of all addresses
    or of one.

    `limited_http` sees a connection only after the handshake of TLS, and each costs a file descriptor before.
    """

    most: int
    most_of_address: int
    _open: list[tuple[socket.socket, str]]

    def capped(self, most: int, *, most_of_address: int) -> Self:
        """This socket, with its limits."""
        self.most, self.most_of_address, self._open = most, most_of_address, []
        return self

    def accept(self) -> tuple[socket.socket, Any]:
        """As every socket; asyncio goes on after ConnectionAbortedError."""
        connection, address = super().accept()
        self._open = [(held, host) for held, host in self._open if held.fileno() >= 0]
        of_address = sum(host == address[0] for _, host in self._open)
        if len(self._open) >= self.most or of_address >= self.most_of_address:
            connection.close()
            raise ConnectionAbortedError
        self._open.append((connection, address[0]))
        return connection, address


def limited_http(most: int, *, request_s: float = REQUEST_S) -> Callable[..., asyncio.Protocol]:
    """A protocol for uvicorn that holds `most` connections at once.

    One more takes the place of the oldest that has no request at work; where all are at work it is closed.
    A connection without a whole request within `request_s` is closed, also while single bytes arrive.
    """

    held: dict[Any, None] = {}  # in the order in which they came

    class LimitedHTTP(H11Protocol):
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            held[self] = None
            self._deadline = self.loop.call_later(request_s, self._end_if_waiting)
            if len(held) > most:
                next((protocol for protocol in held if not protocol.at_work), self).end()

        def connection_lost(self, exc: Exception | None) -> None:
            held.pop(self, None)
            self._deadline.cancel()
            super().connection_lost(exc)

        def on_response_complete(self) -> None:
            self._deadline.cancel()
            self._deadline = self.loop.call_later(request_s, self._end_if_waiting)
            super().on_response_complete()

        @property
        def at_work(self) -> bool:
            """Whether a request is being answered."""
            return self.cycle is not None and not self.cycle.response_complete

        def end(self) -> None:
            """Closes the connection at once."""
            held.pop(self, None)
            self.transport.abort()

        def _end_if_waiting(self) -> None:
            if not self.at_work:
                self.end()

    return LimitedHTTP
