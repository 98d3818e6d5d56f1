"""Simulated logs as files: the same bytes everywhere, in order, clean, and the same in either container."""

import hashlib
import json
import os
import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from tests.datasets.city.city_logs import read, simulated
from tests.program import fbench as run

FBENCH = [sys.executable, "-c", "from fbench.cli import main; main()"]
SMALL = (
    "--set", "lidar.points_per_s=60000", "--set", "radar.points_per_s=20000", "--set", "camera.size_wh=[96, 72]",
    "--sensors", "lidar", "--sensors", "radar", "--sensors", "camera",
)  # fmt: skip


@pytest.mark.slow
def test_messages_come_in_their_order(log):
    arrived = [message.log_ns for message in log.messages]
    assert arrived == sorted(arrived)
    assert all(message.log_ns >= message.stamp_ns for message in log.messages)
    for sensor in (*log.rig.mounts, "pose"):
        stamps = list(log.of(sensor))
        assert all(b > a for a, b in pairwise(stamps)), sensor
    late = {sensor: [m.log_ns - m.stamp_ns for m in log.of(sensor).values()] for sensor in log.rig.mounts}
    assert 10e6 <= min(late["lidar"]) <= max(late["lidar"]) <= 12e6
    assert 5e6 <= min(late["radar"]) <= max(late["radar"]) <= 7e6
    assert 15e6 <= min(late["stereo_left"]) <= max(late["stereo_left"]) <= 17e6


def test_the_log_has_all_that_its_rig_promises(log):
    num = {sensor: len(log.of(sensor)) for sensor in (*log.rig.mounts, "pose")}
    assert num == {"lidar": 10, "radar": 20, "stereo_left": 5, "stereo_right": 5, "pose": 100}
    assert list(log.truths) == list(log.images("stereo_left"))
    for cloud in log.clouds().values():
        assert len(cloud.xyz) <= 50_000
        assert cloud.ring.max() <= 127
        assert (np.diff(cloud.offset_ns) >= 0).all()
        assert ((cloud.intensity > 0) & (cloud.intensity <= 1)).all()
        assert np.linalg.norm(cloud.xyz, axis=1).max() < 100.06
    assert log.info.metadata["scenario"] in ("urban", "highway")
    assert {region.kind for region in log.info.regions} >= {"road"}


@pytest.mark.parametrize(
    "args",
    [
        pytest.param(("urban", *SMALL), id="every kind"),
        pytest.param(("highway", *SMALL[:6], "--sensors", "lidar"), id="LiDAR alone", marks=pytest.mark.slow),
        pytest.param(("urban", "--sensors", "radar", "--set", "radar.clutter=20", "--set", "radar.multipath=0.5",
                      "--set", "radar.merge_cells=true"), id="radar alone", marks=pytest.mark.slow),
        pytest.param(("urban", "--sensors", "camera", "--set", "camera.size_wh=[64, 48]"),
                     id="camera alone", marks=pytest.mark.slow),
        pytest.param(("urban", *SMALL, "--set", "radar.rate_hz=13", "--set", "radar.phase_ms=7.3", "--set",
                      "lidar.phase_ms=33", "--set", "lidar.motion=true", "--set", "camera.rate_hz=7.5", "--set",
                      "lidar.jitter_ms=20"), id="odd rates"),
    ],
)  # fmt: skip
def test_the_check_of_logs_finds_nothing(tmp_path, capsys, args):
    simulated(tmp_path, "log", *args, "--seconds", 0.6)
    capsys.readouterr()
    code = run("log", "check", tmp_path / "log.mcap", "--json")
    assert (code, json.loads(capsys.readouterr().out)["findings"]) == (0, [])


def test_what_is_lost_is_not_there_and_the_check_says_so(tmp_path, capsys):
    log = simulated(tmp_path, "log", "urban", *SMALL, "--set", "radar.loss=0.3", "--seconds", 1)
    assert 8 <= len(log.scans()) <= 19
    assert f"radar {len(log.scans())}" in capsys.readouterr().out
    assert run("log", "check", log.path, "--json") == 1
    codes = {(f["code"], f["source"]) for f in json.loads(capsys.readouterr().out)["findings"]}
    assert ("CHK003", "radar") in codes
    assert all(source != "lidar" for _, source in codes)


def digest(path):
    return hashlib.blake2b(path.read_bytes()).hexdigest()


