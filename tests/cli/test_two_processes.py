"""Two processes of fbench that write to one place: one wins, and the other says so in a line."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fbench.datasets.importing.run import claim
from fbench.replay.data.files import Draft
from fbench.replay.runs.folder import Run

PLUGIN = """
import os, sys, time
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Waits:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        print("begun", file=sys.stderr, flush=True)
        while not os.path.exists("go"): time.sleep(0.01)
        return Output(Boxes3D.empty(), Boxes3D.empty(), {})

class Exits(Waits):
    def step(self, frame): os._exit(0)

class Segfaults(Waits):
    def step(self, frame): __import__("ctypes").string_at(0)
"""


def start(folder: Path, *args: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-P", "-c", "from fbench.cli import main; main()", *map(str, args)]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_the_second_replay_into_a_folder_is_refused(fbench, log, tmp_path):
    (tmp_path / "mine.py").write_text(PLUGIN)
    first = start(tmp_path, "replay", log, "-p", "mine.py:Waits", "-o", "run")
    assert first.stderr.readline() == "begun\n"
    second = fbench("replay", log, "-p", "mine.py:Waits", "-o", "run", "--overwrite")
    assert (second.code, second.err) == (
        2, "fbench: run: another process is writing it; try again when it has finished\n",
    )  # fmt: skip
    (tmp_path / "go").touch()
    assert first.wait() == 0
    assert len(Run(tmp_path / "run").frames) == 6
    first.communicate()


@pytest.mark.parametrize("out", ["out.mcap", "out.html"])
def test_what_another_process_writes_is_left_alone(fbench, log, tmp_path, out):
    if out == "out.html":
        (tmp_path / "mine.py").write_text(PLUGIN)
        (tmp_path / "go").touch()
        assert fbench("replay", log, "-p", "mine.py:Waits", "-o", "run").code == 0
    with Draft(tmp_path / out) as draft:
        child = start(tmp_path, *(("report", "run") if out == "out.html" else ("log", "convert", log)), "-o", out)
        _, err = child.communicate()
        why = f"fbench: {out}: another process is writing it; try again when it has finished\n"
        assert (child.returncode, err) == (2, why)
        assert draft.path.exists()


def test_a_second_demo_waits_and_says_so(tmp_path):
    with claim(tmp_path / "runs" / "demo" / "demo", lambda: None):
        child = start(tmp_path, "demo")
        assert child.stdout.readline() == "waiting for another fbench demo in this folder\n"
        child.send_signal(signal.SIGTERM)
        _, err = child.communicate()
        assert (child.returncode, err) == (128 + signal.SIGTERM, "")


@pytest.mark.parametrize(("cls", "code"), [("Exits", 0), ("Segfaults", -signal.SIGSEGV)])
def test_a_plugin_that_ends_the_process_blocks_no_later_run(fbench, log, tmp_path, cls, code):
    """In this process nothing can be said about it any more: that takes --isolate."""
    (tmp_path / "mine.py").write_text(PLUGIN)
    (tmp_path / "go").touch()
    child = start(tmp_path, "replay", log, "-p", f"mine.py:{cls}", "-o", "run")
    child.communicate()
    assert child.returncode == code
    assert not (tmp_path / "run").exists()
    assert fbench("replay", log, "-p", "mine.py:Waits", "-o", "run").code == 0
    assert not list(tmp_path.glob(".run*"))


def test_ctrl_c_is_told_from_what_a_plugin_raises(fbench, log, tmp_path):
    (tmp_path / "mine.py").write_text(PLUGIN.replace('print("begun"', "raise KeyboardInterrupt\n        print(0"))
    result = fbench("replay", log, "-p", "mine.py:Waits", "-o", "run")
    assert (result.code, result.err.strip().count("\n")) == (3, 0)
    assert "a plug-in ended the command with KeyboardInterrupt" in result.err
    (tmp_path / "mine.py").write_text(PLUGIN)
    child = start(tmp_path, "replay", log, "-p", "mine.py:Waits", "-o", "run")
    assert child.stderr.readline() == "begun\n"
    child.send_signal(signal.SIGINT)
    child.communicate()
    assert child.returncode == 128 + signal.SIGINT
    assert not list(tmp_path.glob(".run*"))
