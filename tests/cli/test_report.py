"""`fbench report` in all its forms, and `fbench view`."""

import json
import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from tests.cli.conftest import messages, rig, truths, write_log
from tests.program import fbench as program

from fbench.replay.data.rig import LogInfo
from fbench.replay.logs.containers.mcap.write import McapWriter


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A small log, and a run of it."""
    folder = tmp_path_factory.mktemp("report")
    log = write_log(folder / "car.mcap", [*messages(), *truths()])
    assert program("replay", log, "-p", "lidar3d", "-o", folder / "run") == 0
    return folder


def decoded(path: Path) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, proto in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append(proto)
    return found


def test_all_forms(fbench, place):
    result = fbench(
        "report", place / "run", "-o", "report.html", "--overlay", "overlay.mcap", "--log", place / "car.mcap",
        "--tables", "tables", "--figures", "figures",
    )  # fmt: skip
    assert result.code == 0
    assert result.out.splitlines()[:3] == [
        "report: report.html", "overlay: overlay.mcap", "overlay: overlay.layout.json",
    ]  # fmt: skip
    assert re.fullmatch(
        r"tables: tables \(\d+ files\)\nfigures: figures \(\d+ files\)", result.out.split("\n", 3)[3].strip()
    )
    scores = json.loads((place / "run" / "scores.json").read_text())
    counts = next(score["counts"] for score in scores if (score["metric"], score["class"]) == ("f1", "vehicle"))
    overlay = decoded(Path("overlay.mcap"))
    outcomes = [
        next(pair.value for pair in entity.metadata if pair.key == "outcome")
        for scene in overlay["/fbench/detections"] for entity in scene.entities
    ]  # fmt: skip
    assert (outcomes.count("hit"), outcomes.count("false alarm")) == (counts["tp"], counts["fp"])
    assert counts["tp"] > 0
    assert set(decoded(place / "car.mcap")) < set(overlay)
    typed = pd.read_parquet("tables/scores.parquet")
    assert typed["value"].dropna().tolist() == [s["value"] for s in scores if s["value"] is not None]


def test_forms_count_as_the_scores_do(fbench, place):
    """A run that was scored by other rules is colored and drawn by them."""
    shutil.copytree(place / "run", "run")
    assert fbench("score", "run", "--range-m", "1").code == 0
    rows = {(r["metric"], r["class"], r["slice"]): r for r in json.loads(Path("run/scores.json").read_text())}
    counts = rows["f1", "vehicle", "all"]["counts"]
    assert (counts["tp"], counts["fp"]) == (0, 0)
    assert fbench("report", "run", "--overlay", "o.mcap", "--figures", "f").code == 0
    outcomes = [
        pair.value for scene in decoded(Path("o.mcap"))["/fbench/detections"] for entity in scene.entities
        for pair in entity.metadata if pair.key == "outcome"
    ]  # fmt: skip
    assert outcomes == ["ignored"] * len(outcomes) != []


def test_another_log_and_what_goes_together(fbench, place):
    with McapWriter(Path("other.mcap"), LogInfo("other", "test-2", {}), rig()) as writer:
        for message in messages(1):
            writer.write(message)
    run = place / "run"
    assert fbench("replay", place / "car.mcap", "-p", "lidar3d", "--redact", "--frames", ":3", "-o", "r").code == 0
    assert fbench("report", "r", "--overlay", "r.mcap", "--log", place / "car.mcap").code == 0
    for words, why in [
        (("r", "--overlay", "o.mcap", "--log", "other.mcap"), "other.mcap: isn't the log of"),
        ((run, run, "--overlay", "o.mcap"), "--overlay shows the results of one RUN, not of 2"),
        ((run, "--log", place / "car.mcap"), "--log goes with --overlay FILE.mcap"),
        ((run, "--overlay", place / "car.mcap", "--log", place / "car.mcap"), "is the log itself"),
        ((run, "--overlay", "o.mcap", "--log", "none.mcap"), "none.mcap"),
        ((run, "--overlay", "o.mcap", "--log", "other.mcap"), "other.mcap: isn't the log of"),
        (("nowhere", "--tables", "t"), "nowhere: no such run folder"),
    ]:
        result = fbench("report", *words)
        assert result.code in (2, 3)
        assert why in result.err
        assert result.err.count("\n") == 1
    assert not Path("o.mcap").exists()


def test_a_suite_has_tables_and_figures(fbench):
    Path("suite").mkdir()
    row = {
        "name": "fog 3",
        "space": "",
        "column": "late3d",
        "value": 0.5,
        "reason": None,
        "published": None,
        "counts": {},
    }
    Path("suite/results.json").write_text(json.dumps({"tables": {"severity_curves": [row]}}))
    result = fbench("report", "suite", "--tables", "t", "--figures", "f")
    assert (result.code, result.out) == (0, "tables: t (3 files)\nfigures: f (2 files)\n")
    assert fbench("report", "suite").err == (
        "fbench: suite: is a suite, which has its report; of it there are --tables, --figures and --sheet\n"
    )


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """The small log through two pipelines, clear and with condition, without media; most truth is in frame 2."""
    folder = tmp_path_factory.mktemp("sheets") / "suite"
    more = list(truths())
    more[2] = replace(more[2], boxes3d=replace(more[2].boxes3d[[0, 0]], track_id=np.array([3, 4])))
    (folder / "logs").mkdir(parents=True)
    log = write_log(folder / "logs" / "car.mcap", [*messages(), *more])
    for pipeline in ("late3d", "lidar2d"):
        for name, words in (("clear", ()), ("loss", ("--condition", "lidar.density:5", "--seed", "3"))):
            out = folder / "runs" / "car" / pipeline / name
            assert program("replay", log, "-p", pipeline, "--no-media", *words, "-o", out) == 0
    (folder / "results.json").write_text("{}")
    return folder


def test_a_sheet_of_a_suite_is_drawn_from_its_logs(fbench, suite):
    result = fbench("report", suite, "--sheet", "sheet.png")
    assert (result.code, result.out) == (0, "sheet: sheet.png (2 pipelines x 2 conditions, car, frame 2)\n")
    assert cv2.imread("sheet.png").shape[:2] == (660, 820)
    assert fbench("report", suite, "--sheet", "again.png", "--frame", "2").code == 0
    assert Path("again.png").read_bytes() == Path("sheet.png").read_bytes()
    assert fbench("report", suite, "--sheet", "other.svg", "--frame", "5").out.endswith("frame 5)\n")


def test_a_sheet_without_pictures_says_so(fbench, suite, place):
    runs = [suite / "runs" / "car" / "late3d" / name for name in ("clear", "loss")]
    result = fbench("report", *runs, "-o", "r.html", "--sheet", "sheet.png")
    assert result.code == 0
    assert result.out.splitlines()[1:] == [
        "sheet: sheet.png (1 pipeline x 2 conditions, car, frame 2)",
        "not shown: no pictures of clear, lidar.density:5: the runs kept none of frame 2; name the log with --log",
    ]
    log = suite / "logs" / "car.mcap"
    assert len(fbench("report", *runs, "-o", "r.html", "--sheet", "full.png", "--log", log).out.splitlines()) == 2
    assert (
        len(fbench("report", *runs, "-o", "r.html", "--sheet", "full2.png", "--log", log.parent).out.splitlines()) == 2
    )
    assert fbench("log", "convert", log, "-o", "converted/car.parquet").code == 0
    Path("converted/car.parquet").rename("converted/car")  # a log by what is in it
    words = ("--sheet", "full3.png", "--log", "converted")
    assert len(fbench("report", *runs, "-o", "r.html", *words).out.splitlines()) == 2
    assert (
        Path("full3.png").read_bytes()
        == Path("full.png").read_bytes()
        == Path("full2.png").read_bytes()
        != Path("sheet.png").read_bytes()
    )
    kept = fbench("report", place / "run", "-o", "r.html", "--sheet", "kept.svg")  # media are in the run
    assert kept.out.splitlines()[1:] == ["sheet: kept.svg (1 pipeline x 1 condition, car, frame 0)"]


def test_sheets_that_cannot_be_drawn(fbench, suite, place):
    with McapWriter(Path("other.mcap"), LogInfo("other", "test-2", {}), rig()) as writer:
        writer.write(next(messages(1)))
    for words, why in [
        (("--sheet", "s.pdf"), "--sheet s.pdf: expected a name that ends in .png or .svg"),
        (("--sheet", "s.png", "--frame", "6"), "--frame 6: expected one that the runs have: 0 to 5"),
        (("--frame", "1"), "--frame goes with --sheet FILE"),
        (("--sheet", "s.png", "--log", "none.mcap"), "--log none.mcap: no such log, nor folder of logs"),
        (("--sheet", "s.png", "--log", "."), ".: has no log of"),
        (("--sheet", "other.mcap/s.png"), "can't be written"),
    ]:
        result = fbench("report", suite, *words)
        assert (result.code, result.err.count("\n")) == (2, 1), result.err
        assert why in result.err
        runs = (suite / "runs/car/late3d/clear", "-o", "r.html", "--figures", "f")
        result = fbench("report", *runs, *words)
        if "can't be written" not in why:  # which is seen only then
            assert (result.code, result.err.count("\n"), result.out) == (2, 1, "")
            assert not Path("r.html").exists()
            assert not Path("f").exists()
    assert not list(Path().glob("s.*"))
    assert "not a run folder" in fbench("report", suite, place / "run", "--sheet", "s.png").err


def test_view_serves_until_ctrl_c(place):
    program = Path(sys.executable).parent / "fbench"
    child = subprocess.Popen(
        [program, "view", place / "run"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        url = re.search(r"http://127\.0\.0\.1:\d+/", child.stdout.readline())[0]
        with urllib.request.urlopen(url) as response:  # noqa: S310
            assert b"<!doctype html>" in response.read(1000)
        child.send_signal(signal.SIGINT)
        assert child.wait(60) == 128 + signal.SIGINT
        assert child.stderr.read() == ""
    finally:
        child.kill()
        child.communicate()


def test_view_errors(fbench):
    assert fbench("view", "nowhere").err == "fbench: nowhere: no such run folder\n"
    Path("folder").mkdir()
    Path("folder/report.html").write_text("x")
    assert "port 70000" in fbench("view", "folder", "--port", "70000").err


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--budget-mb", "0"], "expected a positive number of MB, got 0"),
        (["--budget-mb", "nan"], "expected a positive number of MB, got nan"),
        (["--budget-mb", "3", "--kind", "other"], "is for reports of kind html, not other"),
        (["--rerun", "run.mcap"], "a Rerun recording ends in .rrd"),
    ],
)
def test_refused_options(fbench, place, options, why):
    result = fbench("report", place / "run", "-o", "small.html", *options)
    assert result.code == 2
    assert why in result.err


def test_rerun_shows_one_run(fbench, place):
    runs = [place / "run", place / "run"]
    assert "--rerun shows one RUN" in fbench("report", *runs, "--rerun", "run.rrd").err
    assert "--rerun shows one RUN" in fbench("view", *runs, "--rerun").err


def test_budget_makes_a_small_report(fbench, place):
    assert fbench("report", place / "run", "-o", "small.html", "--budget-mb", "0.3").code == 0
    assert Path("small.html").stat().st_size < 300_000
