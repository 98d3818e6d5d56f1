"""`fbench weights train`, and what it says where it can't."""

import importlib.util
import json
import os

import pytest
from tests.city_log import write_city_log

HAS_TORCH = all(importlib.util.find_spec(name) for name in ("torch", "onnx"))
with_torch = pytest.mark.skipif(not HAS_TORCH, reason="torch is an extra")


@pytest.mark.skipif(HAS_TORCH, reason="torch is there")
def test_without_torch_it_says_what_to_install(fbench, tmp_path):
    result = fbench("weights", "train", str(tmp_path), "-o", str(tmp_path / "a.onnx"))
    assert result.code == 2
    assert "pip install 'fbench[torch]'" in result.err
    assert result.err.count("\n") == 1


@with_torch
@pytest.mark.parametrize(
    ("folder", "out", "options", "said"),
    [
        ("none", "a.onnx", (), "no such file or folder; to make logs: fbench log simulate training -o"),
        ("none.mcap", "a.onnx", (), "none.mcap: no such file or folder\n"),
        (".", "a.onnx", (), "no logs in it"),
        (".", "a.pt", (), "expected a name that ends in .onnx"),
        (".", "/dev/null/a.onnx", (), "can't be written (Not a directory"),
        (".", "a.onnx", ("--device", "cuda"), "no CUDA device"),
        (".", "a.onnx", ("--seed", "9223372036854775808"), "--seed"),
    ],
)
def test_what_cant_be_done_is_said(fbench, tmp_path, folder, out, options, said):
    if "cuda" in options and importlib.import_module("torch").cuda.is_available():
        pytest.skip("there is a CUDA device")
    result = fbench("weights", "train", str(tmp_path / folder), "-o", str(tmp_path / out), *options)
    assert result.code == 2
    assert said in result.err
    assert list(tmp_path.iterdir()) == []


@with_torch
def test_a_folder_in_the_place_of_the_file_is_refused_before_training(fbench, tmp_path):
    (tmp_path / "a.onnx").mkdir()
    result = fbench("weights", "train", str(tmp_path), "-o", str(tmp_path / "a.onnx"))
    assert result.code == 2
    assert "a.onnx: is a folder" in result.err


@with_torch
@pytest.mark.parametrize("there", ["a.onnx", "a.json"])
def test_nothing_is_replaced_unasked(fbench, tmp_path, there):
    write_city_log(tmp_path / "a.mcap", 0.2)
    (tmp_path / there).write_text("mine")
    train = ("weights", "train", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "a.onnx"))
    result = fbench(*train)
    assert result.code == 2
    assert f"{there}: exists; replace it with --overwrite, or name another file with -o" in result.err
    assert "nothing to learn from" in fbench(*train, "--overwrite").err
    assert (tmp_path / there).read_text() == "mine"


@with_torch
@pytest.mark.parametrize(
    ("weights", "code", "said"),
    [
        ("none.onnx", 2, "none.onnx: weights can't be read"), ("text.onnx", 3, "text.onnx: not an ONNX file"),
        ("learned3d", 2, "unknown weights 'learned3d'"),
    ],
)  # fmt: skip
def test_weights_to_start_from_that_dont_fit_are_refused_before_logs_are_read(
    fbench, tmp_path, monkeypatch, weights, code, said
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.onnx").write_text("no network")
    (tmp_path / "a.mcap").write_text("no log")
    result = fbench("weights", "train", "a.mcap", "-o", "a.onnx", "--weights", weights)
    assert (result.code, result.err.count("\n")) == (code, 1)
    assert said in result.err


@with_torch
@pytest.mark.slow
def test_it_says_where_it_goes_on(fbench, tmp_path):
    log, out = tmp_path / "a.mcap", tmp_path / "a.onnx"
    assert fbench("log", "simulate", "urban", "--seconds", "0.2", "--sensors", "camera", "-o", str(log)).code == 0
    from fbench.pipelines.models.recipes import Recipe, TrainRequest  # torch

    Recipe(TrainRequest("camera", [log], steps=1, threads=1)).loop.run(
        tmp_path / "a.checkpoint", lambda step, loss: None
    )
    train = ("weights", "train", str(log), "-o", str(out), "--steps", "1", "--threads")
    refused = fbench(*train, "2")
    assert refused.code == 2
    assert "a.checkpoint: a checkpoint of a training with other threads; delete it, or name another file" in refused.err
    result = fbench(*train, "1")
    assert result.code == 0, result.err
    assert "goes on from step 1" in result.out
    assert not (tmp_path / "a.checkpoint").exists()


@with_torch
def test_of_several_places_each_must_hold_logs(fbench, tmp_path):
    write_city_log(tmp_path / "a.mcap", 0.2)
    result = fbench("weights", "train", str(tmp_path), str(tmp_path / "b"), "-o", str(tmp_path / "a.onnx"))
    assert result.code == 2
    assert f"{tmp_path / 'b'}: no such file or folder" in result.err


@with_torch
def test_what_is_no_file_isnt_waited_for(fbench, tmp_path):
    os.mkfifo(tmp_path / "a.mcap")
    result = fbench("weights", "train", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "a.onnx"))
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "a.mcap: not a regular file" in result.err


