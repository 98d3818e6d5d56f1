"""`fbench bench`: tiny suites that run, stop, and go on, here and on a cluster."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from glob import glob
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
from tests.api.suites.test_run import MINE
from tests.cli.conftest import messages, rig, truths, write_log

from fbench.cli.bench import SuiteProgress

MEASURED = {"timings.parquet", "latency.json", "host.json", "cell.json"}
SUITE = """
version = 1
logs = ["car.mcap"]
pipelines = ["mine.py:Mine", "mine.py:Broken", "radar3d"]
conditions = ["clear", "loss:3", "dropout.camera:2"]
seeds = [0, 5]
"""
PACED = """
version = 1
logs = ["car.mcap"]
pipelines = ["mine.py:Paced"]
conditions = ["loss"]
severities = [1, 2, 3]
seeds = [0, 1, 2]
"""

PACED_PIPELINE = """
class Paced(Mine):
    def step(self, frame):
        time.sleep(0.1)
        return super().step(frame)
"""


def prepare(folder):
    (folder / "mine.py").write_text(MINE + PACED_PIPELINE)
    write_log(folder / "car.mcap", [*messages(8, camera=False), *truths(8)], rig(camera=False))
    (folder / "suite.toml").write_text(SUITE)
    (folder / "paced.toml").write_text(PACED)


def kept(folder):
    """What doesn't depend on times."""
    found = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in MEASURED)
    every = {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}
    if "report.html" in every:
        timing = re.compile(rb'<section id="timing">.*?</section>', re.DOTALL)
        every["report.html"] = timing.sub(b"", every["report.html"])
    return every


@pytest.mark.slow
def test_a_suite_gives_one_table_and_any_number_of_processes_the_same(fbench):
    prepare(Path())
    result = fbench("bench", "suite.toml", "--jobs", 1, "-o", "one")
    assert result.code == 4
    assert "cells: 6 of 15 (6 replayed, 0 there already, 6 unfit, 3 failed)" in result.out
    assert "won't start" in result.err
    cells = pq.read_table("one/cells.parquet")
    assert cells.column_names == [
        "log", "pipeline", "condition", "rate", "seed", "state", "reason", "key", "run",
    ]  # fmt: skip
    rows = cells.to_pylist()
    assert len(rows) == 3 * (1 + 2 * 2)
    first = rows[0]
    assert (first["log"], first["pipeline"], first["condition"], first["seed"]) == ("car", "mine-Mine", "clear", 0)
    assert (first["state"], first["reason"], first["run"]) == ("replayed", "", "runs/car/mine-Mine/clear")
    assert {row["state"] for row in rows if row["pipeline"] == "mine-Broken"} <= {"failed", "unfit"}
    scores = pq.read_table("one/scores.parquet").to_pylist()
    assert {row["pipeline"] for row in scores} == {"mine-Mine", "radar3d"}
    assert Path("one/suite.toml").read_text() == SUITE

    before = kept(Path("one"))
    again = fbench("bench", "suite.toml", "--jobs", 2, "-o", "one", "--json").json()
    assert kept(Path("one")) == before
    assert len(again["cells"]) == len(rows)
    fbench("bench", "suite.toml", "--jobs", 2, "-o", "two")
    assert kept(Path("two")) == before


@pytest.mark.slow
def test_init_writes_a_suite_that_runs(fbench):
    prepare(Path())
    made = fbench("bench", "init", "car.mcap", "-p", "mine.py:Mine", "-o", "mine.toml")
    assert (made.code, made.err) == (0, "")
    assert "suite: mine.toml (1 cells)" in made.out
    assert fbench("bench", "init", "car.mcap", "-o", "mine.toml").code == 2
    assert fbench("bench", "mine.toml", "--jobs", 1).code == 0
    assert Path("runs/mine/cells.parquet").is_file()


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("bench", "no.toml"), "no.toml: can't be read"),
        (("bench", "wrong.toml"), "wrong.toml:2: 'logs.0.path': no such log: no.mcap"),
        (("bench", "init", "no.mcap"), "no such log: no.mcap"),
        (("bench", "wrong.toml", "--jobs", "0"), "--jobs"),
    ],
)
def test_wrong_use_is_one_line_and_nothing_runs(fbench, arguments, error):
    Path("wrong.toml").write_text('version = 1\nlogs = ["no.mcap"]\npipelines = ["lidar3d"]\n')
    result = fbench(*arguments)
    assert result.code == 2
    assert error in result.err
    assert not Path("runs").exists()


