"""A report on localhost: one page in memory, and nothing else of this machine."""

from collections.abc import Iterator
from contextlib import contextmanager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from fbench.replay.contracts.errors import ConfigError, output_error

HOST = "127.0.0.1"
_PAGES = ("/", "/report.html")
_MAX_PORT = 65535
_TIMEOUT_S = 10.0


@contextmanager
def open_server(page: bytes, port: int = 0) -> Iterator[ThreadingHTTPServer]:
    """Open a server of a page on localhost, which answers in `serve_forever`; port 0: any that is free. Raises
    ConfigError where there is no such port, or another program has it.
    """
    if not 0 <= port <= _MAX_PORT:
        raise ConfigError(f"port {port}: expected 0 to {_MAX_PORT}")

    class Handler(_Handler):
        content = page

    try:
        server = ThreadingHTTPServer((HOST, port), Handler)
    except OSError as error:
        raise output_error(f"port {port}", error, "; choose another one, or 0 for any") from error
    with server:
        yield server


def url_of(server: ThreadingHTTPServer) -> str:
    """Where a browser finds the page."""
    return f"http://{HOST}:{server.server_address[1]}/"


class _Handler(BaseHTTPRequestHandler):
    """Answers with the page, whatever file of this name there is: no path leads to the disk."""

    content = b""
    server_version, sys_version = "fbench", ""
    timeout = _TIMEOUT_S  # So that a client that says nothing holds no thread for ever

    def do_GET(self) -> None:
        """Send the page."""
        self._answer(has_body=True)

    def do_HEAD(self) -> None:
        """Send the head of the page."""
        self._answer(has_body=False)

    def _answer(self, *, has_body: bool) -> None:
        # A page of another site, whose name was made to lead here, may not read the report.
        port = self.connection.getsockname()[1]
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            self.send_error(HTTPStatus.FORBIDDEN)
        elif self.path.partition("?")[0] not in _PAGES:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(self.content)))
            self.send_header("Cache-Control", "no-store")
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Cross-Origin-Resource-Policy", "same-origin")
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            if has_body:
                self.wfile.write(self.content)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the name that the library gives it
        """Say nothing about requests: what they name could steer a terminal."""
