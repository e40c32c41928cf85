"""How many connections the page of `drupe watch` accepts, and how long each may wait with its request.

A connection that never sends a whole request costs a file descriptor, and grading needs those.
"""

import asyncio
import socket
from typing import Any, Self

from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 64
"""Connections at once. A browser opens at most six for one page."""
QUEUE = 256
"""Connections that wait in the system for their turn: they cost this process no file descriptor."""
MOST_OF_ADDRESS = 16
"""Connections of one address of a network at once: two browsers with six each."""
REQUEST_S = 10.0
"""Seconds within which a connection must send the whole head of its next request."""


class CappedSocket(socket.socket):
    """A listening socket that closes what comes while so many of its connections are open, of all addresses
    or of one.
    """

    most_of_address: int
    _open: list[tuple[socket.socket, str]]

    def capped(self, *, most_of_address: int) -> Self:
        """This socket, with its limits."""
        self.most_of_address, self._open = most_of_address, []
        return self

    def accept(self) -> tuple[socket.socket, Any]:
        """As every socket; asyncio goes on after ConnectionAbortedError."""
        connection, address = super().accept()
        self._open = [(held, host) for held, host in self._open if held.fileno() >= 0]
        of_address = sum(host == address[0] for _, host in self._open)
        if len(self._open) >= MOST_CONNECTIONS or of_address >= self.most_of_address:
            connection.close()
            raise ConnectionAbortedError
        self._open.append((connection, address[0]))
        return connection, address


class PromptHTTP(H11Protocol):
    """A protocol for uvicorn that closes a connection without a whole request within REQUEST_S, also while
    single bytes arrive.
    """

    def connection_made(self, transport: Any) -> None:
        """The time for the first request begins."""
        super().connection_made(transport)
        self._deadline: asyncio.TimerHandle = self.loop.call_later(REQUEST_S, self._end_if_waiting)

    def connection_lost(self, exc: Exception | None) -> None:
        """There is no time to keep any more."""
        self._deadline.cancel()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """The time for the next request begins."""
        self._deadline.cancel()
        self._deadline = self.loop.call_later(REQUEST_S, self._end_if_waiting)
        super().on_response_complete()

    def _end_if_waiting(self) -> None:
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()
