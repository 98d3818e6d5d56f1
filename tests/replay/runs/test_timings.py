"""Times of stages: what the clock measures, and what the table of a run gives back."""

import sys
import time
from types import ModuleType

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from fbench.replay.contracts.errors import RunError
from fbench.replay.contracts.params import StageClock
from fbench.replay.runs.timings import Timings, TimingsWriter


def write(path):
    writer = TimingsWriter()
    writer.add(0, {"track": 5, "total": 9}, compiled=True, cpu_ns={"total": 4})
    writer.add(0, {"wait": 30}, "log", outside=True)
    writer.add(3, {"track": 6, "total": 8})
    writer.write(path)
    return Timings(path)


def test_times_by_stage_and_frame(tmp_path):
    found = write(tmp_path / "timings.parquet")
    assert found.stages == {"track": {0: 5, 3: 6}, "total": {0: 9, 3: 8}}
    assert found.cpu == {"total": {0: 4}}
    assert found.outside == {"wait": {0: 30}}
    assert found.compiled_frames == {0}
    assert found.clock == "host"  # how long a frame waited is log time, but no time of a stage


def test_tables_of_before_there_were_cpu_times(tmp_path):
    path = tmp_path / "timings.parquet"
    write(path)
    rows = pq.read_table(path)
    pq.write_table(rows.filter(~rows["outside"].to_numpy()).drop_columns(["outside", "cpu_ns"]), path)
    found = Timings(path)
    assert found.stages == {"track": {0: 5, 3: 6}, "total": {0: 9, 3: 8}}
    assert found.cpu == found.outside == {}


@pytest.mark.parametrize("name", ["frame", "stage", "ns", "clock"])
def test_tables_of_anything_else_are_refused_in_a_line(tmp_path, name):
    path = tmp_path / "timings.parquet"
    write(path)
    rows = pq.read_table(path)
    for wrong in (rows.drop_columns([name]), rows.append_column(name, rows[name]),
                  rows.set_column(0, name, pa.nulls(rows.num_rows, pa.float64()))):  # fmt: skip
        pq.write_table(wrong, path)
        for own in ("stages", "cpu", "outside", "clock", "compiled_frames"):
            with pytest.raises(RunError, match=r"timings\.parquet: can't be read \(not a table of times\)$"):
                getattr(Timings(path), own)


def test_cpu_time_of_a_stage_leaves_out_what_waits():
    clock = StageClock()
    with clock.stage("read"):
        time.sleep(0.02)
    assert clock.stage_ns["read"] >= 20_000_000 > clock.cpu_ns["read"] >= 0
    both = StageClock()
    both.include(clock)
    both.include(clock)
    assert both.stage_ns["read"] == 2 * clock.stage_ns["read"]
    assert both.cpu_ns["read"] == 2 * clock.cpu_ns["read"]


def test_a_stage_ends_when_cuda_is_done(monkeypatch):
    cuda, waits = ModuleType("torch.cuda"), []
    monkeypatch.setitem(cuda.__dict__, "synchronize", lambda: waits.append("waited"))
    for is_used in (False, True):
        monkeypatch.setitem(cuda.__dict__, "is_initialized", lambda is_used=is_used: is_used)
        monkeypatch.setitem(sys.modules, "torch.cuda", cuda)
        with StageClock().stage("detect"):
            assert waits == []
        assert waits == ["waited"] * is_used
