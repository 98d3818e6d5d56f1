"""`fbench verify` finds what breaks determinism and names the stage; tests of reliability part 3.3 by number."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.conftest import car_log, circumstances, fbench, in_this_process, log, messages, write_log
from tests.cli.test_recorded import drive, write
from tests.replay.logs.test_two_types_of_tf import TYPES, cloud, transform, write_bag

from fbench.replay.check.difference import _facts
from fbench.replay.check.verify import variants, verify_in
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

__all__ = ["car_log", "circumstances", "fbench", "in_this_process", "log"]

PIPELINE = """
import random, time
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Mine:
    def start(self, rig, log_info): self.seeded = random.Random(7)
    def reset(self, reason): pass
    def step(self, frame):
        x = float(frame.messages["lidar"].xyz[:, 0].mean())
        found = self.box(x + NOISE)
        return Output(found, self.box(x + LATER), {})
    def box(self, x):
        SLEEP
        return Boxes3D(np.array([[x, 0, 0.75]]), np.array([[4.0, 1.8, 1.5]]), np.zeros(1), score=np.ones(1),
                       track_id=np.array([1]))
"""
"""Detections and tracks of one box, with something that mustn't be there."""

VARIANTS = [
    "repeat", "hash seed 1", "2 threads", "random hash seed", "rate 0.25", "no read-ahead", "read-ahead of all",
    "other time zone, locale and folder", "MCAP unchunked", "MCAP lz4", "MCAP in small chunks", "Parquet",
]  # fmt: skip


@pytest.fixture
def mine(tmp_path):
    def make(noise="0", later="0", sleep="pass", name="mine"):
        path = tmp_path / f"{name}.py"
        path.write_text(PIPELINE.replace("NOISE", noise).replace("LATER", later).replace("SLEEP", sleep))
        return f"{path.name}:Mine"

    return make


def by_name(result):
    return {row["variant"]: row for row in result.json()["variants"]}


# --- 1-4, 8, 9: repeats, rates, read-ahead, hash seeds, locale, folder; and containers ---


@pytest.mark.slow
def test_a_builtin_pipeline_is_identical_under_all_circumstances(fbench, log, in_this_process):
    """Rates, reading ahead and containers are tried in this process, whose bits are those of the others, too."""
    in_this_process("rate", "no_read-ahead", "read-ahead", "MCAP", "Parquet")
    result = fbench("verify", log.name, "-p", "late3d")
    assert result.code == 0, result.out
    assert [line for line in result.out.splitlines() if line.endswith(": identical")] == [
        f"{name}: identical" for name in VARIANTS
    ]
    assert re.findall(r"^(\w+) +[0-9a-f]{32}", result.out, re.MULTILINE) == [
        "messages", "frames", "detections", "tracks", "faults", "scores",
    ]  # fmt: skip
    assert list(Path().glob("*fbench*")) == []


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "frames"), [("0.1", ":3"), ("1", "0:"), ("10", "0:"), ("100", "0:")])
def test_rates(fbench, log, rate, frames):
    """Test 2."""
    digests = []
    for name, speed in (("a", "max"), ("b", rate)):
        options = ("-p", "lidar3d", "-o", name, "--rate", speed, "--frames", frames)
        assert fbench("replay", log, *options, "--json").code == 0
        digests.append(Path(name, "frames.parquet").read_bytes())
    assert digests[0] == digests[1]


@pytest.mark.parametrize("read_ahead", ["0", "1", "64", "all"])
def test_read_ahead(fbench, log, read_ahead):
    """Test 4."""
    assert fbench("replay", log, "-p", "radar3d", "-o", "a").code == 0
    assert fbench("replay", log, "-p", "radar3d", "-o", "b", "--read-ahead", read_ahead).code == 0
    assert Path("a/frames.parquet").read_bytes() == Path("b/frames.parquet").read_bytes()
    assert Path("a/faults.json").read_bytes() == Path("b/faults.json").read_bytes()


# --- 12: sleeps ---


BODY = 'version = 1\n[body]\nframe = "base_link"\n'
FOREIGN = """
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Count:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        num = sum(len(message.xyz) for message in frame.messages.values())
        boxes = Boxes3D(np.full((1, 3), num), np.ones((1, 3)), np.zeros(1))
        return Output(boxes, boxes, {})
"""


