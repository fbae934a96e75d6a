"""A web server on loopback that answers every request as it is told to, byte by byte."""

import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Generator

Misbehave = Callable[[socket.socket, bytes, bytes], None]  # connection, request, the true file


class Server:
    """Serves `files` by the last part of their address; what is no plain answer is told by name."""

    def __init__(self, files: dict[str, bytes], misbehave: Misbehave) -> None:
        self.files, self.misbehave = files, misbehave
        self.stopped = threading.Event()
        self._socket = socket.create_server(("127.0.0.1", 0), backlog=64)
        self.url = f"http://127.0.0.1:{self._socket.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while not self.stopped.is_set():
            with contextlib.suppress(OSError):
                connection, _ = self._socket.accept()
                threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), connection:
            connection.settimeout(20)
            request = b""
            while b"\r\n\r\n" not in request:
                more = connection.recv(65536)
                if not more:
                    return
                request += more
            path = request.split(b" ", 2)[1].decode(errors="replace").partition("?")[0]
            name = path.rpartition("/")[2]
            self.misbehave(connection, request, self.files.get(name, b""))
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_WR)

    def close(self) -> None:
        self.stopped.set()
        self._socket.close()


@contextlib.contextmanager
def serving(files: dict[str, bytes], misbehave: Misbehave) -> Generator[Server]:
    server = Server(files, misbehave)
    try:
        yield server
    finally:
        server.close()


def plain(connection: socket.socket, request: bytes, data: bytes) -> None:
    """Answer as a good server does."""
    answer(data)(connection, request, data)


def answer(
    body: bytes | None = None, status: str = "200 OK", *headers: str, length: bool = True
) -> Misbehave:
    """Return what sends a body, the true one if None, with a status and headers."""

    def send(connection: socket.socket, request: bytes, data: bytes) -> None:
        sent = data if body is None else body
        lines = [f"HTTP/1.1 {status}", *headers, "Connection: close"]
        if length:
            lines.append(f"Content-Length: {len(sent)}")
        connection.sendall("\r\n".join([*lines, "", ""]).encode("latin-1") + sent)

    return send


def changed(change: Callable[[bytes], bytes]) -> Misbehave:
    """Return what sends another body than the true one, of the length that it has."""
    return lambda connection, request, data: answer(change(data))(connection, request, data)


def raw(*parts: bytes) -> Misbehave:
    """Return what sends these bytes, whatever was asked."""
    return lambda connection, request, data: connection.sendall(b"".join(parts))


def reset(connection: socket.socket, request: bytes, data: bytes) -> None:
    """Break the connection without a good-bye, in the middle of the body."""
    head = f"HTTP/1.1 200 OK\r\nContent-Length: {len(data)}\r\n\r\n".encode()
    connection.sendall(head + data[: len(data) // 2])
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    connection.close()


def endless(start: bytes, block: bytes, pause: float = 0.0) -> Misbehave:
    """Return what sends a start and then the same block until the client goes away."""

    def send(connection: socket.socket, request: bytes, data: bytes) -> None:
        connection.sendall(start)
        while True:
            connection.sendall(block)
            if pause:
                threading.Event().wait(pause)

    return send
