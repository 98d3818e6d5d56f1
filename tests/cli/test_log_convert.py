"""`fbench log convert`."""

import re

import pytest
from tests.replay.logs.other_forms import chunks


def test_what_is_printed(fbench, log):
    result = fbench("log", "convert", log, "-o", "out.mcap")
    assert result.code == 0
    assert re.search(r"^/lidar/points +6$", result.out, re.MULTILINE)
    assert "id: test-1" in result.out
    assert "log: out.mcap: 28 messages, " in result.out
    assert "fault" not in result.out


def test_json(fbench, log):
    content = fbench("log", "convert", log, "-o", "out.parquet", "--json").json()
    assert content["path"] == "out.parquet"
    assert content["log_id"] == "test-1"
    assert content["messages"] == dict.fromkeys(("/camera/image", "/lidar/points", "/radar/points", "/truth/boxes"), 6)
    assert content["num_rigs"] == 1
    assert content["left_out"] == {}
    assert content["num_bytes"] > 10_000
    assert not any(row["count"] for row in content["faults"])
    content = fbench("log", "convert", log, "-o", "parts", "--split-s", "0.25", "--json").json()
    assert content["parts"] == ["parts_0.mcap", "parts_1.mcap", "parts_2.mcap"]


@pytest.mark.parametrize("pipeline", ["lidar3d", "radar3d"])
def test_all_forms_replay_to_one_digest(fbench, log, pipeline):
    fbench("log", "convert", log, "-o", "a.parquet", "--rows-per-group", "2", "--compression", "snappy")
    fbench("log", "convert", "a.parquet", "-o", "b.mcap", "--chunk-size", "4096", "--compression", "none")
    fbench("log", "convert", "b.mcap", "-o", "c", "--split-mb", "0.01")
    runs = [
        fbench("replay", path, "-p", pipeline, "-o", f"runs/{i}", "--json").json()
        for i, path in enumerate([log, "a.parquet", "b.mcap", "c"])
    ]
    assert len({run["manifest"]["log"]["digest"] for run in runs}) == 1
    assert len({run["manifest"]["digest"] for run in runs}) == 1
    assert {run["manifest"]["log"]["log_id"] for run in runs} == {"test-1"}


def test_a_part(fbench, log):
    result = fbench(
        "log", "convert", log, "-o", "p.mcap", "--from", "0.1", "--to", "1300000000ns", "--topics", "lidar", "--topics",
        "rad*", "--topics", "!radar", "--json",
    )  # fmt: skip
    assert result.json()["messages"] == {"/lidar/points": 2, "/tf": 3, "/truth/boxes": 2}
    assert fbench("log", "info", "p.mcap").code == 0
    assert fbench("replay", "p.mcap", "-p", "lidar3d").code == 0


def test_lost_data_are_shown_and_exit_4(fbench, log, tmp_path):
    fbench("log", "convert", log, "-o", "small.mcap", "--chunk-size", "3000")
    data = bytearray((tmp_path / "small.mcap").read_bytes())
    at, length = chunks(bytes(data))[2]
    data[at + length // 2] ^= 1
    (tmp_path / "small.mcap").write_bytes(data)
    result = fbench("log", "convert", "small.mcap", "-o", "out.parquet")
    assert result.code == 4
    assert "fault: LOG004 damaged chunk skipped: 1" in result.out
    assert "log: out.parquet" in result.out
    assert fbench("log", "info", "out.parquet").code == 0


@pytest.mark.parametrize(
    ("args", "code", "message"),
    [
        (["-o", "out.txt"], 2, "out.txt: which form?"),
        (["-o", "car.mcap", "--overwrite"], 2, "car.mcap: is the log that is converted"),
        (["-o", "out.mcap", "--compression", "snappy"], 2, "choose one of zstd, lz4, none"),
        (["-o", "out.mcap", "--from", "9"], 2, "no message from 10000000000ns to the end"),
        (["-o", "out.mcap", "--topics", "lidr"], 2, "fits no topic or sensor; did you mean 'lidar'?"),
        (["-o", "out.mcap", "--split-s", "0"], 2, "--split-s 0.0: expected a positive number"),
        (["-o", "out.parquet", "--split-mb", "1"], 2, "is for MCAP, not for Parquet"),
        ([], 2, "--out"),
    ],
)
def test_bad_usage(fbench, log, args, code, message):
    result = fbench("log", "convert", "car.mcap", *args)
    assert result.code == code
    assert message in result.err
    assert len(result.err.strip().splitlines()) == 1


def test_what_is_no_log(fbench, tmp_path):
    (tmp_path / "x.mcap").write_text("hello")
    result = fbench("log", "convert", "x.mcap", "-o", "out.mcap")
    assert result.code == 3
    assert "x.mcap: not a log (looks like text)" in result.err
    assert not (tmp_path / "out.mcap").exists()


def test_what_fbench_does_not_understand_is_said(fbench, tmp_path):
    from tests.replay.logs.convert.test_cut import foreign

    foreign(tmp_path / "f.mcap")
    result = fbench("log", "convert", "f.mcap", "-o", "out.mcap", "--decode")
    assert result.code == 0
    assert "left out: 10 messages on /tf, which fbench doesn't understand" in result.out
