"""A TCP connection to a server that breaks after some bytes."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

Address = tuple[str, int]


class BrokenLink:
    """Relays connections to a server. The first `breaks` answers end after `bytes_each` bytes."""

    def __init__(self, server: Address, breaks: int, bytes_each: int) -> None:
        self.server = server
        self.breaks = breaks
        self.bytes_each = bytes_each
        self.broken = 0
        self.listener = socket.create_server(("127.0.0.1", 0))
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def address(self) -> Address:
        host, port = self.listener.getsockname()
        return host, port

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self.listener.accept()
                server = socket.create_connection(self.server)
                threading.Thread(target=self._relay, args=(client, server, None), daemon=True).start()
                limit = self.bytes_each if self.broken < self.breaks else None
                threading.Thread(target=self._relay, args=(server, client, limit), daemon=True).start()

    def _relay(self, source: socket.socket, sink: socket.socket, limit: int | None) -> None:
        passed = 0
        with suppress(OSError):
            while data := source.recv(4096):
                if limit is not None and passed + len(data) > limit:
                    self.broken += 1
                    break
                sink.sendall(data)
                passed += len(data)
        for end in (source, sink):
            with suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)


@contextmanager
def broken_link(server: Address, breaks: int, bytes_each: int) -> Iterator[BrokenLink]:
    link = BrokenLink(server, breaks, bytes_each)
    try:
        yield link
    finally:
        link.listener.close()
