"""`fbench replay -p exec:...` as a user calls it."""

import hashlib
import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from tests.city_log import write_city_log
from tests.cli.conftest import fbench
from tests.pipelines.external.programs import ROOT, wicked

from fbench.replay.contracts.errors import RunError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run

__all__ = ["fbench"]
FBENCH = [sys.executable, "-c", "from fbench.cli import main; main()"]
NEAREST = f"exec:{sys.executable} nearest.py 4"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Where a user works: a log, and a program beside it."""
    monkeypatch.chdir(tmp_path)
    write_city_log(tmp_path / "city.mcap", 1.0)
    for name in ("client.py", "nearest.py"):
        (tmp_path / name).write_text((ROOT / "examples" / "exec" / "python" / name).read_text())
    return tmp_path


def program(folder, code):
    """`exec:` of a program that runs `code` first."""
    with closing(wicked(folder, code)) as pipeline:
        return "exec:" + shlex.join(pipeline._command.words)


@pytest.mark.slow
def test_runs_are_the_same(fbench, folder):
    for out in ("a", "b"):
        assert fbench("replay", "city.mcap", "-p", NEAREST, "-o", out).code == 0
    a, b = Run(Path("a")), Run(Path("b"))
    assert a.manifest.digest == b.manifest.digest
    assert a.manifest.parameters["command"] == f"{sys.executable} nearest.py 4"


def sha256(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@pytest.mark.slow
def test_manifest_tells_builds_apart(fbench, folder):
    """The same command, but the program was built anew in between."""
    python = {"file": Path(sys.executable).name, "sha256": sha256(sys.executable)}
    before = sha256("nearest.py")
    assert fbench("replay", "city.mcap", "-p", NEAREST, "-o", "a").code == 0
    Path("nearest.py").write_text(Path("nearest.py").read_text() + "# another build\n")
    assert fbench("replay", "city.mcap", "-p", NEAREST, "-o", "b", "--redact").code == 0
    a, b = Run(Path("a")).manifest.parameters, Run(Path("b")).manifest.parameters
    assert a["program.name"] == "nearest"
    assert a["program.files"] == [python, {"file": "nearest.py", "sha256": before}]
    assert b["program.files"] == [{"sha256": python["sha256"]}, {"sha256": sha256("nearest.py")}]
    assert before != sha256("nearest.py")


@pytest.mark.slow
def test_crashes_are_counted_and_stderr_is_kept(fbench, folder):
    result = fbench("replay", "city.mcap", "-p", program(folder, "ACTIONS = {3: lambda r: os.abort()}"), "-o", "run")
    assert result.code == 4
    assert "PRD002" in result.out
    assert Path("run/stderr.txt").read_bytes() == b"hello\nhello\n"
    failed = pq.read_table("run/frames.parquet")["failed"].to_pylist()
    assert [reason is not None for reason in failed] == [i == 3 for i in range(10)]
    assert "exited with 134 (SIGABRT); last line on stderr: hello" in failed[3]


def test_failures_in_a_row_end_the_replay(tmp_path):
    write_city_log(tmp_path / "city.mcap", 1.2)
    faults = FaultLog()
    with closing(wicked(tmp_path, "ACTIONS = {i: lambda r: os._exit(1) for i in range(99)}")) as pipeline:
        plan = Plan(pipeline, "exec")
        with pytest.raises(
            RunError, match=r"failed on 10 frames in a row: .*exited with 1; last line on stderr: hello"
        ):
            replay(open_log(tmp_path / "city.mcap", faults), plan, tmp_path / "run", faults)
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("pipeline", "code", "line"),
    [
        ("exec:./absent --x", 2, "fbench: exec: ./absent: no such program\n"),
        ("exec:", 2, "fbench: exec: needs a command, such as -p 'exec:./my_stack --option'\n"),
        ("exec", 2, "fbench: exec: needs a command, such as -p 'exec:./my_stack --option'\n"),
        ("exec:true", 3, "fbench: exec: can't start: true exited with 0\n"),
    ],
)
def test_commands_that_cannot_run_are_one_line(fbench, folder, pipeline, code, line):
    result = fbench("replay", "city.mcap", "-p", pipeline)
    assert (result.code, result.err) == (code, line)
    assert not Path("runs").exists() or not list(Path("runs").iterdir())


@pytest.mark.slow
def test_check_finds_that_a_program_cannot_start(fbench, folder):
    result = fbench("log", "check", "city.mcap", "-p", "exec:true")
    assert (result.code, result.err) == (1, "")
    assert "error PRD002: true can't start: exec: can't start: true exited with 0" in result.out


@pytest.mark.slow
def test_check_tries_the_program_and_ends_it(fbench, folder):
    result = fbench("log", "check", "city.mcap", "-p", NEAREST, "--json")
    assert result.code in (0, 1)
    assert "PRD002" not in result.out


@pytest.mark.slow
def test_verify_replays_the_program_in_fresh_processes(fbench, folder):
    result = fbench("verify", "city.mcap", "-p", NEAREST, "--quick", "--frames", ":3")
    assert result.code == 0, result.out + result.err
    assert "identical: all" in result.out


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_cancelled_replay_ends_the_program(folder, number):
    code = "open('pid', 'w').write(str(os.getpid())); ACTIONS = {2: lambda r: (open('here', 'w'), time.sleep(60))}"
    arguments = ["replay", "city.mcap", "-p", program(folder, code), "--set", "close_timeout_s=0.2"]
    process = subprocess.Popen([*FBENCH, *arguments], stderr=subprocess.PIPE)
    while not Path("here").exists():
        time.sleep(0.05)
        assert process.poll() is None
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert b"Traceback" not in err
    with pytest.raises(ProcessLookupError):
        os.kill(int(Path("pid").read_text()), 0)
    assert list(Path("runs").iterdir()) == []
