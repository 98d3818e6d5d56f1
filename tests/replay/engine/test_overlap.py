"""Which frames processes get, and what waits for them; processes themselves are replaced."""

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from fbench.replay.contracts.errors import TerminatedError
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Message, PointCloud
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.data.video import VideoPicture
from fbench.replay.engine import overlap
from fbench.replay.engine.overlap import ObservedFrame, Overlap

RIG, OTHER, INFO = Rig({}, {}), Rig({}, {}), LogInfo("log", "id")


class Process:
    """Observes nothing, and keeps what it was given."""

    def __init__(self, name: str, settings: list[str]) -> None:
        self.sent: list[Frame] = []

    def await_ready(self) -> Future[ObservedFrame]:
        return done()

    def tell(self, kind: str, content: object) -> None: ...

    def observe(self, frame: Frame) -> Future[ObservedFrame]:
        self.sent.append(frame)
        return done()

    def close(self) -> None: ...


def done() -> Future[ObservedFrame]:
    future: Future[ObservedFrame] = Future()
    future.set_result(ObservedFrame())
    return future


@pytest.fixture
def single(monkeypatch: pytest.MonkeyPatch) -> Overlap:
    monkeypatch.setattr(overlap, "_Process", Process)
    return Overlap("mine", [], 1)


def sent_to(single: Overlap) -> list[Frame]:
    """Frames that its process got."""
    (process,) = single._processes
    assert isinstance(process, Process)
    return process.sent


class NoPicture:
    def frame(self, index: int) -> None:
        return None


def frame(index: int) -> Frame:
    """A cloud, and an image of a video."""
    ns = 100_000_000 * index
    film = Image("cam", ns, ns, b"x", "h264", (8, 8), video=VideoPicture(NoPicture(), index))
    messages: dict[str, Message] = {"lidar": PointCloud("lidar", ns, ns, np.zeros((1, 3), np.float32)), "cam": film}
    return Frame(index, ns, 0, messages)


def test_video_that_nobody_looks_at_keeps_no_frame_back(single: Overlap) -> None:
    found = list(single.run([(frame(0), RIG), (frame(1), RIG)], INFO, lambda rig: rig, {"lidar"}))
    assert [observed is None for _, _, observed in found] == [False, False]
    assert [list(sent.messages) for sent in sent_to(single)] == [["lidar"], ["lidar"]]


def test_video_that_is_used_is_observed_by_the_replay_itself(single: Overlap) -> None:
    found = list(single.run([(frame(0), RIG)], INFO, lambda rig: rig, None))
    assert [observed is None for _, _, observed in found] == [True]


def test_after_a_change_of_the_rig_all_is_sent(single: Overlap) -> None:
    cloud = frame(0).messages["lidar"]
    frames = [(Frame(i, i, 0, {"lidar": cloud, "other": cloud}), rig) for i, rig in enumerate((RIG, OTHER))]
    list(single.run(frames, INFO, lambda rig: rig, {"lidar"}))
    assert [sorted(sent.messages) for sent in sent_to(single)] == [["lidar"], ["lidar", "other"]]


def test_a_signal_just_after_a_process_began_leaves_no_thread_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[overlap._Process] = []

    def interrupted(process: overlap._Process) -> None:
        made.append(process)
        raise TerminatedError

    monkeypatch.setattr(overlap, "closing", interrupted)
    with pytest.raises(TerminatedError):
        Overlap("lidar3d", [], 1)
    assert [t.name for t in threading.enumerate() if t.name.startswith("fbench-overlap")] == []
    made.pop().close()


def test_what_waits_for_a_frame_doesnt_grow_with_the_log() -> None:
    class Wire:
        num = 0

        def send(self, orders: list[object]) -> None:
            self.num += len(orders)

    process, wire = overlap._Process.__new__(overlap._Process), Wire()
    connection: Any = wire
    process._orders, process._thread, process._connection = [], ThreadPoolExecutor(1), connection
    for i in range(1000):
        process.tell("pass_by", i)
    assert len(process._orders) <= 100
    process._thread.shutdown()
    assert wire.num + len(process._orders) == 1000
