"""`fbench weights compare`, with detectors that see the same boxes in every image."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import messages, write_log
from tests.pipelines.conftest import constant_model  # noqa: F401 - fixture

from fbench.api.detectors import _name_detectors
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.data.messages import Truth

INPUTS = {"images": ("float32", (1, 3, 32, 32)), "orig_target_sizes": ("int64", (1, 2))}
NEAR, FAR, NOWHERE = (10, 20, 40, 50), (50, 25, 62, 37), (0, 0, 8, 8)


@pytest.fixture
def drive(tmp_path) -> Path:
    """Six images with a car 8 m and a car 25 m away, each in one place."""
    boxes = Boxes2D(
        np.full(2, "camera"), np.array([NEAR, FAR], float), label=np.full(2, "car"), track_id=np.arange(2),
        distance_m=np.array([8.0, 25.0]),
    )  # fmt: skip
    times = [1_000_000_000 + 100_000_000 * i for i in range(6)]
    truths = [Truth(stamp, stamp, boxes2d=boxes) for stamp in times]
    return write_log(tmp_path / "car.mcap", [*messages(), *truths])


@pytest.fixture
def sees(constant_model):  # noqa: F811
    """Makes a detector of these boxes and scores."""

    def make(name, *boxes):
        xyxy = np.array([[np.add(box, 0.5) for box, _ in boxes]], np.float32)
        content = {"labels": np.full((1, len(boxes)), 2, np.int64), "boxes": xyxy}
        scores = np.array([[score for _, score in boxes]], np.float32)
        return constant_model(content | {"scores": scores}, INPUTS, name=name)

    return make


def test_numbers_by_hand(fbench, drive, sees):
    both = sees("both.onnx", (NEAR, 0.9), (NOWHERE, 0.5), (FAR, 0.3))
    near = sees("near.onnx", (NEAR, 0.875), (NOWHERE, 0.01))
    result = fbench("weights", "compare", drive, both, near, "-o", "found", "--json")
    assert (result.code, result.err) == (0, "")
    found = json.loads(result.out)
    assert (found["log"], found["frames"], found["folder"]) == ("car", 6, "found")
    one, two = found["detectors"]
    # Of `both`, all three boxes give F1 4/5, two of them 2/4, the first alone 2/3.
    assert (one["name"], one["best_f1"], one["precision"], one["recall"]) == ("both", 0.8, pytest.approx(2 / 3), 1.0)
    assert one["threshold"] == pytest.approx(0.3)
    assert one["ap"] == pytest.approx((51 + 50 * 2 / 3) / 101)
    assert (two["name"], two["threshold"], two["best_f1"], two["precision"]) == ("near", 0.875, pytest.approx(2 / 3), 1)
    assert two["ap"] == pytest.approx(51 / 101)
    recalls = {row["name"]: [(r["low_m"], r["recall"], r["gt"]) for r in row["recall_by_range"]] for row in (one, two)}
    assert recalls["both"] == [(0, 1.0, 6), (10, None, 0), (20, 1.0, 6)]
    assert recalls["near"] == [(0, 1.0, 6), (10, None, 0), (20, 0.0, 6)]
    model = one["model"]
    assert (model["family"], model["input_wh"], model["num_bytes"]) == ("DETR", [32, 32], both.stat().st_size)
    assert model["num_parameters"] == 3 + 3 * 4 + 3
    assert set(one["stage_ms"]) == {"decode", "preprocess", "detect.camera", "total"}


def test_table_page_and_runs(fbench, drive, sees):
    models = sees("a.onnx", (NEAR, 0.9)), sees("b.onnx", (FAR, 0.8))
    result = fbench("weights", "compare", drive, *models, "-o", "found")
    assert result.code == 0
    assert "comparison: found\nplots: found/report.html\n" in result.out
    page = Path("found/report.html").read_text()
    assert page.count("<svg") == 3
    assert "<script" not in page
    assert json.loads(Path("found/weights.json").read_text())["detectors"][0]["name"] == "a"
    assert fbench("score", "found/a").code == 0
    again = fbench("weights", "compare", drive, *models, "-o", "found")
    assert (again.code, again.err) == (
        2,
        "fbench: found: exists already; choose another with --out, or --overwrite it\n",
    )
    assert fbench("weights", "compare", drive, models[0], "-o", "found", "--overwrite").code == 0
    assert not Path("found/b").exists()


def test_two_files_of_one_name(fbench, drive, sees):
    first = sees("net.onnx", (NEAR, 0.9))
    Path("other").mkdir()
    second = first.rename("other/net.onnx")
    first = sees("net.onnx", (FAR, 0.9))
    found = fbench("weights", "compare", drive, first, second, "-o", "found", "--json")
    assert [row["name"] for row in json.loads(found.out)["detectors"]] == ["net", "net-2"]


def test_names_are_taken_once() -> None:
    given = ["x/a.onnx", "y/a.onnx", "a-2.onnx", "weights.json.onnx", "z/a.onnx"]
    assert _name_detectors(given) == ["a", "a-2", "a-2-2", "weights.json-2", "a-3"]


def test_bad_input(fbench, drive, sees, tmp_path):
    good, broken = sees("good.onnx", (NEAR, 0.9)), tmp_path / "broken.onnx"
    broken.write_bytes(b"\x80\x04pickle")
    unlabeled = write_log(tmp_path / "plain.mcap", messages())
    Path("mine").mkdir()
    for words, code, why in [
        ((drive, "none.onnx"), 2, "none.onnx: weights can't be read (No such file or directory)"),
        ((drive, good, broken), 3, "broken.onnx: not an ONNX"),
        ((drive, good, good), 2, "given twice"),
        ((drive, "auto"), 2, "auto"),
        ((drive, "deimv3"), 2, "deimv3"),
        (("none.mcap", good), 3, "none.mcap: can't be read"),
        ((unlabeled, good), 3, "no truth"),
        ((drive, good, "--min-score", "1"), 2, "--min-score 1: expected at least 0 and below 1"),
        ((drive, good, "-o", "mine", "--overwrite"), 2, "isn't a comparison of detectors"),
        ((drive, good, "--set", "camera.nonsense=1"), 2, "nonsense"),
    ]:
        result = fbench("weights", "compare", *words)
        assert (result.code, result.err.count("\n")) == (code, 1), result.err
        assert why in result.err
        assert not Path("runs").exists() or not any(Path("runs").iterdir())
    assert list(Path("mine").iterdir()) == []
