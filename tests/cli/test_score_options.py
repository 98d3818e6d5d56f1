"""`fbench score` of several runs, of one frame, with intervals and regions; and options that don't go together."""

import json
import shutil

import pytest
from tests.city_log import write_city_log

from fbench.api.replays import replay
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """Two runs of one pipeline on different logs."""
    folder = tmp_path_factory.mktemp("runs")
    for name, world in (("one", "urban"), ("two", "highway")):
        log = folder / f"{name}.mcap"
        write_city_log(log, 1.0, world=world)
        replay(ReplayRequest(LogRequest(log), "lidar3d", out=folder / name, no_media=True))
    return folder


@pytest.fixture
def runs(fbench, tmp_path, replayed):
    """Copies that a test may score anew, in its working folder."""
    for name in ("one", "two"):
        shutil.copytree(replayed / name, tmp_path / name)
    return "one", "two"


def rows_of(fbench, *args):
    """Of several ways of matching the first, the pipeline's own."""
    rows = fbench("score", *args, "--json").json()["scores"]
    return {(r["metric"], r["class"], r["slice"]): r for r in reversed(rows)}


@pytest.mark.slow
def test_runs_are_added(fbench, runs, tmp_path):
    single = [rows_of(fbench, run) for run in runs]
    both = rows_of(fbench, *runs)
    f1 = ("f1", "vehicle", "all")
    for name in ("tp", "fp", "fn", "frames"):
        assert both[f1]["counts"][name] == sum(rows[f1]["counts"][name] for rows in single)
    assert both["f1", "vehicle", "log one"]["value"] == single[0][f1]["value"]
    result = fbench("score", *runs, "-o", "both.json")
    assert (result.code, result.out.splitlines()[0]) == (0, "2 runs together")
    assert json.loads((tmp_path / "both.json").read_text())[0]["metric"] == "f1"


@pytest.mark.slow
def test_order_of_runs_is_no_matter(fbench, runs):
    first, second = (fbench("score", *order, "--intervals", "50", "--json").json() for order in (runs, runs[::-1]))
    key = lambda r: (r["metric"], r["class"], r["slice"], r["matching"])  # noqa: E731
    assert sorted(first["scores"], key=key) == sorted(second["scores"], key=key)


@pytest.mark.slow
def test_intervals_depend_on_the_seed_alone(fbench, tmp_path):
    write_city_log(tmp_path / "log.mcap", 5.5)
    assert fbench("replay", "log.mcap", "-p", "lidar3d", "-o", "run", "--no-media").code == 0
    one, again, other = (
        rows_of(fbench, "run", "--intervals", "60", "--seed", seed)["recall", "vehicle", "all"] for seed in "112"
    )
    assert one == again
    assert one["low"] <= one["value"] <= one["high"]
    assert one["interval"].startswith("95 % of 60 bootstrap resamples of ")
    assert other["value"] == one["value"]
    assert f"[{one['low']:.3f}, {one['high']:.3f}]" in fbench("score", "run", "--intervals", "60", "--seed", "1").out


@pytest.mark.slow
def test_too_little_to_resample_is_said(fbench, runs):
    recall = ("recall", "vehicle", "all")
    single, both = rows_of(fbench, runs[0], "--intervals", "60"), rows_of(fbench, *runs, "--intervals", "60")
    assert single[recall]["interval"] == "1 s with truth in 1 segment, at least 5 s or segments are needed"
    assert both[recall]["interval"] == "2 logs, at least 5 are needed"
    assert "low" not in both[recall]


@pytest.mark.slow
def test_a_frame_is_explained(fbench, runs):
    told = fbench("score", runs[0], "--explain", "3")
    assert (told.code, told.out.splitlines()[0][:11]) == (0, "frame 3 at ")
    content = fbench("score", runs[0], "--explain", "3", "--json").json()
    assert content["frame"] == 3
    missing = fbench("score", runs[0], "--explain", "99")
    assert (missing.code, missing.err.count("\n")) == (2, 1)


@pytest.mark.slow
def test_regions_leave_boxes_out(fbench, runs):
    everywhere, road = (rows_of(fbench, runs[0], *args) for args in ((), ("--region", "road")))
    f1 = ("f1", "vehicle", "all")
    assert road[f1]["matching"].endswith("in region road")
    assert road[f1]["counts"]["fp"] <= everywhere[f1]["counts"]["fp"]
    wrong = fbench("score", runs[0], "--region", "rode")
    assert (wrong.code, wrong.err) == (2, "fbench: log 'one' has no region 'rode'; did you mean 'road'?\n")


def test_coverage_is_a_gate(fbench, runs):
    assert fbench("score", runs[0], "--min-coverage", "1").code == 0


@pytest.mark.slow
def test_a_profile_takes_several_runs(fbench, runs):
    rows = rows_of(fbench, *runs, "--profile", "default", "--match", "bev:2")
    single = [rows_of(fbench, run, "--profile", "default", "--match", "bev:2") for run in runs]
    tp = [r["f1", "vehicle", "all"]["counts"]["tp"] for r in (rows, *single)]
    assert tp[0] == tp[1] + tp[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("args", "why"),
    [
        (("one", "--seed", "1"), "--seed is for the resamples of --intervals N, which is missing"),
        (("one", "two", "--explain", "1"), "--explain is for one RUN, not 2"),
        (("one", "two", "--truth", "x.csv"), "--truth is for one RUN, not 2"),
        (("one", "two", "--min-coverage", "0.5"), "--min-coverage is for one RUN, not 2"),
        (("one", "--class", "car"), "--class goes with --profile"),
        (("one", "-o", "x.json"), "--out goes with --profile or several RUNs; a RUN has its own scores.json"),
        (("one", "--explain", "1", "--intervals", "9"), "--intervals doesn't go with --explain"),
        (("one", "--explain", "1", "--profile", "coco"), "--explain doesn't go with --profile"),
        (
            ("one", "--explain", "1", "--class", "car", "--class", "van"),
            "--explain is about one class, not 2: car, van",
        ),
        (("one", "--interpolate-truth", "9"), "--interpolate-truth is about --truth PATH, which is missing"),
        (("--truth", "a", "--detections", "b", "--region", "road"), "--region is for run folders"),
        (("nowhere", "one"), "nowhere: no such run folder"),
    ],
)
def test_options_that_dont_fit_are_refused(fbench, runs, args, why):
    result = fbench("score", *args)
    assert (result.code, result.err.count("\n")) == (2, 1)
    assert why in result.err