WAYS = {
    "one": (("--threads", "1"), {"PYTHONHASHSEED": "1", "TZ": "Asia/Kathmandu"}),
    "four": (("--threads", "4"), {"PYTHONHASHSEED": "2", "LC_ALL": "tr_TR.UTF-8", "OMP_NUM_THREADS": "1"}),
}


@pytest.mark.slow
@pytest.mark.parametrize(("world", "seed", "ways"), [("urban", 3, ("one", "four")), ("highway", 4, ("four",))])
def test_the_same_command_writes_the_same_bytes_in_any_process(tmp_path, world, seed, ways):
    """In this one, too, whose city stays from other logs; `test_city_shared` builds one twice."""
    command = ["log", "simulate", world, "--condition", "rain+night", "--seed", seed, "--seconds", "0.4", *SMALL]
    assert run(*command, "-o", tmp_path / "log.mcap") == 0
    found = {digest(tmp_path / "log.mcap")}
    for name in ways:
        more, environ = WAYS[name]
        folder = tmp_path / name
        folder.mkdir()
        words = [*FBENCH, *map(str, command), *more, "-o", "log.mcap"]
        subprocess.run(words, cwd=folder, env={**os.environ, **environ}, check=True)
        found.add(digest(folder / "log.mcap"))
    assert len(found) == 1


@pytest.mark.slow
def test_another_seed_has_other_bytes(tmp_path):
    logs = {}
    for name, seed, threads in (("a", 4, 1), ("b", 4, 3), ("c", 1, 3)):
        folder = tmp_path / name
        folder.mkdir()
        logs[name] = simulated(folder, "log", "highway", "--seed", seed, "--threads", threads, "--seconds", 0.2, *SMALL)
    digests = {name: digest(log.path) for name, log in logs.items()}
    assert digests["a"] == digests["b"] != digests["c"]
    assert logs["a"].info.log_id == logs["b"].info.log_id != logs["c"].info.log_id


@pytest.mark.slow
def test_parquet_keeps_everything(under, tmp_path):
    log = under("clear")
    folder, back = tmp_path / "log.parquet", tmp_path / "back.mcap"
    assert run("log", "convert", log.path, "-o", folder) == 0
    assert run("log", "convert", folder, "-o", back) == 0
    assert run("log", "check", folder) == 0
    for copy in (read(folder), read(back)):
        assert copy.info.log_id == log.info.log_id
        assert dict(copy.info.metadata) == dict(log.info.metadata)
        assert [(m.sensor, m.stamp_ns, m.log_ns) for m in copy.messages] == [
            (m.sensor, m.stamp_ns, m.log_ns) for m in log.messages
        ]
        for stamp_ns, cloud in log.clouds().items():
            other = copy.clouds()[stamp_ns]
            for field in ("xyz", "intensity", "ring", "offset_ns"):
                assert getattr(other, field).tobytes() == getattr(cloud, field).tobytes()
        for stamp_ns, scan in log.scans().items():
            echoes = copy.scans()[stamp_ns]
            for field in ("xyz", "radial_velocity_mps", "rcs_dbsm", "range_m", "azimuth_rad", "altitude_rad"):
                assert getattr(echoes, field).tobytes() == getattr(scan, field).tobytes()
        for stamp_ns, truth in log.truths.items():
            for kind in ("boxes3d", "boxes2d"):
                boxes = getattr(copy.truths[stamp_ns], kind).arrays()
                for field, values in getattr(truth, kind).arrays().items():
                    assert boxes[field].tolist() == values.tolist(), field


_PEAK = """
import resource, sys
from fbench.cli import main
sys.argv = ["fbench", *sys.argv[1:]]
try:
    main()
except SystemExit as stop:
    assert not stop.code, stop.code
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)
"""


@pytest.mark.slow
def test_memory_does_not_grow_with_length(tmp_path):
    peaks = []
    for seconds in ("1", "4"):
        out = ["-o", str(tmp_path / f"{seconds}.mcap"), "--threads", "2", "--seconds", seconds]
        args = ["log", "simulate", "highway", "--sensors", "lidar", "--sensors", "radar", *out]
        done = subprocess.run([sys.executable, "-c", _PEAK, *args], capture_output=True, text=True, check=True)
        peaks.append(int(done.stderr.split()[-1]))
    assert peaks[1] < 1.1 * peaks[0], peaks
