"""`fbench weights`, and its names in other commands."""

import json
import socket
from pathlib import Path

import pytest
from tests.weights_server import CONTENT, fails, sends, serving

from fbench.cli.weights import get_weights, show_weights
from fbench.pipelines.models.weights import CATALOGUE, find_entry
from fbench.pipelines.variants.late import Late3DParams
from fbench.replay.contracts.errors import ModelError
from fbench.replay.contracts.settings import apply_settings, describe

FEMTO = "weights/deimv2_femto/deimv2_hgnetv2_femto_coco.onnx"


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "weights"


@pytest.fixture
def offline(monkeypatch):
    """A proxy that nobody runs, so that no test ever reaches a network."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("https_proxy", f"http://127.0.0.1:{free.getsockname()[1]}")
        monkeypatch.delenv("no_proxy", raising=False)
        monkeypatch.delenv("NO_PROXY", raising=False)
        yield


def test_list(fbench, cache):
    result = fbench("weights", "list")
    assert result.code == 0
    lines = result.out.splitlines()
    assert lines[0].split() == ["name", "licence", "COCO", "AP", "MB", "input", "here", "model"]
    assert [line.split()[0] for line in lines[1:-1]] == [entry.name for entry in CATALOGUE]
    assert "yolox-nano    Apache-2.0     25.8    3.7  416x416  –     YOLOX-Nano, Megvii" in result.out
    assert lines[-1] == f"kept in {cache}"
    assert not cache.exists()


def test_list_for_machines(fbench, cache):
    rows = fbench("weights", "list", "--json").json()
    assert [row["name"] for row in rows] == [entry.name for entry in CATALOGUE]
    (nano,) = [row for row in rows if row["name"] == "yolox-nano"]
    assert nano["path"] == str(cache / "yolox_nano.onnx")
    assert (nano["state"], nano["licence"], nano["coco_ap"], nano["input_wh"]) == (
        "absent",
        "Apache-2.0",
        25.8,
        [416, 416],
    )
    assert nano["url"].startswith("https://github.com/Megvii-BaseDetection/YOLOX/releases/")


def test_get_from_a_server_once(monkeypatch, capsys, cache):
    monkeypatch.setenv("no_proxy", "*")
    with serving() as server:
        server.answers["/tiny.onnx"] = sends(CONTENT)
        entry = server.entry()
        get_weights(entry, None)
        assert (cache / "tiny.onnx").read_bytes() == CONTENT
        first = capsys.readouterr()
        assert first.out.splitlines() == [
            f"{cache / 'tiny.onnx'}: Tiny by Nobody, MIT, sha256 checked",
            "use it with --set camera.weights=tiny",
        ]
        assert first.err == ""  # no progress where there is no terminal
        get_weights(entry, None)
        assert capsys.readouterr().out.startswith(f"{cache / 'tiny.onnx'}: there already, sha256 checked\n")
        assert server.asked == ["/tiny.onnx"]


def test_get_replaces_what_is_damaged(monkeypatch, capsys, cache):
    monkeypatch.setenv("no_proxy", "*")
    cache.mkdir(parents=True)
    (cache / "tiny.onnx").write_bytes(CONTENT[:-1] + b"?")
    with serving() as server:
        entry = server.entry()
        server.answers["/tiny.onnx"] = fails(500)
        with pytest.raises(ModelError, match="500"):
            get_weights(entry, None)
        show_weights([entry], as_json=True)
        assert json.loads(capsys.readouterr().out)[0]["state"] == "damaged"
        server.answers["/tiny.onnx"] = sends(CONTENT)
        get_weights(entry, None)
    capsys.readouterr()
    show_weights([entry], as_json=False)
    assert " yes " in capsys.readouterr().out


def test_what_was_put_there_by_hand_counts(capsys, cache):
    with serving() as server:
        cache.mkdir(parents=True)
        (cache / "tiny.onnx").write_bytes(CONTENT)
        get_weights(server.entry(), None)
        assert server.asked == []
    assert "there already" in capsys.readouterr().out


@pytest.mark.usefixtures("offline")
def test_without_a_network_the_error_says_what_to_do(fbench, cache):
    result = fbench("weights", "get", "yolox-nano")
    assert result.code == 3
    assert result.out == ""
    assert result.err == (
        "fbench: https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0/yolox_nano.onnx: can't be "
        f"fetched (Connection refused); fetch it in another way and put it at {cache / 'yolox_nano.onnx'}, or give it "
        "to: fbench weights get yolox-nano --from FILE\n"
    )
    assert list(cache.iterdir()) == []


@pytest.mark.parametrize(
    ("args", "code", "line"),
    [
        (("yolo-nano",), 2, "unknown weights 'yolo-nano'; did you mean 'yolox-nano'?"),
        (("yolox-nano", "--from", "none.onnx"), 2, "none.onnx: weights can't be read (No such file or directory)"),
        (("yolox-nano", "--from", "other.onnx"), 3,
         "other.onnx: ends after 5 of the 3659407 bytes of yolox-nano, fetch it again"),
    ],
)  # fmt: skip
def test_what_cannot_be_taken(fbench, tmp_path, args, code, line):
    (tmp_path / "other.onnx").write_bytes(b"other")
    result = fbench("weights", "get", *args)
    assert (result.code, result.err) == (code, f"fbench: {line}\n")


def test_a_cache_that_cannot_be_written(fbench, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    (tmp_path / "other.onnx").write_bytes(b"other")
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "file"))
    result = fbench("weights", "get", "yolox-nano", "--from", "other.onnx")
    assert result.code == 3
    assert len(result.err.splitlines()) == 1
    assert (
        "yolox_nano.onnx can't be written there (Not a directory); FBENCH_CACHE may name another folder" in result.err
    )
    assert fbench("weights", "list").code == 0


def test_names_where_a_path_is_expected(fbench, log):
    result = fbench("replay", log, "-p", "camera2d", "--set", "camera.weights=deimv2-femto")
    assert result.code == 2
    assert "weights 'deimv2-femto' aren't at " in result.err
    assert result.err.endswith(": fbench weights get deimv2-femto\n")
    result = fbench("replay", log, "-p", "late3d", "--set", "camera.weights=deimv2-fento")
    assert (result.code, result.err) == (2, "fbench: unknown weights 'deimv2-fento'; did you mean 'deimv2-femto'?\n")


@pytest.mark.parametrize(
    ("pipeline", "sensor"), [("camera2d", "camera"), ("late3d", "cam"), ("thesis/late3d", "camera")]
)
@pytest.mark.parametrize(
    ("weights", "reason"),
    [
        ("x" * 300, "unknown weights 'xxx"),
        ("x" * 300 + ".onnx", "xxx.onnx: "),
        ("no\0name.onnx", "name.onnx: "),
        ("models", "weights 'models': a folder; name an ONNX file"),
        ("models/", "weights 'models': a folder"),
        ("./models/more", "models/more: "),
        ("", "weights '.': a folder"),
        ("~nobody-of-this-name/a.onnx", "~nobody-of-this-name/a.onnx: "),
    ],
)
def test_paths_that_can_be_no_weights(fbench, log, pipeline, sensor, weights, reason):
    Path("models/more").mkdir(parents=True)
    result = fbench("replay", log, "-p", pipeline, "--set", f"{sensor}.weights={weights}", "-o", "run")
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    assert result.err.startswith("fbench: ")
    assert reason in result.err
    for raw in ("Error", "Errno", "can't be made"):
        assert raw not in result.err
    assert not Path("run").exists()


def test_a_run_with_a_name_tells_the_file(fbench, log, shared, tmp_path):
    if not (shared / FEMTO).exists():
        pytest.skip(f"no weights at {shared / FEMTO}")
    entry = find_entry("deimv2-femto")
    assert fbench("weights", "get", entry.name, "--from", shared / FEMTO).code == 0
    result = fbench("replay", log, "-p", "camera2d", "--set", f"camera.weights={entry.name}", "-o", "run")
    assert result.code == 0
    expected = {"file": entry.file_name, "sha256": entry.sha256}
    assert json.loads((tmp_path / "run" / "manifest.json").read_text())["parameters"]["camera.weights"] == expected
    of_one = apply_settings(Late3DParams(), [f"left.weights={entry.name}"])
    assert describe(of_one)["left.weights"] == expected
