"""Reading ahead changes nothing but the time it takes."""

import threading
import time
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import pytest
from tests.replay.engine.test_run import content
from tests.replay.fakes import MS, Echo, FakeLog, cloud, drive

import fbench.replay.engine.read_ahead as module
from fbench.replay.contracts.errors import ConfigError, LogError, TerminatedError
from fbench.replay.contracts.faults import FaultBudget, FaultLog
from fbench.replay.data.messages import PointCloud
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.engine.read_ahead import DEFAULT, make_limit, open_ahead

LIMITS = [0, 1, 3, 64, None]


def threads():
    return [t for t in threading.enumerate() if t.name == "fbench-read-ahead"]


@pytest.fixture(autouse=True)
def no_thread_stays():
    yield
    assert threads() == []


@dataclass
class Broken(FakeLog):
    """Counts a fault at every fifth message, in both passes, and may fail."""

    faults: FaultLog = field(default_factory=FaultLog)
    fails_at: int | None = None
    taken: int = 0

    def messages(self):
        for i, message in enumerate(super().messages()):
            self.taken += 1
            if i == self.fails_at:
                raise LogError("disk is gone")
            if i % 5 == 0:
                self.faults.once("LOG004", ("fake", i), f"message {i}")
            yield message

    def truths(self):
        self.faults.once("LOG004", ("fake", 30), "message 30")
        yield from super().truths()


def broken(faults, **more):
    log = drive(40)
    return Broken(log.items, log.labels, faults=faults, **more)


def play(folder, limit, faults, pipeline=None, excerpt=None, **more):
    plan = Plan(pipeline or Echo(), "echo", excerpt=excerpt or Excerpt(), budget=FaultBudget(None))
    with open_ahead(partial(broken, **more), faults, limit) as reader:
        replay(reader, plan, folder, faults)


@pytest.mark.parametrize("excerpt", [Excerpt(), Excerpt(2, 7), Excerpt(12, 13), Excerpt(39)])
def test_any_limit_gives_the_same_run_with_the_same_faults(tmp_path, excerpt):
    runs = []
    for i, limit in enumerate(LIMITS):
        faults = FaultLog()
        play(tmp_path / f"r{i}", limit, faults, excerpt=excerpt)
        runs.append((content(tmp_path / f"r{i}"), faults.counts, faults.places))
    assert all(run == runs[0] for run in runs)


class Fails(Echo):
    def step(self, frame):
        raise LogError("no good")


@pytest.mark.parametrize("limit", LIMITS)
def test_failing_pipeline_ends_the_thread(tmp_path, limit):
    with pytest.raises(Exception, match="failed on 10 frames in a row"):
        play(tmp_path / "run", limit, FaultLog(), Fails())
    assert threads() == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("has_started", [True, False])
def test_a_signal_that_comes_while_the_thread_starts_ends_it(tmp_path, monkeypatch, has_started):
    start, begun = threading.Thread.start, []

    def interrupted(thread):
        begun.append(thread)
        if has_started:
            start(thread)
        raise TerminatedError

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", interrupted)
        with pytest.raises(TerminatedError):
            play(tmp_path / "run", 1, FaultLog())
    assert [thread.is_alive() for thread in begun] == [False]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("limit", LIMITS)
def test_error_surfaces_where_its_message_is_wanted(tmp_path, limit):
    pipeline, faults = Echo(), FaultLog()
    with pytest.raises(LogError, match="disk is gone"):
        play(tmp_path / "run", limit, faults, pipeline, fails_at=30)
    assert pipeline.age == 15
    assert faults.counts["LOG004"] == 6


def test_no_more_than_the_limit_waits():
    logs = []

    def opened(faults):
        logs.append(broken(faults))
        return logs[0]

    with open_ahead(opened, FaultLog(), 5) as reader:
        messages = reader.messages()
        next(messages)
        time.sleep(0.1)
        assert logs[0].taken <= 7  # one delivered, five wait, one in hand
    assert list(messages) == []


def test_bytes_are_bounded_too(monkeypatch):
    monkeypatch.setattr(module, "MAX_BYTES", 1000)
    made = []

    class Clouds(FakeLog):
        def messages(self):
            for i in range(20):
                made.append(i)
                yield PointCloud("lidar", i, i, np.zeros((40, 3), np.float32))

    with open_ahead(lambda faults: Clouds([cloud(0)]), FaultLog(), None) as reader:
        messages = reader.messages()
        next(messages)
        time.sleep(0.1)
        assert len(made) <= 4  # two of 480 bytes fit
        assert len(list(messages)) == 19


def test_messages_can_be_read_again():
    with open_ahead(broken, FaultLog(), 4) as reader:
        first, second = list(reader.messages()), list(reader.messages())
    assert len(first) == 80
    assert first == second


def test_faults_of_opening_are_counted_even_where_it_fails():
    def opened(faults):
        faults.add("LOG002", "here")
        raise LogError("not a log")

    faults = FaultLog()
    with pytest.raises(LogError, match="not a log"), open_ahead(opened, faults, 4):
        pass
    assert faults.counts["LOG002"] == 1


def test_options():
    assert [make_limit(text) for text in ("0", "12", "all", "auto")] == [0, 12, None, DEFAULT]


@pytest.mark.parametrize("text", ["-1", "some", "", "1.5", "٣"])
def test_bad_options_are_usage_errors(text):
    with pytest.raises(ConfigError, match=f"--read-ahead {text}: expected a number of messages, 'all' or 'auto'"):
        make_limit(text)


@pytest.mark.parametrize("limit", [0, 8])
def test_the_log_is_read_while_the_pipeline_works(limit):
    is_ahead = threading.Event()

    class Watched(FakeLog):
        def messages(self):
            for number, message in enumerate(super().messages()):
                if number == 5:
                    is_ahead.set()
                yield message

    with open_ahead(lambda faults: Watched([cloud(100 * MS * i) for i in range(40)]), FaultLog(), limit) as reader:
        messages = reader.messages()
        next(messages)
        assert is_ahead.wait(60.0 if limit else 0.0) == (limit > 0)
        assert len(list(messages)) == 39
