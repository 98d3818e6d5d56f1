"""Cells through processes that replay, told apart by what they are made of."""

import errno
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.conftest import messages, rig, truths, write_log

from fbench.api.scores import score_folder
from fbench.api.suites.cells import folder_of, seal_run
from fbench.api.suites.contents import Contents
from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.rig import Rig
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

MEASURED = {"timings.parquet", "latency.json", "host.json", "cell.json"}
MINE = """
import time
from dataclasses import dataclass
from pathlib import Path
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Mine:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        return Output(Boxes3D.empty(), Boxes3D.empty(), {})

class Broken(Mine):
    def start(self, rig, log_info): raise RuntimeError("won't start")

class Dies(Mine):
    def step(self, frame):
        import os
        os.kill(os.getpid(), 9)

class Talks(Mine):
    def step(self, frame):
        import os
        os.write(1, b"hello\\n")
        os.system("echo hello")
        print("hello", flush=True)
        return super().step(frame)

class WarnsAndDies(Dies):
    def step(self, frame):
        import os
        os.write(2, b"low on tape\\n")
        super().step(frame)

class Warns(Mine):
    def step(self, frame):
        import os
        os.write(2, b"low on tape\\n")
        return super().step(frame)

@dataclass(frozen=True)
class Params:
    where: Path = Path("x")
    def __post_init__(self):
        raise KeyError("won't do")

class Choosy(Mine):
    def __init__(self, params: Params): pass

class Slow(Mine):
    def step(self, frame):
        import os, pathlib
        pathlib.Path("at-work").write_text(str(os.getpid()))
        time.sleep(60)
"""


@pytest.fixture
def log(tmp_path, monkeypatch):
    """Three frames, without a camera; the working folder is empty but for `mine.py`."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MINE)
    return write_log(tmp_path / "car.mcap", [*messages(3, camera=False), *truths(3)], rig(camera=False))


def cell(log, pipeline, **fields):
    folder = Path("runs") / pipeline.replace(":", "-")
    return ReplayRequest(
        LogRequest(log, config=NO_CONFIG),
        pipeline,
        out=fields.pop("folder", folder),
        overwrite=True,
        no_media=True,
        **fields,
    )


def states(results):
    return [result.state for result in results]


def contents(folder):
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir()) if file.name not in MEASURED}


@pytest.mark.slow
def test_any_number_of_workers_gives_equal_runs_in_the_order_of_cells(log):
    found = {}
    for workers in (1, 2):
        names = ["radar3d", "lidar3d", "mine.py:Mine"]
        cells = [cell(log, name, folder=Path(f"by-{workers}") / name) for name in names]
        results = run_suite(cells, RunOptions(workers))
        assert [result.cell for result in results] == cells
        assert states(results) == ["replayed"] * 3
        found[workers] = [contents(folder_of(one)) for one in cells]
        assert Run(folder_of(cells[1])).scores
    assert found[1] == found[2]


@pytest.mark.slow
def test_only_what_changed_is_replayed(log):
    cells = [cell(log, "radar3d"), cell(log, "mine.py:Mine")]
    told = []
    assert states(run_suite(cells, RunOptions(1), lambda done, of: told.append((done, of)))) == ["replayed", "replayed"]
    assert told == [(0, 2), (1, 2), (2, 2)]
    assert states(run_suite(cells, RunOptions(1))) == ["there", "there"]

    changed = [replace(cells[0], settings=["radar.max_range_m=50"]), cells[1]]
    assert states(run_suite(changed, RunOptions(1))) == ["replayed", "there"]
    options = [changed[0], replace(cells[1], scoring=ScoreOptions(range_m=40))]
    assert states(run_suite(options, RunOptions(1))) == ["there", "replayed"]
    Path("mine.py").write_text(MINE + "\n")
    assert states(run_suite(options, RunOptions(1))) == ["there", "replayed"]

    write_log(log, [*messages(2, camera=False), *truths(2)], rig(camera=False))
    assert states(run_suite(options, RunOptions(1))) == ["replayed", "replayed"]
    assert len(Run(folder_of(cells[0])).frames) == 2


@pytest.mark.slow
def test_what_is_damaged_or_missing_is_made_anew(log):
    names = ["scores.json", "manifest.json", "frames.parquet", "cell.json", "tracks.parquet", "untouched"]
    cells = [cell(log, "mine.py:Mine", folder=Path("runs") / name) for name in names]
    run_suite(cells, RunOptions(1))
    whole = contents(folder_of(cells[0]))
    for name in names[:4]:
        (Path("runs") / name / name).write_text("{")
    (Path("runs") / "tracks.parquet" / "tracks.parquet").unlink()
    left = Path("runs") / ".scores.json.partial"  # of a process that was killed
    left.mkdir()
    assert states(run_suite(cells, RunOptions(1))) == ["replayed"] * 5 + ["there"]
    assert all(contents(folder_of(one)) == whole for one in cells)
    assert not left.exists()
    assert states(run_suite(cells, RunOptions(1))) == ["there"] * 6


@pytest.mark.slow
@pytest.mark.parametrize("state", ["replayed", "there"])
def test_a_run_that_somebody_scores_otherwise_meanwhile_fails_and_is_made_anew(log, state):
    """Else the suite's tables would hold numbers by different rules, and nobody would know."""
    cells = [cell(log, "mine.py:Mine"), cell(log, "mine.py:Mine", folder=Path("runs/other"))]
    if state == "there":
        run_suite(cells, RunOptions(1))

    def score_otherwise(done, of):
        if done == of:
            score_folder(folder_of(cells[0]), ScoreOptions(range_m=20))

    scored, other = run_suite(cells, RunOptions(1), score_otherwise)
    assert (scored.state, other.state) == ("failed", state)
    assert scored.reason == "runs/mine.py-Mine was changed meanwhile; the same command redoes it"
    assert states(run_suite(cells, RunOptions(1))) == ["replayed", "there"]
    assert Path("runs/mine.py-Mine/scores.json").read_bytes() == Path("runs/other/scores.json").read_bytes()


