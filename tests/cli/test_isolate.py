"""Plug-ins in a process of their own: the same bytes, and whatever they do costs no more than a frame."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import MS, rig, write_log

from fbench.replay.data.messages import PointCloud
from fbench.replay.runs.folder import Run

MEASURED = {"host.json", "latency.json", "timings.parquet"}
PLUGIN = """
import ctypes, os, signal, subprocess, sys, threading, time
from dataclasses import dataclass
import numpy as np
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault, Output

@dataclass(frozen=True)
class Params:
    size_m: float = 4.0

class Good:
    def __init__(self, params: Params = Params()):
        self.params = params

    def start(self, rig, log_info):
        self.names, self.age = tuple(rig.kinds), 0

    def reset(self, reason):
        self.age = 0

    def step(self, frame):
        self.age += 1
        if frame.index == 3:
            self.misbehave()
        if frame.index == 1:  # empty, but with columns
            none = Boxes3D.empty()
            return Output(none, Boxes3D(none.center_m, none.size_lwh_m, none.yaw_rad, track_id=np.zeros(0, int)), {})
        center = np.array([[self.age, -0.0, len(self.names)], [np.nan, 1, 1]])
        boxes = Boxes3D(
            center, np.full((2, 3), self.params.size_m), np.zeros(2), label=np.array(["car", ""]),
            score=np.array([0.1, np.inf]), track_id=np.array([7, 8]), attribute=np.array(["", "\\u00fc"]),
            num_lidar_pts=np.array([2**40, 1]), ignore=np.array([True, False]),
        )
        missing = {"radar": "too few", "camera": "too dark"}
        return Output(boxes, boxes, {"b": 2, "a": 1}, (Fault("DEC002", "here"),), missing)

    def misbehave(self): pass

    def identity(self): return {"weights": [1, {"file": "a"}]}

    def required_sensors(self): return {"lidar"}

    is_tracker = True

class Raises(Good):
    def misbehave(self): raise ValueError("oh\\nno")

class NoText(Exception):
    def __str__(self): raise KeyError("x")

