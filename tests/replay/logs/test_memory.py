"""Memory does not grow with the length of a log."""

import tracemalloc

import numpy as np
import pytest
from tests.replay.logs import builders as b

from fbench.replay.data.messages import PointCloud

POINTS = 20_000


@pytest.fixture(scope="module")
def long_log(tmp_path_factory):
    """About 24 MB in about 100 chunks."""
    rng = np.random.Generator(np.random.Philox(0))
    clouds = (PointCloud("top", i, i, rng.normal(size=(POINTS, 3)).astype(np.float32)) for i in range(100))
    return b.write(tmp_path_factory.mktemp("log") / "log.mcap", clouds, compression="none", chunk_size=100_000)


def peak(action):
    tracemalloc.start()
    action()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


def test_reading_holds_few_chunks(long_log):
    def replay():
        reader, _ = b.read(long_log)
        assert sum(1 for _ in reader.messages()) == 100

    assert long_log.stat().st_size > 24_000_000
    assert peak(replay) < 4_000_000


def test_reading_without_an_index_holds_few_chunks(long_log, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(long_log.read_bytes()[:-1])

    def replay():
        reader, _ = b.read(cut)
        assert sum(1 for _ in reader.messages()) == 100

    assert peak(replay) < 4_000_000


def test_writing_holds_one_chunk(tmp_path):
    xyz = np.zeros((POINTS, 3), np.float32)
    clouds = (PointCloud("top", i, i, xyz) for i in range(100))
    assert peak(lambda: b.write(tmp_path / "log.mcap", clouds, compression="none", chunk_size=100_000)) < 4_000_000
