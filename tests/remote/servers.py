"""Servers on loopback: files over HTTP, S3, and a wire in front of them that fails on purpose."""

import contextlib
import socket
import threading
import time

import uvicorn
from starlette.applications import Starlette
from starlette.routing import Mount
from starlette.staticfiles import StaticFiles


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def wait_for(port):
    for _ in range(500):
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        time.sleep(0.02)
    raise TimeoutError(f"nothing listens on port {port}")


@contextlib.contextmanager
def http_server(directory):
    """A server of a directory that knows ranges; yields its port."""
    app = Starlette(routes=[Mount("/", StaticFiles(directory=directory))])
    port = free_port()
    server = uvicorn.Server(uvicorn.Config(app, port=port, log_level="critical"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    wait_for(port)
    try:
        yield port
    finally:
        server.should_exit = True
        thread.join()


class Wire:
    """Passes connections on to a server, and does to its answers what it is told.

    `cut_after` closes a connection after so many bytes of an answer, the first `cuts` times that it
    applies; `corrupt` is told the path that was asked for and the bytes of an answer's next piece,
    and returns what to send instead; `refuse` closes so many connections at once, before they ask
    anything; without `ranges` the server is not told that a part was asked for; `invent` is told
    path and range and returns an answer of its own, or None.
    """

    def __init__(self, target):
        self.target = target
        self.port = free_port()
        self.cut_after = None
        self.cuts = 1 << 30
        self.ranges = True
        self.invent = None
        self.corrupt = None
        self.refuse = 0
        self.requests = []
        self.sent = 0
        self.listener = socket.create_server(("127.0.0.1", self.port))
        self.stopped = False
        self.thread = threading.Thread(target=self.accept, daemon=True)
        self.thread.start()

    @property
    def paths(self):
        return [path for path, _ in self.requests]

    def accept(self):
        while not self.stopped:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            if self.refuse > 0:
                self.refuse -= 1
                client.close()
                continue
            threading.Thread(target=self.serve, args=(client,), daemon=True).start()

    def serve(self, client):
        with client, socket.create_connection(("127.0.0.1", self.target)) as server:
            with contextlib.suppress(OSError):
                while request := self.read_head(client):
                    lines = request.decode("latin-1").split("\r\n")
                    path = lines[0].split(" ")[1]
                    headers = dict(line.lower().split(": ", 1) for line in lines[1:] if ": " in line)
                    self.requests.append((path, headers.get("range")))
                    if self.invent and (pieces := self.invent(path, headers.get("range"))):
                        for piece in pieces:
                            client.sendall(piece)
                        return
                    if not self.ranges:
                        lines = [line for line in lines if not line.lower().startswith("range:")]
                        request = "\r\n".join(lines).encode("latin-1")
                    server.sendall(request)
                    if not self.answer(path, client, server):
                        return

    @staticmethod
    def read_head(connection):
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            byte = connection.recv(1)
            if not byte:
                return b""
            head += byte
        return head

    def answer(self, path, client, server):
        """Passes one answer on; false if the connection is to be closed."""
        head = self.read_head(server)
        client.sendall(head)
        lines = head.decode("latin-1").lower().split("\r\n")
        length = next(int(line.split(": ")[1]) for line in lines if line.startswith("content-length"))
        passed = 0
        while passed < length:
            piece = server.recv(min(1 << 14, length - passed))
            if not piece:
                return False
            if self.corrupt:
                piece = self.corrupt(path, passed, piece)
            if self.cut_after is not None and self.cuts and passed + len(piece) > self.cut_after:
                self.cuts -= 1
                client.sendall(piece[: self.cut_after - passed])
                self.sent += self.cut_after - passed
                return False
            client.sendall(piece)
            passed += len(piece)
            self.sent += len(piece)
        return True

    def close(self):
        self.stopped = True
        self.listener.close()
