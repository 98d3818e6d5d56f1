"""A report on localhost: the page, and nothing else."""

import http.client
import socket
import threading
from collections.abc import Iterator

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.reports.serve import open_server, url_of

PAGE = "<!doctype html><title>ü</title>".encode()


@pytest.fixture
def port() -> Iterator[int]:
    with open_server(PAGE) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def ask(port: int, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    connection.putrequest(method, path, skip_host="Host" in headers)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response.status, content, {name.lower(): value for name, value in response.getheaders()}


def test_the_page_is_served(port: int) -> None:
    for path in ("/", "/report.html", "/?x=1"):
        status, content, headers = ask(port, path)
        assert (status, content) == (200, PAGE)
        assert headers["content-type"] == "text/html; charset=utf-8"
        assert (headers["x-content-type-options"], headers["cache-control"]) == ("nosniff", "no-store")
        assert headers["server"].strip() == "fbench"
    status, content, headers = ask(port, "/", "HEAD")
    assert (status, content, headers["content-length"]) == (200, b"", str(len(PAGE)))


@pytest.mark.parametrize(
    "path", ["/manifest.json", "/../manifest.json", "/%2e%2e/etc/passwd", "//etc/passwd", "/report.html/..",
             "/etc/passwd", "/..%5c..", "/report.html%00"],
)  # fmt: skip
def test_nothing_else_is(port: int, path: str) -> None:
    assert ask(port, path)[0] == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_can_be_changed(port: int, method: str) -> None:
    assert ask(port, "/", method)[0] == 501


def test_names_of_other_sites_are_refused(port: int) -> None:
    assert ask(port, "/", Host=f"evil.example:{port}")[0] == 403
    assert ask(port, "/", Host=f"localhost:{port}")[0] == 200


def test_only_this_machine_can_ask() -> None:
    with open_server(PAGE) as server:
        assert server.server_address[0] == "127.0.0.1"
        assert url_of(server) == f"http://127.0.0.1:{server.server_address[1]}/"


def test_errors_say_what_to_do() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        number = taken.getsockname()[1]
        with pytest.raises(ConfigError, match=rf"port {number}: .*choose another one, or 0"), open_server(PAGE, number):
            pass
    with pytest.raises(ConfigError, match="port 70000: expected 0 to 65535"), open_server(PAGE, 70000):
        pass
