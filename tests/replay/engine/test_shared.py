"""Messages that several replays share: each gives what it would give alone."""

from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.conftest import messages, rig, truths, write_log

from fbench.api.replays import replay
from fbench.replay.engine.shared import SharedLogs
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

PIPELINES = """
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Mean:
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame):
        cloud = frame.messages.get("lidar")
        if cloud is None:
            return Output(Boxes3D.empty(), Boxes3D.empty(), {})
        center = np.asarray(cloud.xyz, np.float64).mean(axis=0, keepdims=True)
        boxes = Boxes3D(center, np.ones((1, 3)), np.zeros(1), label=np.array(["car"]))
        return Output(boxes, Boxes3D.empty(), {})

class GivesUp(Mean):
    def step(self, frame):
        raise KeyError("no")
"""
MEASURED = ("timings.parquet", "latency.json", "host.json")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shared")
    (folder / "mine.py").write_text(PIPELINES)
    return write_log(folder / "car.mcap", [*messages(12, camera=False), *truths(12)], rig(camera=False))


def request(log, out, **fields):
    given = LogRequest(log, config=NO_CONFIG)
    return ReplayRequest(given, f"{log.parent}/mine.py:Mean", out=Path(out), no_media=True, **fields)


def contents(folder):
    return {file.name: file.read_bytes() for file in sorted(Path(folder).iterdir()) if file.name not in MEASURED}


@pytest.mark.parametrize("condition", ["", "loss:3+lidar.jitter:2", "delay.lidar:2"])
@pytest.mark.parametrize(("max_bytes", "num_shared"), [(1 << 20, 2), (50_000, 0), (0, 0)])
def test_replays_that_share_give_the_bytes_of_those_that_do_not(log, tmp_path, condition, max_bytes, num_shared):
    alone = request(log, tmp_path / "alone", condition=condition, seed=4)
    replay(alone)
    with SharedLogs(max_bytes) as shared:
        for number in range(3):
            replay(replace(alone, out=tmp_path / f"shared-{number}"), shared=shared)
            assert contents(tmp_path / f"shared-{number}") == contents(tmp_path / "alone")
        assert shared.num_shared == num_shared
    assert Run(tmp_path / "alone").manifest.num_frames == 12


def test_other_conditions_and_seeds_share_nothing(log, tmp_path):
    with SharedLogs(1 << 30) as shared:
        digests = set()
        for number, (condition, seed) in enumerate([("loss:4", 1), ("loss:4", 2), ("", 2), ("loss:4", 1)]):
            run = replay(request(log, tmp_path / str(number), condition=condition, seed=seed), shared=shared)
            digests.add(run.run.manifest.digest)
        assert (shared.num_shared, len(digests)) == (0, 3)


def test_who_stops_early_leaves_the_rest_to_the_next(log, tmp_path):
    replay(request(log, tmp_path / "alone"))
    with SharedLogs(1 << 30) as shared:
        part = replay(request(log, tmp_path / "part", frames="2:4"), shared=shared)
        assert part.run.manifest.num_frames == 2
        broken = replace(request(log, tmp_path / "broken"), pipeline=f"{log.parent}/mine.py:GivesUp")
        with pytest.raises(Exception, match="failed on 10 frames in a row"):
            replay(broken, shared=shared)
        replay(request(log, tmp_path / "whole"), shared=shared)
        assert shared.num_shared == 2
    assert contents(tmp_path / "whole") == contents(tmp_path / "alone")
