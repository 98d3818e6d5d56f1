"""Weights come whole from where their entry says, or not at all."""

import socket
from pathlib import Path

import pytest
from tests.weights_server import CONTENT, Server, cut_chunk, fails, redirects, sends, serving

from fbench.pipelines.models.weights import Entry, download, origin, store
from fbench.replay.contracts.errors import ModelError


@pytest.fixture(autouse=True)
def _no_proxies(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("no_proxy", "*")


@pytest.fixture
def server():
    with serving() as server:
        yield server


@pytest.fixture
def target(tmp_path: Path) -> Path:
    return tmp_path / "cache" / "weights" / "tiny.onnx"


def fetch(entry: Entry, target: Path, timeout_s: float = 5.0) -> None:
    store(entry, download(entry, target, timeout_s), entry.url, target)


def refused(entry: Entry, target: Path, timeout_s: float = 5.0) -> str:
    """What is said where nothing is taken; what was there before stays, and nothing else."""
    target.parent.mkdir(parents=True)
    target.write_bytes(b"before")
    with pytest.raises(ModelError) as error:
        fetch(entry, target, timeout_s)
    assert [p.name for p in target.parent.iterdir()] == ["tiny.onnx"]
    assert target.read_bytes() == b"before"
    assert error.value.exit_code == 3
    assert "\n" not in str(error.value)
    return str(error.value)


def test_the_right_file(server: Server, target: Path):
    server.answers["/tiny.onnx"] = sends(CONTENT)
    fetch(server.entry(), target)
    assert target.read_bytes() == CONTENT
    assert [p.name for p in target.parent.iterdir()] == ["tiny.onnx"]


def test_a_file_of_the_same_length_with_other_content(server: Server, target: Path):
    server.answers["/tiny.onnx"] = sends(CONTENT[::-1])
    said = refused(server.entry(), target)
    assert said.startswith(f"{server.origin}/tiny.onnx: isn't tiny as published, not taken (sha256 ")
    assert server.entry().sha256 in said


@pytest.mark.parametrize("claimed", [len(CONTENT), 1000])
def test_a_cut_transfer(server: Server, target: Path, claimed: int):
    server.answers["/tiny.onnx"] = sends(CONTENT[:1000], claimed)
    assert "tiny.onnx: ends after 1000 of the 2304000 bytes of tiny, fetch it again" in refused(server.entry(), target)


def test_a_cut_chunk(server: Server, target: Path):
    server.answers["/tiny.onnx"] = cut_chunk
    assert "of the 2304000 bytes" in (said := refused(server.entry(), target)) or "the transfer was cut" in said


def test_nothing_at_all(server: Server, target: Path):
    server.answers["/tiny.onnx"] = sends(b"")
    assert "ends after 0 of the 2304000 bytes" in refused(server.entry(), target)


def test_more_bytes_than_expected(server: Server, target: Path):
    server.answers["/tiny.onnx"] = sends(CONTENT + b"!")
    assert "tiny.onnx: longer than the 2304000 bytes of tiny, not taken" in refused(server.entry(), target)


@pytest.mark.parametrize("code", [301, 302, 303, 307, 308])
def test_redirections_between_allowed_origins(server: Server, target: Path, code: int):
    with serving() as other:
        server.answers["/tiny.onnx"] = redirects(f"{other.origin}/asset?token=1", code)
        other.answers["/asset?token=1"] = sends(CONTENT)
        fetch(server.entry(origins=(server.origin, other.origin)), target)
    assert target.read_bytes() == CONTENT


def test_a_redirection_within_the_host(server: Server, target: Path):
    server.answers |= {"/tiny.onnx": redirects("moved"), "/moved": sends(CONTENT)}
    fetch(server.entry(), target)
    assert target.read_bytes() == CONTENT


def test_a_redirection_elsewhere_is_not_followed(server: Server, target: Path):
    with serving() as other:
        server.answers["/tiny.onnx"] = redirects(f"{other.origin}/tiny.onnx")
        said = refused(server.entry(), target)
        assert said == f"{server.origin}/tiny.onnx: redirects to {other.origin}, not followed"
        assert other.asked == []


def test_neither_is_one_by_the_old_header(server: Server, target: Path):
    def answer(request):
        request.send_response(302)
        request.send_header("URI", f"{other.origin}/tiny.onnx")
        request.end_headers()

    with serving() as other:
        other.answers["/tiny.onnx"] = sends(CONTENT)
        server.answers["/tiny.onnx"] = answer
        assert refused(server.entry(), target).endswith(f"redirects to {other.origin}, not followed")
        assert other.asked == []


@pytest.mark.parametrize(
    ("to", "where"),
    [
        ("https://example.org/tiny.onnx", "https://example.org"),
        ("http://example.org/tiny.onnx", "http://example.org"),
        ("file:///etc/passwd", "file://"),
        ("ftp://127.0.0.1/tiny.onnx", "ftp://127.0.0.1"),
        ("//example.org/tiny.onnx", "http://example.org"),
        ("http://[broken/tiny.onnx", "a broken address"),
    ],
)
def test_neither_are_other_schemes_and_hosts(server: Server, target: Path, to: str, where: str):
    server.answers["/tiny.onnx"] = redirects(to)
    assert refused(server.entry(), target).endswith(f"tiny.onnx: redirects to {where}, not followed")


def test_from_https_to_http_is_another_origin(server: Server, target: Path):
    server.answers["/tiny.onnx"] = redirects(f"{server.origin}/plain")
    entry = server.entry(origins=(server.origin.replace("http:", "https:"),))
    assert refused(entry, target).endswith(f"redirects to {server.origin}, not followed")
    assert origin("https://GitHub.com/a") == "https://github.com"
    assert origin("https://github.com@example.org/a") != "https://github.com"


def test_redirections_in_a_circle(server: Server, target: Path):
    server.answers |= {"/tiny.onnx": redirects("/b"), "/b": redirects("/tiny.onnx")}
    assert "can't be fetched (the server says 302" in refused(server.entry(), target)


def test_a_redirection_without_a_place(server: Server, target: Path):
    def answer(request):
        request.send_response(302)
        request.end_headers()

    server.answers["/tiny.onnx"] = answer
    assert "can't be fetched (the server says 302" in refused(server.entry(), target)


@pytest.mark.parametrize(("code", "text"), [(404, "Not Found"), (500, "Internal Server Error")])
def test_errors_of_the_server(server: Server, target: Path, code: int, text: str):
    server.answers["/tiny.onnx"] = fails(code)
    assert refused(server.entry(), target) == (
        f"{server.origin}/tiny.onnx: can't be fetched (the server says {code} {text}); fetch it in another way and put "
        f"it at {target}, or give it to: fbench weights get tiny --from FILE"
    )


def test_no_network(server: Server, target: Path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # nobody listens there
        closed = Server(f"http://127.0.0.1:{free.getsockname()[1]}")
        said = refused(closed.entry(), target)
    assert f"can't be fetched (Connection refused); fetch it in another way and put it at {target}" in said


def test_a_proxy_with_a_broken_address(server: Server, target: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("no_proxy")
    monkeypatch.setenv("http_proxy", "http:/user:secret@proxy")
    said = refused(server.entry(), target)
    assert "can't be fetched (the environment names a proxy whose address is broken); fetch it in another way" in said
    assert "secret" not in said


def test_a_server_that_hangs(server: Server, target: Path):
    server.answers["/tiny.onnx"] = lambda request: server.released.wait(10)
    assert "can't be fetched (no answer within 0.2 s)" in refused(server.entry(), target, timeout_s=0.2)


def test_a_server_that_stops_halfway(server: Server, target: Path):
    def answer(request):
        sends(CONTENT[:100], len(CONTENT))(request)
        request.wfile.flush()
        server.released.wait(10)

    server.answers["/tiny.onnx"] = answer
    assert "can't be fetched (no answer within 0.2 s)" in refused(server.entry(), target, timeout_s=0.2)


def test_what_is_no_http(server: Server, target: Path):
    server.answers["/tiny.onnx"] = lambda request: request.wfile.write(b"\x00\x01\x02\r\n\r\n")
    assert "can't be fetched (no valid answer)" in refused(server.entry(), target)
