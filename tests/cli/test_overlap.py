"""`--overlap`: several frames at the same time give the bytes of one after the other, whatever plug-ins do."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tests.city_log import write_city_log
from tests.pipelines.networks import encode_pixels
from tests.recordings import PIPELINES

from fbench.replay.runs.folder import Run

RGBD = "early2d with a network"
MEASURED = {"host.json", "latency.json", "timings.parquet"}
PLUGIN = """
import os, time
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Good:
    def start(self, rig, log_info): self.seen, self.age = [], 0
    def reset(self, reason): self.seen, self.age = [], 0
    def step(self, frame): return self.conclude(frame, self.observe(frame))
    def pass_by(self, frame): self.seen.append(frame.index)
    def observe(self, frame):
        assert self.seen == list(range(frame.index))  # each frame came once, in order
        self.seen.append(frame.index)
        self.misbehave(frame)
        return float(sum(len(m.xyz) for m in frame.messages.values() if hasattr(m, "xyz")))
    def conclude(self, frame, observed):
        self.age += 1
        boxes = Boxes3D(np.array([[self.age, observed, 0.0]]), np.ones((1, 3)), np.zeros(1), track_id=np.array([7]))
        return Output(boxes, boxes, {"sum": 1})
    def misbehave(self, frame): pass

class Fails(Good):
    def misbehave(self, frame):
        if frame.index in (1, 4): raise ValueError(f"frame {frame.index} is odd")

class Dies(Good):
    def misbehave(self, frame):
        if frame.index == 2 and os.getpid() != int(os.environ["MAIN_PID"]): os._exit(7)

class CantBeSent(Good):
    def observe(self, frame): return lambda: 1

class CantBeRead(Good):
    class Odd:
        def __reduce__(self): return int, ("x",)
    def observe(self, frame): return self.Odd()

class HasNoClock(Good):
    def cpu_ns(self): return {}["cpu"]

class Waits(Good):
    def misbehave(self, frame):
        open(f"pid{os.getpid()}", "w").close()
        time.sleep(60)

class Plain:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame): return Output(Boxes3D.empty(), None, {})
"""


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    monkeypatch.setenv("MAIN_PID", str(os.getpid()))
    (tmp_path / "mine.py").write_text(PLUGIN)
    return tmp_path / "mine.py"


def files(folder: Path) -> dict[str, bytes]:
    found = {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
    return {name: content for name, content in found.items() if name not in MEASURED}


def replay_both(fbench, log: Path, pipeline: str, *more) -> tuple[int, dict[str, bytes], dict[str, bytes]]:
    """Replay one frame after the other and with overlap; both end alike."""
    results = [fbench("replay", log, "-p", pipeline, "--overlap", n, "-o", f"run{n}", *more) for n in (1, 2)]
    assert results[0].code == results[1].code, results[1].err
    return results[0].code, files(Path("run1")), files(Path("run2"))


@pytest.mark.slow
def test_built_in_pipelines_give_the_same_bytes(fbench, log) -> None:
    code, plain, overlapped = replay_both(fbench, log, "late3d")
    assert (code, plain) == (0, overlapped)
    host = Run(Path("run2")).json("host.json")
    assert host["overlap"] == 2
    assert host["frames_per_s"] > 0


def test_a_plugin_sees_each_frame_once_and_a_failed_frame_is_the_same_fault(fbench, log, plugin) -> None:
    code, plain, overlapped = replay_both(fbench, log, f"{plugin}:Fails")
    assert plain == overlapped
    assert code == 4
    failed = [frame.failed for frame in Run(Path("run2")).frames]
    assert [text and text.split(" (")[0] for text in failed] == [
        None, "ValueError: frame 1 is odd", None, None, "ValueError: frame 4 is odd", None,
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("Dies", "ended (exit code 7)"),
        ("CantBeSent", "what `observe` returned can't be sent"),
        ("CantBeRead", "what `observe` returned can't be read"),
    ],
)
def test_a_lost_process_ends_the_replay_in_one_line(fbench, log, plugin, name: str, what: str) -> None:
    result = fbench("replay", log, "-p", f"{plugin}:{name}", "--overlap", 2, "-o", "run")
    assert result.code == 3
    assert what in result.err
    assert not Path("run").exists()


def test_a_plugin_that_cant_tell_its_cpu_time_is_one_line(fbench, log, plugin) -> None:
    result = fbench("replay", log, "-p", f"{plugin}:HasNoClock", "-o", "run")
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "can't tell its CPU time: KeyError: 'cpu'" in result.err


def test_pipelines_that_dont_say_so_run_one_frame_after_the_other(fbench, log, plugin) -> None:
    assert fbench("replay", log, "-p", f"{plugin}:Plain", "--overlap", 2, "-o", "run").code == 0
    assert Run(Path("run")).json("host.json")["overlap"] == 1


@pytest.mark.parametrize(
    "options",
    [("0",), ("257",), ("2", "--latency", "fixed:80ms"), ("2", "--rate", "2"), ("2", "--isolate")],
)
def test_options_that_make_no_sense_are_refused(fbench, log, options: tuple[str, ...]) -> None:
    result = fbench("replay", log, "-p", "lidar3d", "--overlap", *options)
    assert result.code == 2
    assert f"--overlap {options[0]}" in result.err


@pytest.mark.slow
def test_ctrl_c_ends_all_processes(log, plugin, tmp_path) -> None:
    words = [sys.executable, "-c", "from fbench.cli import main; main()", "replay", log, "-p", f"{plugin}:Waits"]
    process = subprocess.Popen([*words, "--overlap", "2", "-o", "run"], cwd=tmp_path, stderr=subprocess.PIPE)
    while len(found := list(tmp_path.glob("pid*"))) < 2:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert b"Traceback" not in err
    for path in found:
        with pytest.raises(ProcessLookupError):
            os.kill(int(path.name.removeprefix("pid")), 0)
    assert not list(tmp_path.glob("run*"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "pipeline", [name for name in (*PIPELINES, "learned3d", RGBD) if not name.startswith(("thesis/", "track"))]
)
def test_every_pipeline_on_the_city(fbench, tmp_path, pipeline: str) -> None:
    write_city_log(tmp_path / "city.mcap", 0.8, cameras=True)
    more = ["--condition", "fog:3+dropout.lidar:1+extrinsic:2", "--detect-every", "2"]
    if pipeline == RGBD:
        (tmp_path / "pixels.onnx").write_bytes(encode_pixels((160, 120), side_px=12.0))
        more += ["--set", "detector=rgbd", "--set", f"rgbd.weights={tmp_path / 'pixels.onnx'}"]
    code, plain, overlapped = replay_both(fbench, tmp_path / "city.mcap", pipeline.partition(" ")[0], *more)
    assert code in (0, 4), "as frames are missing, results aren't complete"
    assert plain == overlapped
    assert Run(Path("run2")).json("host.json")["overlap"] == 2