@pytest.mark.slow
def test_cells_that_fail_say_why_and_stop_nobody(log):
    (Path("runs") / "taken").mkdir(parents=True)
    Path("runs/taken/mine.txt").write_text("not a run")
    bad_log = Path("bad.mcap")
    bad_log.write_bytes(b"no log")
    cells = [
        cell(log, "mine.py:Broken"),
        cell(log, "mine.py:Dies"),
        cell(log, "mine.py:Choosy"),
        cell(log, "lidar4d"),
        cell(log, "radar3d", settings=["radar.no=1"], folder=Path("x")),
        cell(log, "mine.py:Mine", folder=Path("runs/taken")),
        cell(bad_log, "mine.py:Mine", folder=Path("y")),
        cell(Path("absent.mcap"), "mine.py:Mine", folder=Path("z")),
        cell(log, "mine.py:Mine"),
    ]
    results = run_suite(cells, RunOptions(1))
    assert states(results) == ["failed"] * 8 + ["replayed"]
    expected = ["won't start", "signal 9", "KeyError", "unknown pipeline", "unknown parameter",
                "isn't a run folder", "bad.mcap", "absent.mcap"]  # fmt: skip
    for result, reason in zip(results, expected, strict=False):
        assert reason in result.reason
        assert "\n" not in result.reason
    assert Path("runs/taken/mine.txt").read_text() == "not a run"
    assert not list(Path().rglob("*.partial*"))


@pytest.mark.slow
def test_a_log_without_the_sensor_is_unfit_and_programs_run_each_time(log):
    without = Rig({"lidar": rig(camera=False).mounts["lidar"]}, {})
    items = [message for message in messages(2, camera=False) if message.sensor == "lidar"]
    only_lidar = write_log(Path("lidar.mcap"), items, without)
    program = cell(log, "exec:./no-such-program", folder=Path("program"))
    unfit, failed = run_suite([cell(only_lidar, "radar3d"), program], RunOptions(1))
    assert (unfit.state, failed.state) == ("unfit", "failed")
    assert "radar3d needs a radar" in unfit.reason


@pytest.mark.slow
def test_what_libraries_print_gets_into_no_answer(log):
    results = run_suite([cell(log, "mine.py:Talks"), cell(log, "mine.py:Mine")], RunOptions(1))
    assert [(result.state, result.reason) for result in results] == [("replayed", None)] * 2