def hog():  # most of the machine's memory, though none of it is touched
    np.empty(int(0.95 * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")), np.uint8)

def loop():
    while True: pass

def close_all(): os.closerange(0, 3)

def shadow():
    # All that the process has open to fbench, with garbage.
    for fd in range(3, 10):
        try: os.write(fd, b"abcdefgh")
        except OSError: pass
    time.sleep(60)

def daemon():
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True)
    with open("daemon.pid", "w") as file: file.write(str(child.pid))
    os._exit(7)

def flood():
    for _ in range(1000): print("x" * 10000)
    print("\\x1b[2Jlast", end="\\n\\n")

def of(act, name):
    globals()[name] = type(name, (Good,), {"misbehave": lambda self: act(), "__module__": __name__})

def throw(error): raise error

of(lambda: os._exit(0), "Exits")
of(lambda: ctypes.string_at(0), "Segfaults")
of(loop, "Loops")
of(hog, "Hogs")
of(close_all, "ClosesAll")
of(shadow, "Shadows")
of(daemon, "LeavesDaemon")
of(flood, "Floods")
of(lambda: throw(GeneratorExit()), "GeneratorExits")
of(lambda: throw(KeyboardInterrupt()), "Interrupts")
of(lambda: sys.exit(0), "SysExits")
of(lambda: throw(NoText()), "HasNoText")
of(lambda: sys.setrecursionlimit(60), "Shallow")
of(lambda: [signal.signal(s, signal.SIG_IGN) for s in (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)], "Ignores")
of(lambda: threading.Thread(target=time.sleep, args=(600,)).start(), "LeavesThread")
of(lambda: input(), "Reads")

class NoOutput(Good):
    def step(self, frame): return 5

class AtImport(Good): pass

class AtMake(Good):
    def __init__(self): os._exit(0)

class AtStart(Good):
    def start(self, rig, log_info): ctypes.string_at(0)

class Picky(Good):
    def start(self, rig, log_info): raise LogError("no camera", "CFG001")

class AtClose(Good):
    def close(self): raise OSError("gone")

class HangsAtClose(Good):
    def close(self): loop()

class AtIdentity(Good):
    def identity(self): os._exit(3)

class UsesLog(Good):
    def use_log(self, log): pass
"""


@pytest.fixture
def log(tmp_path):
    """Six sweeps of a LiDAR and nothing else, so that no kernel is needed."""
    stamps = [10**9 + 100 * MS * i for i in range(6)]
    clouds = [PointCloud("lidar", s, s + MS, np.array([[10.0, 0, 1]], np.float32)) for s in stamps]
    (tmp_path / "mine.py").write_text(PLUGIN)
    return write_log(tmp_path / "drive.mcap", clouds, rig(camera=False))


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.name not in MEASURED}


@pytest.mark.parametrize("cls", ["Good", "Raises", "NoOutput"])
def test_isolated_run_has_the_same_bytes(fbench, log, cls):
    results = [
        fbench("replay", log, "-p", f"mine.py:{cls}", "--set", "size_m=3", "-o", folder, *more)
        for folder, more in (("here", ()), ("apart", ("--isolate",)))
    ]
    assert results[0].code == results[1].code == (3 if cls == "NoOutput" else 4), results[1].err
    if cls == "NoOutput":
        assert results[0].err == results[1].err
    else:
        assert files(Path("here")) == files(Path("apart"))
        assert Run(Path("apart")).json("latency.json")["stages"][-1]["cpu_mean_ms"] > 0


def require_ended(number: str) -> None:
    """See that a process ends; the system takes a moment for one that was killed, or lost its parent."""
    stat = Path(f"/proc/{number.strip()}/stat")
    for _ in range(500):
        with suppress(FileNotFoundError, ProcessLookupError):
            if stat.read_text().split()[2] != "Z":
                time.sleep(0.02)
                continue
        return
    pytest.fail(f"process {number.strip()} goes on")


LOST = {
    "Exits": "mine.py:Exits exited with 0",
    "Segfaults": "mine.py:Segfaults exited with 139 (SIGSEGV)",
    "Loops": "mine.py:Loops gave no answer within 1 s",
    "Hogs": "MemoryError: Unable to allocate ",
    "Shadows": "mine.py:Shadows ",
    "LeavesDaemon": "mine.py:LeavesDaemon exited with 7",
    "GeneratorExits": "GeneratorExit: no message (mine.py:",
    "Interrupts": "KeyboardInterrupt: no message (mine.py:",
    "SysExits": "SystemExit: 0 (mine.py:",
    "HasNoText": "NoText: its text can't be made (KeyError) (mine.py:",
    "Reads": "EOFError: EOF when reading a line (mine.py:",
}


@pytest.mark.parametrize(
    "cls", [pytest.param(cls, marks=() if cls in ("Segfaults", "Loops") else pytest.mark.slow) for cls in LOST]
)
def test_what_an_isolated_plugin_does_costs_one_frame(fbench, log, tmp_path, cls):
    result = fbench("replay", log, "-p", f"mine.py:{cls}", "-o", "run", "--isolate", "--frame-timeout-s", "1")
    assert (result.code, result.err) == (4, "")
    failed = {frame.index: frame.failed for frame in Run(tmp_path / "run").frames if frame.failed}
    assert list(failed) == [3]
    assert failed[3].startswith(LOST[cls])
    assert failed[3].isprintable()
    if cls == "LeavesDaemon":
        require_ended((tmp_path / "daemon.pid").read_text())


@pytest.mark.slow
@pytest.mark.parametrize("cls", ["ClosesAll", "Floods", "Shallow", "Ignores", "LeavesThread"])
def test_what_harms_only_its_own_process_costs_nothing(fbench, log, tmp_path, cls):
    result = fbench("replay", log, "-p", f"mine.py:{cls}", "-o", "run", "--isolate", "--on-fault", "tolerant")
    assert (result.code, result.err) == (0, "")
    assert "\x1b" not in result.out
    assert not any(frame.failed for frame in Run(tmp_path / "run").frames)
    assert ((tmp_path / "run" / "stderr.txt").exists()) == (cls == "Floods")


@pytest.mark.parametrize(
    ("cls", "code", "line"),
    [
        ("AtMake", 2, "pipeline 'mine.py:AtMake' can't be made: mine.py:AtMake exited with 0"),
        ("AtStart", 3, "pipeline 'mine-AtStart' can't start: mine.py:AtStart exited with 139 (SIGSEGV)"),
        ("Picky", 3, "no camera [CFG001]"),
        ("AtClose", 3, "pipeline 'mine.py:AtClose' can't be closed: OSError: gone (mine.py:"),
        ("HangsAtClose", 3, "pipeline 'mine.py:HangsAtClose' can't be closed: mine.py:HangsAtClose gave no answer"),
        ("AtIdentity", 3, "pipeline 'mine-AtIdentity' can't say what tells it apart: mine.py:AtIdentity exited with 3"),
        ("UsesLog", 2, "pipeline 'mine.py:UsesLog' reads the log itself, so it can't be isolated"),
        ("Godo", 2, "mine.py: has no class 'Godo'; did you mean 'Good'?"),
    ],
)
def test_an_isolated_plugin_that_fails_elsewhere_is_one_line(fbench, log, monkeypatch, cls, code, line):
    monkeypatch.setattr("fbench.pipelines.external.isolated.CLOSE_TIMEOUT_S", 1.0)
    result = fbench("replay", log, "-p", f"mine.py:{cls}", "-o", "run", "--isolate")
    assert (result.code, result.err.count("\n")) == (code, 1), result.err
    assert result.err.startswith(f"fbench: {line}")
    assert not list(Path().glob(".run*"))


@pytest.mark.parametrize("name", ["track", "recorded:/detections"])
def test_pipelines_that_read_the_log_themselves_are_not_isolated(fbench, log, name):
    result = fbench("replay", log, "-p", name, "-o", "run", "--isolate")
    line = f"fbench: pipeline '{name}' reads the log itself, so it can't be isolated; leave out --isolate\n"
    assert (result.code, result.err) == (2, line)


def test_an_isolated_file_is_never_imported_here(fbench, log):
    Path("deadly.py").write_text("import os\nos._exit(0)\n")
    result = fbench("replay", log, "-p", "deadly.py:Any", "-o", "run", "--isolate", "--detect-every", "2")
    assert (result.code, result.err.count("\n")) == (2, 1)
    assert "pipeline 'deadly.py:Any' can't be made: deadly.py:Any exited with 0" in result.err


@pytest.mark.slow
def test_checks_and_verification_isolate_too(fbench, log, circumstances):
    circumstances("hash seed")
    check = fbench("log", "check", log, "-p", "mine.py:AtStart", "--isolate")
    assert (check.code, check.err) == (1, "")
    assert "PRD002" in check.out
    assert "SIGSEGV" in check.out
    verify = fbench("verify", log, "-p", "mine.py:Good", "--isolate", "--quick")
    assert (verify.code, verify.err) == (0, "")


def test_nothing_of_an_isolated_plugin_stays_open(fbench, log):
    before = sorted(os.listdir("/proc/self/fd"))
    fbench("replay", log, "-p", "mine.py:Segfaults", "-o", "run", "--isolate")
    assert sorted(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_an_isolated_plugin_ends_with_fbench(log, tmp_path, number):
    marked = PLUGIN.replace("def loop():", "def loop():\n    print(os.getpid(), file=open('pid', 'w'), flush=True)")
    (tmp_path / "mine.py").write_text(marked)
    command = [sys.executable, "-P", "-c", "from fbench.cli import main; main()", "replay", str(log), "-p",
               "mine.py:Loops", "-o", "run", "--isolate", "--frame-timeout-s", "600"]  # fmt: skip
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as parent:
        while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
            assert parent.poll() is None
            time.sleep(0.02)
        parent.send_signal(number)
        _, err = parent.communicate(timeout=60)
    assert parent.returncode == (-number if number == signal.SIGKILL else 128 + number)
    assert err.strip() == ""
    require_ended((tmp_path / "pid").read_text())
