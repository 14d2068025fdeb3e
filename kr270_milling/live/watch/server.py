"""Serve the page and its events (server-sent) on one port, to GET requests only."""

from __future__ import annotations

import contextlib
import json
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from kr270_milling.base.errors import InputError

__all__ = ["Events", "serve"]

MOST = 40_000  #: stored events, for a page that is opened late: 22 minutes of a pass
ALIVE = 10.0  #: [s] of the wall clock between two comments on an idle stream
LOCAL = ("localhost", "127.0.0.1", "[::1]")


class Events:
    """The stored events, and a condition for the streams that wait for more. ``end`` is the last event."""

    def __init__(self):
        self._rows: list[str] = []
        self._first = 0  # number of the oldest stored row
        self._changed = threading.Condition()
        self.ended = False

    def add(self, event: dict) -> None:
        with self._changed:
            self._rows.append(json.dumps(event, allow_nan=False))
            beyond = max(0, len(self._rows) - MOST)
            self._first += beyond
            del self._rows[:beyond]
            self.ended |= event.get("kind") == "end"
            self._changed.notify_all()

    def after(self, number: int, patience: float = ALIVE) -> tuple[list[str], int]:
        """Return the rows from ``number`` on and the number of the next row; wait up to ``patience`` [s] for a row."""
        with self._changed:
            self._changed.wait_for(lambda: self._first + len(self._rows) > number or self.ended, patience)
            start = max(0, number - self._first)
            return self._rows[start:], self._first + len(self._rows)


class _Handler(BaseHTTPRequestHandler):
    """GET / and GET /events."""

    protocol_version = "HTTP/1.1"

    def __init__(self, events: Events, page: str, hosts: tuple[str, ...], *args):
        self.events = events
        self.page = page
        self.hosts = hosts
        super().__init__(*args)

    def handle(self) -> None:
        with contextlib.suppress(ConnectionError):  # the page was closed
            super().handle()

    def do_GET(self) -> None:
        host = (self.headers.get("Host") or "").rpartition(":")[0] or self.headers.get("Host")
        if self.hosts and host not in self.hosts:  # another name with this address (DNS rebinding)
            self.send_error(403)
        elif self.path == "/":
            body = self.page.encode()
            self._head("text/html; charset=utf-8", ("Content-Length", str(len(body))))
            self.wfile.write(body)
        elif self.path == "/events":
            self._stream()
        else:
            self.send_error(404)

    def _head(self, kind: str, more: tuple[str, str]) -> None:
        self.send_response(200)
        for name, value in (("Content-Type", kind), ("Cache-Control", "no-store"), more):
            self.send_header(name, value)
        self.end_headers()

    def _stream(self) -> None:
        self._head("text/event-stream", ("Connection", "close"))
        self.close_connection = True
        number = 0
        while True:
            ended = self.events.ended
            rows, number = self.events.after(number)
            self.wfile.write("".join(f"data: {row}\n\n" for row in rows).encode() or b": alive\n\n")
            self.wfile.flush()
            if ended and not rows:
                return

    def log_message(self, *_) -> None:
        """Print no line for a request."""


def serve(events: Events, page: str, host: str, port: int) -> ThreadingHTTPServer:
    """Start to serve the HTML text ``page`` and its events in a thread; port 0: any free port.

    Raises InputError where the address cannot be used.
    """
    hosts = LOCAL if host in (*LOCAL, "::1") else ()
    try:
        server = ThreadingHTTPServer((host, port), partial(_Handler, events, page, hosts))
    except (OSError, OverflowError) as error:
        raise InputError(f"{host}:{port}", f"cannot be served at: {error}") from None
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True).start()
    return server