@pytest.mark.slow
def test_a_process_that_dies_quotes_nothing_that_another_cell_said(log):
    warned, died = run_suite([cell(log, "mine.py:Warns"), cell(log, "mine.py:Dies")], RunOptions(1))
    assert (warned.state, died.state) == ("replayed", "failed")
    assert died.reason == "its process ended with signal 9"
    (last,) = run_suite([cell(log, "mine.py:WarnsAndDies")], RunOptions(1))
    assert last.reason == "its process ended with signal 9: low on tape"


@pytest.mark.slow
def test_a_run_that_cannot_be_sealed_fails_alone(log, monkeypatch):
    def seal(folder, key, content):
        if folder.name == "full":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        seal_run(folder, key, content)

    cells = [cell(log, "mine.py:Mine", folder=Path("runs") / name) for name in ("full", "other")]
    with monkeypatch.context() as patch:
        patch.setattr("fbench.api.suites.runner.seal_run", seal)
        full, other = run_suite(cells, RunOptions(1))
    assert (full.state, full.reason) == ("failed", "runs/full: can't be made (No space left on device)")
    assert other.state == "replayed"
    assert states(run_suite(cells[:1], RunOptions(1))) == ["replayed"]


@pytest.mark.slow
def test_code_counts_but_not_what_python_compiles_of_it(log, tmp_path, monkeypatch):
    package = tmp_path / "suites_code"
    (package / "__pycache__").mkdir(parents=True)
    (package / "__init__.py").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("fbench.api.suites.contents._PACKAGES", ("suites_code",))
    one = [cell(log, "mine.py:Mine")]
    assert states(run_suite(one, RunOptions(1))) == ["replayed"]
    (package / "__pycache__" / "a.cpython-311.pyc.140012345").write_text("half")
    assert states(run_suite(one, RunOptions(1))) == ["there"]
    (package / "weights.onnx").write_text("others")
    assert states(run_suite(one, RunOptions(1))) == ["replayed"]


def test_all_code_of_a_package_with_a_pipeline_counts(log, tmp_path, monkeypatch):
    package, told = tmp_path / "outsider", tmp_path / "outsider-1.0.dist-info"
    for folder in (package, told):
        folder.mkdir()
    (package / "__init__.py").write_text("")
    (package / "part.py").write_text("")
    (package / "pipe.py").write_text(MINE)
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: outsider\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text("[fbench.pipelines]\noutsider = outsider.pipe:Mine\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("fbench.api.suites.contents._PACKAGES", ())
    one = cell(log, "outsider")
    before = Contents().of(one)
    assert Contents().of(one) == before
    (package / "part.py").write_text("CHANGED = 1")
    assert Contents().of(one) != before


def test_wrong_suites(log):
    with pytest.raises(ConfigError, match="--jobs 0"):
        run_suite([], RunOptions(0))
    one = cell(log, "radar3d")
    with pytest.raises(ConfigError, match="two cells of a suite go to"):
        run_suite([one, replace(one, out=folder_of(one).absolute())], RunOptions(1))


def test_no_cells_give_nothing():
    assert run_suite([], RunOptions(2)) == []


INTERRUPTED = """
import sys
from pathlib import Path
from fbench.replay.setup.source import NO_CONFIG, LogRequest
from fbench.replay.setup.request import ReplayRequest
from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions

log = LogRequest(Path(sys.argv[1]), config=NO_CONFIG)
names = ("mine.py:Mine", "mine.py:Slow", "mine.py:Broken")
cells = [ReplayRequest(log, name, out=Path("runs") / name[8:], overwrite=True, no_media=True) for name in names]
try:
    run_suite(cells, RunOptions(1))
except KeyboardInterrupt:
    sys.exit(130)
"""


@pytest.mark.slow
def test_interrupted_nothing_half_written_stays_and_no_process(log):
    process = subprocess.Popen([sys.executable, "-c", INTERRUPTED, str(log)])
    marker = Path("at-work")
    end = time.monotonic() + 600
    while not (marker.exists() and marker.read_text()) and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(300) == 130
    worker = int(marker.read_text())
    with pytest.raises(ProcessLookupError):
        os.kill(worker, 0)
    assert sorted(path.name for path in Path("runs").iterdir()) == ["Mine"]
    seal = json.loads(Path("runs/Mine/cell.json").read_text())
    assert seal["made_from"]["pipeline"] == "mine.py:Mine"
