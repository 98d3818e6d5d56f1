"""One log in every container gives one run: the digests of all its frames and of the log are the same."""

import pytest
from mcap.writer import CompressionType
from tests.city_log import write_city_log
from tests.replay.logs.convert.helpers import converted
from tests.replay.logs.other_forms import NO_SUMMARY, rewrite, shuffled_topics

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.open import open_log
from fbench.replay.runs.folder import Run

REWRITTEN = {
    "not in chunks": {"use_chunking": False},
    "not in chunks, no summary": {"use_chunking": False, **NO_SUMMARY},
    "no summary": NO_SUMMARY,
    "no summary, lz4": {"compression": CompressionType.LZ4, **NO_SUMMARY},
    "shuffled": {"order": shuffled_topics, "chunk_size": 50_000},
    "shuffled, not in chunks": {"order": shuffled_topics, "use_chunking": False},
}
MIB = 2**20
CONVERTED = {
    **{f"mcap {c}": ("a.mcap", {"compression": c}) for c in ("none", "lz4", "zstd")},
    **{f"mcap in chunks of {size}": ("a.mcap", {"chunk_size": size}) for size in (4096, MIB, 64 * MIB)},
    **{f"parquet {c}": ("a.parquet", {"compression": c}) for c in ("none", "snappy", "zstd")},
    **{f"parquet in groups of {n}": ("a.parquet", {"rows_per_group": n}) for n in (1, 64, 4096)},
}


def run_of(log, folder, excerpt=None):
    faults = FaultLog()
    pipeline, parameters = make_pipeline("lidar3d", [])
    plan = Plan(pipeline, "lidar3d", parameters, excerpt=excerpt or Excerpt())
    run = Run(replay(open_log(log, faults), plan, folder, faults))
    return run.manifest.log.digest, [frame.digest for frame in run.frames], run.manifest.digest


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "city.mcap"
    write_city_log(path, 1.5)
    return path


@pytest.fixture(scope="module")
def expected(boxes, tmp_path_factory):
    return run_of(boxes, tmp_path_factory.mktemp("runs") / "run")


@pytest.mark.slow
@pytest.mark.parametrize("name", REWRITTEN)
def test_mcap_of_other_writers(tmp_path, boxes, expected, name):
    assert run_of(rewrite(boxes, tmp_path / "a.mcap", **REWRITTEN[name]), tmp_path / "run") == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", CONVERTED)
def test_converted(tmp_path, boxes, expected, name):
    file, how = CONVERTED[name]
    assert run_of(converted(boxes, tmp_path / file, **how), tmp_path / "run") == expected


@pytest.mark.parametrize("split_s", [0.25, 0.5])
def test_parts(tmp_path, boxes, expected, split_s):
    assert run_of(converted(boxes, tmp_path / "parts", split_s=split_s), tmp_path / "run") == expected
