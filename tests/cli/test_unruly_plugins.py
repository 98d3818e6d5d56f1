"""Pipelines that raise where nobody steps them: one line, whatever it is."""

import pytest

UNRULY = """
import sys
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Quiet:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame): return Output(Boxes3D.empty(), Boxes3D.empty(), {})

class AtLog(Quiet):
    def use_log(self, log): raise ZeroDivisionError("oh\\nno")

class AtClose(Quiet):
    def close(self): raise OSError("gone")

class AtIdentity(Quiet):
    def identity(self): raise SystemExit(0)

class NoMapping(Quiet):
    def identity(self): return None

class NoJson(Quiet):
    def identity(self): return {"weights": object()}

class NotANumber(Quiet):
    def identity(self): return {"share": float("nan")}

class AtStderr(Quiet):
    def stderr(self): raise KeyError("log")

class HangsAtClose(Quiet):
    def close(self):
        while True: pass

class Paints(Quiet):
    def step(self, frame):
        print("\\x1b[2Jout\\a")
        print("\\x1b]0;title\\x07err\\tor", file=sys.stderr)
        return super().step(frame)

class AtStepAndClose(AtClose):
    def step(self, frame): raise ValueError("first")
"""


@pytest.mark.parametrize(
    ("cls", "line"),
    [
        ("AtLog", "pipeline 'unruly-AtLog' can't use the log: ZeroDivisionError: oh (unruly.py:"),
        ("AtClose", "unruly.py:AtClose' can't be closed: OSError: gone (unruly.py:"),
        ("AtIdentity", "pipeline 'unruly-AtIdentity' can't say what tells it apart: SystemExit: 0 (unruly.py:"),
        ("NoMapping", "can't say what tells it apart: TypeError: "),
        ("NoJson", "can't say what tells it apart: TypeError: Object of type object is not JSON serializable"),
        ("NotANumber", "can't say what tells it apart: ValueError: Out of range float values"),
        ("AtStderr", "pipeline 'unruly-AtStderr' can't give its stderr: KeyError: 'log' (unruly.py:"),
        ("AtStepAndClose", "failed on all 6 frames: ValueError: first"),
    ],
)
def test_what_pipelines_raise_is_one_line(fbench, log, tmp_path, cls, line):
    (tmp_path / "unruly.py").write_text(UNRULY)
    result = fbench("replay", log, "-p", f"unruly.py:{cls}", "-o", "run")
    assert (result.code, result.err.count("\n")) == (3, 1), result.err
    assert line in result.err


def test_a_log_that_a_pipeline_cannot_take_is_one_line_in_a_check(fbench, log, tmp_path):
    (tmp_path / "unruly.py").write_text(UNRULY)
    result = fbench("log", "check", log, "-p", "unruly.py:AtLog")
    assert (result.code, result.err.count("\n")) == (3, 1), result.err
    assert "can't use the log: ZeroDivisionError: oh" in result.err


def test_a_close_that_hangs_is_ended(fbench, log, tmp_path, monkeypatch):
    monkeypatch.setattr("fbench.replay.contracts.plugins.CLOSE_TIMEOUT_S", 0.2)
    (tmp_path / "unruly.py").write_text(UNRULY)
    result = fbench("replay", log, "-p", "unruly.py:HangsAtClose", "-o", "run")
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "can't be closed: TimeoutError: took longer than 0.2 s" in result.err


def test_what_a_plugin_prints_cannot_steer_the_terminal(fbench, log, tmp_path):
    (tmp_path / "unruly.py").write_text(UNRULY)
    result = fbench("replay", log, "-p", "unruly.py:Paints", "-o", "run", "--json")
    assert result.code == 0
    assert result.json()
    assert result.err == 6 * " [2Jout \n ]0;title err\tor\n"
