"""Branches of a frame, on threads of their own or not."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from threading import Barrier, Event, current_thread, main_thread

import pytest
from tests.pipelines.frames import JPEG, cloud, frame, image, rig, scan

from fbench.pipelines.sensors.camera.detector import CameraParams
from fbench.pipelines.sensors.parallel import Branches
from fbench.pipelines.variants.late import Late3D, Late3DParams
from fbench.replay.contracts.params import StageClock
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo
from fbench.replay.geometry.threads import VARIABLE
from fbench.replay.runs.digest import digest

PATIENCE_S = 60.0


def staged(name: str, value: int, wait: Callable[[], object] = lambda: None) -> Callable[[StageClock], int]:
    def branch(clock: StageClock) -> int:
        with clock.stage(name):
            wait()
        with clock.stage("all"):
            return value

    return branch


@pytest.mark.parametrize("threads", [1, 2, 3, 8])
def test_results_and_stages_have_the_order_of_branches(threads: int):
    clock, last_is_done = StageClock(), Event()
    # The first ends last, where there is another thread for the others.
    first = staged("first", 1, lambda: last_is_done.wait(PATIENCE_S if threads > 1 else 0))
    found = Branches(threads).run(clock, first, staged("second", 2), staged("third", 3, last_is_done.set))
    assert found == (1, 2, 3)
    assert list(clock.stage_ns) == ["first", "all", "second", "third"]


def test_branches_run_at_the_same_time():
    both = Barrier(2)
    found = Branches(2).run(StageClock(), *(staged(name, 1, lambda: both.wait(PATIENCE_S)) for name in "ab"))
    assert found == (1, 1)


def test_one_thread_is_the_calling_one():
    seen = list[object]()
    branches = Branches(1)
    branches.run(StageClock(), *(staged(name, 1, lambda: seen.append(current_thread())) for name in "abc"))
    assert seen == [current_thread()] * 3


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_of_several_errors_that_of_the_first_branch_counts_and_all_branches_run(threads: int):
    ran = list[str]()

    def failing(name: str) -> Callable[[StageClock], None]:
        def branch(clock: StageClock) -> None:
            ran.append(name)
            raise ValueError(name)

        return branch

    branches = Branches(threads)
    for _ in range(20):
        with pytest.raises(ValueError, match=r"^b$"):
            branches.run(StageClock(), staged("a", 1), failing("b"), failing("c"))
    assert sorted(ran) == ["b"] * 20 + ["c"] * 20
    assert branches.run(StageClock(), staged("a", 1), staged("b", 2)) == (1, 2)


def test_an_interrupt_leaves_nothing_running():
    began, ended = list[str](), list[str]()
    both = Barrier(2)

    def branch(clock: StageClock) -> None:
        both.wait(PATIENCE_S)
        if current_thread() is main_thread():
            raise KeyboardInterrupt
        began.append("other")
        time.sleep(0.2)
        ended.append("other")

    with pytest.raises(KeyboardInterrupt):
        Branches(2).run(StageClock(), branch, branch)
    assert began == ended == ["other"]


def test_threads_end_with_what_owns_them():
    before, branches = set(threading.enumerate()), Branches(3)
    branches.run(StageClock(), *(staged(name, 1) for name in "abc"))
    own = set(threading.enumerate()) - before
    assert 1 <= len(own) <= 2
    del branches
    for thread in own:
        thread.join(PATIENCE_S)
    assert not any(thread.is_alive() for thread in own)


ENDLESS = """
import time
from fbench.pipelines.sensors.parallel import Branches
from fbench.replay.contracts.params import StageClock
branches, clock = Branches(3), StageClock()
branch = lambda clock: time.sleep(0.01)
branches.run(clock, branch, branch, branch)
print("runs", flush=True)
while LOOP:
    branches.run(clock, branch, branch, branch)
"""


@pytest.mark.slow
def test_a_process_with_threads_ends():
    done = subprocess.run([sys.executable, "-c", ENDLESS.replace("LOOP", "False")], timeout=PATIENCE_S, check=False)
    assert done.returncode == 0


@pytest.mark.slow
def test_a_process_is_interrupted_while_branches_run():
    process = subprocess.Popen(
        [sys.executable, "-c", ENDLESS.replace("LOOP", "True")], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == b"runs\n"
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode != 0
    assert err.rstrip().endswith(b"KeyboardInterrupt")


def outputs(threads: int, weights: Path, monkeypatch: pytest.MonkeyPatch) -> list[Output]:
    monkeypatch.setenv(VARIABLE, str(threads))
    pipeline = Late3D(Late3DParams(camera=CameraParams(weights=weights)))
    pipeline.start(rig("cam", "lidar", "radar"), LogInfo("drive", "id"))
    return [pipeline.step(f) for f in drive()]


def drive() -> list[Frame]:
    return [
        frame(0, image(), cloud(), scan()),
        frame(1, image(JPEG[:100]), cloud(), scan()),
        frame(2, cloud()),
        frame(3, image(), scan()),
        frame(4),
        frame(5, image(), cloud(), scan()),
    ]


def test_late3d_finds_the_same_side_by_side(one_car: Path, monkeypatch: pytest.MonkeyPatch):
    alone, *others = [outputs(threads, one_car, monkeypatch) for threads in (1, 2, 3)]
    for found in others:
        for a, b in zip(alone, found, strict=True):
            assert digest([a.detections, a.tracks]) == digest([b.detections, b.tracks])
            assert (a.faults, a.missing, list(a.stage_ns)) == (b.faults, b.missing, list(b.stage_ns))
