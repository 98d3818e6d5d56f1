"""Pipelines that raise what they like, change limits of Python, or fill the same buffers again."""

import re
import sys
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from tests.replay.engine.test_run import play
from tests.replay.fakes import RIG, Echo, drive

from fbench.replay.contracts.errors import DataError, TerminatedError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output
from fbench.replay.engine.cleaning import OutputCheck


class NoTextError(Exception):
    def __str__(self):
        raise ValueError("no text")


class Own(BaseException):
    """No Exception, as those of some test frameworks."""


WAYS_OUT = {
    "GeneratorExit": (GeneratorExit(), "GeneratorExit: no message"),
    "SystemExit": (SystemExit(0), "SystemExit: 0"),
    "BaseException": (Own("mine"), "Own: mine"),
    "no text": (NoTextError(), "NoTextError: its text can't be made (ValueError)"),
    "control characters": (ValueError("\x1b[2Jgone"), "ValueError:  [2Jgone"),
    "long text": (ValueError("x" * 10**6), f"ValueError: {'x' * 600} ... {'x' * 600}"),
}


@pytest.mark.parametrize(("error", "text"), WAYS_OUT.values(), ids=WAYS_OUT.keys())
def test_whatever_a_pipeline_raises_is_the_failure_of_its_frame(tmp_path, error, text):
    class Leaving(Echo):
        def step(self, frame):
            if frame.index == 3:
                raise error
            return super().step(frame)

    run = play(drive(), tmp_path / "run", Leaving())
    assert [frame.index for frame in run.frames if frame.failed] == [3]
    assert run.frames[3].failed.startswith(text)
    assert re.search(r" \(test_unruly_pipelines\.py:\d+\)$", run.frames[3].failed)


@pytest.mark.parametrize("error", [KeyboardInterrupt, TerminatedError])
def test_interrupts_end_the_replay(tmp_path, error):
    class Interrupted(Echo):
        def step(self, frame):
            raise error

    with pytest.raises(error):
        play(drive(), tmp_path / "run", Interrupted())
    assert not list(tmp_path.iterdir())


def test_a_recursion_limit_that_a_pipeline_changes_is_its_own(tmp_path):
    limit = sys.getrecursionlimit()

    class Shallow(Echo):
        def step(self, frame):
            sys.setrecursionlimit(100)
            return super().step(frame)

    run = play(drive(), tmp_path / "run", Shallow())
    assert sys.getrecursionlimit() == limit
    assert len(run.frames) == 20


class Reusing(Echo):
    """Fills one buffer in every step and returns views of it, as bindings of C++ programs do."""

    def __init__(self):
        super().__init__()
        self.center, self.yaw = np.zeros((1, 3)), np.zeros(1)

    def step(self, frame):
        self.center[:] = frame.index
        boxes = Boxes3D(self.center, np.ones((1, 3)), self.yaw)
        return Output(boxes, boxes, {})


def test_buffers_that_a_pipeline_fills_again_stay_as_they_were(tmp_path):
    run = play(drive(), tmp_path / "run", Reusing())
    assert [run.detections.at(i).center_m[0, 0] for i in range(20)] == list(range(20))
    assert [run.tracks.at(i).center_m[0, 0] for i in range(20)] == list(range(20))


class Wordy:
    def __repr__(self):
        return "x" * 10**8


@pytest.mark.parametrize(
    "spoil", [{"stage_ns": {"a": Wordy()}}, {"missing": {"a": Wordy()}}, {"faults": (Wordy(),)}, {"clock": Wordy()}]
)
def test_a_huge_text_of_a_wrong_value_is_cut_before_it_is_copied(spoil):
    boxes = Boxes3D.empty()
    output = replace(Output(boxes, boxes, {}), **spoil)
    check = OutputCheck(RIG)
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match=r"x{100} \.\.\."):
            check(output)
        assert tracemalloc.get_traced_memory()[1] < 1.5e8  # the text itself, and no copy of it
    finally:
        tracemalloc.stop()
