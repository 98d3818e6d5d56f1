"""Frames in which code was compiled, or loaded, are known as such; runs are the same without that."""

import hashlib
import importlib.util
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from tests.replay.fakes import Echo, drive

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.engine.warm_up import WarmUp
from fbench.replay.runs.folder import Run

SOURCE = """
import numpy as np
from fbench.replay.geometry.kernels import kernel

@kernel
def add_up(values):
    total = values[0]
    for value in values[1:]:
        total += value
    return total
"""


def load_kernel(folder: Path, name: str):
    """A kernel with its own machine code, in a module of its own."""
    (folder / f"{name}.py").write_text(SOURCE)
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module.add_up


class Summing(Echo):
    """Calls a kernel with a new type of numbers in frames 3 and 12, the second time in another thread."""

    def __init__(self, add_up):
        super().__init__()
        self._add_up = add_up

    def step(self, frame):
        if 3 <= frame.index < 12:
            self._add_up(np.ones(3))
        elif frame.index >= 12:
            with ThreadPoolExecutor(1) as pool:
                pool.submit(self._add_up, np.ones(3, np.int64)).result()
        return super().step(frame)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path


def play(pipeline, folder: Path) -> Run:
    return Run(replay(drive(), Plan(pipeline, "echo"), folder, FaultLog()))


def test_frames_that_compile_or_load_a_kernel_are_marked(cache):
    compiling = play(Summing(load_kernel(cache, "made_first")), cache / "compiling")
    assert compiling.compiled_frames == {3, 12}
    loading = play(Summing(load_kernel(cache, "made_again")), cache / "loading")  # a new process would do the same
    assert loading.compiled_frames == {3, 12}
    again = play(Summing(sys.modules["made_again"].add_up), cache / "again")
    assert again.compiled_frames == frozenset()
    for name in ("frames.parquet", "detections.parquet", "manifest.json"):
        digests = {hashlib.sha256((run.folder / name).read_bytes()).hexdigest() for run in (compiling, loading, again)}
        assert len(digests) == 1


def test_nobody_listens_after_the_run(cache):
    watch = WarmUp()
    add_up = load_kernel(cache, "made_third")
    before = watch.count()
    add_up(np.ones(2))
    assert watch.count() > before
    watch.close()
    num = watch.count()
    add_up(np.ones(2, np.int16))
    assert watch.count() == num
