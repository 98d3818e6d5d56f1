"""Memory does not grow with the length of a log."""

import tracemalloc

import numpy as np
import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.convert.helpers import converted

from fbench.replay.data.messages import PointCloud

HOWS = [("out.mcap", {"chunk_size": 100_000}), ("out.parquet", {"rows_per_group": 4}), ("parts", {"split_mb": 5})]


def peak(action):
    tracemalloc.start()
    action()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return most


@pytest.fixture(scope="module")
def long_log(tmp_path_factory):
    """About 24 MB in about 100 chunks, with a transform before each of them."""
    rng = np.random.Generator(np.random.Philox(0))
    clouds = (PointCloud("top", i, i, rng.normal(size=(20_000, 3)).astype(np.float32)) for i in range(100))
    return b.write(tmp_path_factory.mktemp("log") / "log.mcap", clouds, b.the_rig(), compression="none", chunk_size=1)


@pytest.mark.parametrize(("name", "how"), HOWS)
def test_of_a_conversion(tmp_path, long_log, name, how):
    converted(long_log, tmp_path / f"warm-{name}", **how)  # what is imported on the way isn't counted
    assert long_log.stat().st_size > 24_000_000
    most = peak(lambda: converted(long_log, tmp_path / name, compression="none", **how))
    assert most < 6_000_000


@pytest.mark.parametrize("name", ["out.mcap", "out.parquet"])
def test_of_a_cut(tmp_path, long_log, name):
    converted(long_log, tmp_path / f"warm-{name}", start="90ns")
    assert peak(lambda: converted(long_log, tmp_path / name, start="90ns", compression="none")) < 6_000_000