@pytest.mark.slow
@pytest.mark.parametrize(("name", "config"), [("drive.bag", BODY), ("drive.mcap", BODY), ("drive.parquet", "")])
def test_logs_of_other_programs_are_identical_in_other_containers(
    fbench, tmp_path, circumstances, in_this_process, name, config
):
    circumstances("MCAP unchunked", "Parquet")
    in_this_process()
    if name == "drive.bag":  # without stamps, which is a fault
        clouds = [("/lidar", cloud("lidar", stamp=(0, 0))) for _ in range(5)]
        write_bag(tmp_path / name, [("/tf", transform(TYPES[1], "lidar", 1.0)), *clouds])
    else:
        write(tmp_path / "drive.mcap", *drive())
    if name == "drive.parquet":
        assert fbench("log", "convert", "drive.mcap", "-o", name).code == 0
    (tmp_path / "count.py").write_text(FOREIGN)
    if config:
        (tmp_path / "fbench.toml").write_text(config)
    result = fbench("verify", name, "-p", "count.py:Count")
    assert result.code == 0, result.out + result.err


@pytest.mark.slow
def test_random_sleeps_do_not_matter(fbench, log, mine, circumstances, in_this_process):
    circumstances("2 threads")
    in_this_process()
    sleepy = mine(sleep="time.sleep(self.seeded.uniform(0, 0.003))", name="sleepy")
    result = fbench("verify", log, "-p", sleepy, "--quick", "--json")
    assert result.code == 0, result.out
    assert result.json()["identical"]
    assert fbench("replay", log, "-p", mine(), "-o", "a").code == 0
    assert fbench("replay", log, "-p", sleepy, "-o", "b").code == 0
    assert Path("a/detections.parquet").read_bytes() == Path("b/detections.parquet").read_bytes()


@pytest.mark.slow
def test_a_fixed_latency_gives_the_same_with_other_threads(fbench, log, mine, circumstances):
    circumstances("2 threads")
    words = ("verify", log, "-p", mine(), "--quick", "--json", "--latency", "fixed:150ms", "--overload", "skip")
    result = fbench(*words, "--keep", "kept")
    assert result.code == 0, result.out
    names = ("reference", "2_threads")
    runs = [Run(Path("kept", name)) for name in names]
    assert [f.is_dropped for f in runs[0].frames].count(True) == runs[0].manifest.latency.num_dropped > 0
    for name in ("frames.parquet", "scores.json", "manifest.json", "lockstep/scores.json"):
        assert len({Path("kept", run, name).read_bytes() for run in names}) == 1


def test_other_times_of_dropped_frames_are_a_difference():
    record = FrameRecord(3, 5, 0, None, {}, "", "", ready_ns=5, start_ns=5, done_ns=9)
    assert _facts(record) != _facts(replace(record, done_ns=10))


# --- 17: what breaks a promise is found, with the stage ---


@pytest.mark.slow
@pytest.mark.parametrize(
    ("noise", "later", "stage"),
    [
        ("time.time() % 1", "0", "detections"),
        ("np.random.random()", "0", "detections"),
        ("0", "time.perf_counter() % 1", "tracks"),
    ],
)
def test_time_and_global_generators_are_found_by_a_repeat(
    fbench, log, mine, circumstances, in_this_process, noise, later, stage
):
    circumstances("repeat")
    in_this_process()
    result = fbench("verify", log, "-p", mine(noise, later), "--quick")
    assert result.code == 1
    assert re.search(rf"^frame 0, {stage}: center_m\[0, 0\] \S+ != \S+ under repeat$", result.out, re.MULTILINE)
    assert "DIVERGED: 1 of 1" in result.out


@pytest.mark.slow
def test_order_of_a_set_is_found_by_another_hash_seed(fbench, log, mine, circumstances):
    circumstances("repeat", "hash seed")
    order = "next(i for i, s in enumerate({f'sensor {n}' for n in range(40)}) if s == 'sensor 7')"
    result = fbench("verify", log, "-p", mine(order), "--quick", "--json")
    assert result.code == 1
    rows = by_name(result)
    assert [name for name, row in rows.items() if not row["identical"]] == ["hash seed 1"]
    assert rows["hash seed 1"]["difference"]["stage"] == "detections"
    assert rows["hash seed 1"]["difference"]["frame"] == 0


@pytest.mark.slow
def test_number_of_threads_is_found(fbench, log, mine, circumstances):
    circumstances("hash seed", "2 threads")
    result = fbench(
        "verify", log, "-p", mine("float(__import__('os').environ['OMP_NUM_THREADS'])"), "--quick", "--json"
    )
    assert [name for name, row in by_name(result).items() if not row["identical"]] == ["2 threads"]


@pytest.mark.slow
def test_variant_that_crashes_has_diverged(fbench, log, mine, circumstances):
    circumstances("hash seed")
    crash = "0 if __import__('os').environ['PYTHONHASHSEED'] == '0' else __import__('os')._exit(9)"
    result = fbench("verify", log, "-p", mine(crash), "--quick", "--json")
    assert result.code == 1
    assert by_name(result)["hash seed 1"]["difference"]["what"] == "failed: exit code 9: no message"