@pytest.mark.parametrize(("term", "width"), [("xterm", "40"), ("xterm", "120"), ("dumb", "80")])
def test_progress_on_a_terminal_shows_failures_as_text(monkeypatch, capsys, term, width):
    for name, value in (("FORCE_COLOR", "1"), ("TERM", term), ("COLUMNS", width)):
        monkeypatch.setenv(name, value)
    cell = SimpleNamespace(pipeline="late3d", log="drive", condition="fog:3")
    progress = SuiteProgress()
    with progress.show(20):
        for number in range(4):
            failed = number == 2
            progress.note_result(cell, SimpleNamespace(state="failed" if failed else "replayed", reason="no [/b] end"))
    shown = capsys.readouterr().err
    assert all(text in shown for text in ("failed: late3d on drive", "[/b]", "4 of 20"))
    assert ("…" in shown) is False


def start(*arguments, out):
    command = [str(Path(sys.executable).parent / "fbench"), "bench", "paced.toml", "-o", out, *arguments]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def wait_for(is_true, seconds=240):
    end = time.monotonic() + seconds
    while not is_true():
        assert time.monotonic() < end
        time.sleep(0.05)


def num_cells(folder):
    """Of a suite under way: unlike `rglob`, `glob` passes over folders that are renamed meanwhile."""
    return len(glob(f"{folder}/**/cell.json", recursive=True))


@pytest.mark.slow
def test_after_sigkill_a_suite_goes_on_to_the_bytes_of_one_that_was_not_killed(fbench):
    prepare(Path())
    whole = start("--jobs", "2", out="whole")
    killed = start("--jobs", "2", out="killed")
    wait_for(lambda: num_cells("killed") >= 3)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    num_done = num_cells("killed")
    assert num_done < 9
    again = start("--jobs", "2", out="killed")
    assert (again.wait(), whole.wait()) == (0, 0)
    assert kept(Path("killed")) == kept(Path("whole"))


@pytest.mark.slow
@pytest.mark.skipif(find_spec("distributed") is None, reason="needs the extra `cluster`")
def test_a_cluster_that_loses_a_worker_gives_the_same_bytes(fbench, tmp_path):
    prepare(Path())
    dask = Path(sys.executable).parent / "dask"
    file = Path("scheduler.json").absolute()
    quiet = subprocess.DEVNULL
    scheduler = ("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file))
    worker = ("worker", "--scheduler-file", str(file), "--nthreads", "1", "--no-dashboard", "--no-nanny")
    processes = [subprocess.Popen([dask, *scheduler], stdout=quiet, stderr=quiet)]
    try:
        wait_for(file.is_file)
        for name in "ab":
            command = [dask, *worker, "--local-directory", str(tmp_path / name)]
            processes.append(subprocess.Popen(command, stdout=quiet, stderr=quiet))
        address = json.loads(file.read_text())["address"]
        suite = start("--scheduler", address, "--store", f"file://{tmp_path}/store", out="cluster")
        wait_for(lambda: num_cells("store") >= 2)
        os.kill(processes[1].pid, signal.SIGKILL)
        assert suite.wait(480) == 0
    finally:
        for process in processes:
            process.kill()
            process.wait()
    assert fbench("bench", "paced.toml", "--jobs", 2, "-o", "here").code == 0
    assert kept(Path("cluster")) == kept(Path("here"))
