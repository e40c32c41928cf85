"""Limits of the page of `drupe watch`: number of connections, and the time that each may wait.

A connection that never sends a request occupies a file descriptor, and grading needs those.
"""

import asyncio
import socket
from typing import Any, Self

from uvicorn.protocols.http.h11_impl import H11Protocol

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