@pytest.mark.slow
def test_variant_that_fails_tells_its_error(fbench, log, mine, circumstances):
    circumstances("hash seed")
    fail = "0 if __import__('os').environ['PYTHONHASHSEED'] == '0' else 1 / 0"
    result = fbench("verify", log, "-p", mine(fail), "--quick")
    assert result.code == 1
    assert "replay: failed: pipeline 'verified' failed on all 6 frames: ZeroDivisionError" in result.out


# --- options and bad input ---


@pytest.mark.slow
def test_runs_are_kept_where_that_is_wanted(fbench, log, mine, in_this_process):
    in_this_process()
    assert fbench("verify", log, "-p", mine(), "--quick", "--repeat", "3", "--keep", "kept").code == 0
    assert sorted(p.name for p in Path("kept").iterdir() if (p / "manifest.json").is_file()) == [
        "2_threads", "hash_seed_1", "reference", "repeat_1", "repeat_2",
    ]  # fmt: skip
    again = fbench("verify", log, "-p", mine(), "--quick", "--keep", "kept")
    assert (again.code, again.err) == (2, "fbench: kept: isn't empty; choose another with --keep\n")


@pytest.mark.slow
def test_log_without_truth_and_excerpts(fbench, tmp_path, mine, circumstances, in_this_process):
    circumstances("repeat")
    in_this_process()
    path = write_log(tmp_path / "blind.mcap", messages())
    result = fbench("verify", path, "-p", mine(), "--quick", "--frames", "2:4", "--json")
    assert result.code == 0
    assert "scores" not in result.json()["stages"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("nowhere.mcap", "-p", "lidar3d"), 3, "nowhere.mcap: can't be read"),
        (("car.mcap", "-p", "lidar4d"), 2, "unknown pipeline 'lidar4d'; did you mean 'lidar3d'?"),
        (("car.mcap", "-p", "lidar3d", "--set", "lidar.x=1"), 2, "lidar.x"),
        (("car.mcap", "-p", "lidar3d", "--frames", "90:"), 3, "has no frames in the range 'frames 90:'"),
        (("car.mcap", "-p", "lidar3d", "--offset", "lidr=3"), 2, "did you mean 'lidar'?"),
        (("car.mcap", "-p", "lidar3d", "--keep", "car.mcap"), 2, "can't be written"),
        (("car.mcap", "-p", "lidar3d", "--repeat", "0"), 2, "repeat"),
        (("car.mcap", "-p", "lidar3d", "--latency", "measured"), 2, "differs from replay to replay"),
    ],
)
def test_bad_input(fbench, log, in_this_process, arguments, code, message):
    assert log.name == "car.mcap"
    if message not in ("nowhere.mcap: can't be read", "unknown pipeline 'lidar4d'; did you mean 'lidar3d'?"):
        in_this_process()  # One of each code comes out of a process of its own
    result = fbench("verify", *arguments)
    assert result.code == code, result.err
    assert message in result.err
    assert result.err.count("\n") == 1


@pytest.mark.slow
def test_at_most_two_processes_at_a_time(fbench, log, mine, monkeypatch):
    alive, most = [], []

    class Counted(subprocess.Popen[str]):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            alive.append(self)
            most.append(sum(p.poll() is None for p in alive))

    monkeypatch.setattr(subprocess, "Popen", Counted)
    assert fbench("verify", log, "-p", mine(), "--quick", "--repeat", "2").code == 0
    assert len(alive) == 4
    assert max(most) <= 2


@pytest.mark.slow
def test_interrupt_ends_the_replays_that_run_and_begins_no_others(log, mine, tmp_path):
    def interrupt(done, of):
        if done == 2:
            raise KeyboardInterrupt

    request = ReplayRequest(LogRequest(log), str(tmp_path / mine(sleep="time.sleep(0.2)")))
    with pytest.raises(KeyboardInterrupt):
        verify_in(request, 10, True, tmp_path / "runs", "fbench.api.verify_child", interrupt)
    begun = [p for p in (tmp_path / "runs").iterdir() if p.name != "elsewhere"]
    assert len(begun) <= 6  # of 12: the reference, those of which one was done, and those that followed


def test_paced_variant_takes_seconds_whatever_the_log():
    for span_s in (0.5, 3600.0):
        paced = next(v for v in variants(2, span_s, quick=False) if v.name.startswith("rate"))
        assert span_s / float(paced.rate) == pytest.approx(2.0, rel=1e-3)
    assert len({v.name for v in variants(3, 0.0, quick=False)}) == 13
