"""A local HTTP server in place of those that publish weights, and entries that name it."""

import hashlib
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from fbench.pipelines.models.weights import Entry

CONTENT = bytes(range(256)) * 9000
"""What the right file holds: 2.3 MB, several blocks."""

Answer = Callable[[BaseHTTPRequestHandler], object]


@dataclass
class Server:
    """Answers by path; what was asked for is kept."""

    origin: str
    answers: dict[str, Answer] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    released: threading.Event = field(default_factory=threading.Event)

    def entry(self, path: str = "/tiny.onnx", origins: tuple[str, ...] = (), content: bytes = CONTENT) -> Entry:
        """The entry `tiny`, to be fetched from this path."""
        return Entry(
            "tiny", "Tiny", "Nobody", "MIT", 1.5, (8, 8), "http://page", self.origin + path, origins or (self.origin,),
            len(content), hashlib.sha256(content).hexdigest(),
        )  # fmt: skip


def sends(body: bytes, num_bytes: int | None = None) -> Answer:
    """Answer with a body; `num_bytes` is what its header claims."""

    def answer(request: BaseHTTPRequestHandler) -> None:
        request.send_response(200)
        request.send_header("Content-Length", str(len(body) if num_bytes is None else num_bytes))
        request.end_headers()
        request.wfile.write(body)

    return answer


def cut_chunk(request: BaseHTTPRequestHandler) -> None:
    """Begin a chunk of 4096 bytes, and end within it."""
    request.protocol_version = "HTTP/1.1"
    request.send_response(200)
    request.send_header("Transfer-Encoding", "chunked")
    request.end_headers()
    request.wfile.write(b"1000\r\nonly this")
    request.close_connection = True


def fails(code: int) -> Answer:
    """Answer with an error."""
    return lambda request: request.send_error(code)


def redirects(to: str, code: int = 302) -> Answer:
    """Answer with a redirection."""

    def answer(request: BaseHTTPRequestHandler) -> None:
        request.send_response(code)
        request.send_header("Location", to)
        request.end_headers()

    return answer


@contextmanager
def serving() -> Iterator[Server]:
    """Run a server on a free port while the `with` block runs."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            server.asked.append(self.path)
            server.answers[self.path](self)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 its name in the standard library
            """Keep quiet."""

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server = Server(f"http://127.0.0.1:{http.server_port}")
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield server
    finally:
        server.released.set()
        http.shutdown()
        http.server_close()
        thread.join()