@with_torch
def test_logs_without_images_teach_nothing(fbench, tmp_path):
    write_city_log(tmp_path / "a.mcap", 0.2)
    result = fbench("weights", "train", str(tmp_path), "-o", str(tmp_path / "a.onnx"))
    assert result.code == 3
    assert "nothing to learn from" in result.err


@with_torch
@pytest.mark.slow
def test_a_trained_file_is_a_detector(fbench, tmp_path):
    log = tmp_path / "logs" / "a.mcap"
    log.parent.mkdir()
    assert fbench("log", "simulate", "urban", "--seconds", "0.2", "--sensors", "camera", "-o", str(log)).code == 0
    out = tmp_path / "a.onnx"
    (tmp_path / "other").symlink_to(log.parent)
    logs = (str(log), str(log.parent), str(tmp_path / "other" / "a.mcap"))
    result = fbench("weights", "train", *logs, "-o", str(out), "--steps", "2", "--threads", "1")
    assert result.code == 0, result.err
    card = json.loads((tmp_path / "a.json").read_text())
    assert (card["threads"], len(card["samples_sha256"]), card["weights_sha256"]) == (1, 64, None)
    assert (card["logs"], card["recorded_samples"]) == (["a.mcap"], 0), "one log, however often it is named"
    assert f"weights: {out}" in result.out.replace("\n", "")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "a.onnx", "logs", "other"]
    replayed = fbench("replay", str(log), "-p", "camera2d", "--set", f"camera.weights={out}", "-o", str(tmp_path / "r"))
    assert replayed.code == 0, replayed.err
    again = fbench("weights", "train", str(log), "-o", str(out), "--weights", str(out), "--steps", "1", "--overwrite")
    assert again.code == 0, again.err
    assert json.loads((tmp_path / "a.json").read_text())["weights_sha256"] == card["sha256"], "that of before"


@with_torch
@pytest.mark.slow
def test_networks_for_points_are_trained_from_logs(fbench, tmp_path):
    log = tmp_path / "logs" / "a.mcap"
    log.parent.mkdir()
    made = ("log", "simulate", "urban", "--seconds", "0.2", "--sensors", "camera,lidar,radar", "-o", str(log))
    assert fbench(*made).code == 0
    rates = {"rgbd": 1.0e-3, "learned3d": 0.5e-3}  # a quarter of the recipes'
    for model, used in (
        ("rgbd", ("-p", "early2d", "--set", "detector=rgbd", "--set")), ("learned3d", ("-p", "learned3d", "--set")),
    ):  # fmt: skip
        out = tmp_path / f"{model}.onnx"
        train = ("weights", "train", str(log.parent), "--model", model, "-o", str(out), "--steps", "2")
        result = fbench(*train, "--threads", "1", "--weights", "auto")
        assert result.code == 0, result.err
        card = json.loads(out.with_suffix(".json").read_text())
        assert (len(card["weights_sha256"]), card["settings"]["learning_rate"]) == (64, rates[model])
        name = "rgbd.weights" if model == "rgbd" else "network.weights"
        replayed = fbench("replay", str(log), *used, f"{name}={out}", "-o", str(tmp_path / model))
        assert replayed.code == 0, replayed.err
