"""Requests to the page of `drupe watch`."""

import http.client
from contextlib import closing
from urllib.parse import urlencode, urlsplit


def connected(server):
    """A connection that is closed at the end of its block."""
    address = urlsplit(server.address)
    return closing(http.client.HTTPConnection(address.hostname, address.port, timeout=10))


def answer_to(connection, path, form=None, *, method=None, **headers):
    """Status, headers and text of the only answer; with a form it is sent."""
    names = {name.replace("_", "-"): text for name, text in headers.items()}
    body = None if form is None else urlencode(form)
    with connection as opened:
        opened.request(method or ("GET" if form is None else "POST"), path, body=body, headers=names)
        with opened.getresponse() as answer:
            return answer.status, dict(answer.getheaders()), answer.read().decode()
