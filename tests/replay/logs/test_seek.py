"""Reading from the middle on gives what reading everything gives, in every container."""

from pathlib import Path

import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.containers.rosbag import builders as bags
from tests.replay.logs.convert.helpers import converted

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.open import open_container


def mcap(tmp_path: Path) -> Path:
    return b.write(tmp_path / "log.mcap", b.sequence(60))


def parquet(tmp_path: Path) -> Path:
    return converted(mcap(tmp_path), tmp_path / "log.parquet")


def parts(tmp_path: Path) -> Path:
    return converted(mcap(tmp_path), tmp_path / "parts", split_s=0.7)


def bag1(tmp_path: Path) -> Path:
    return bags.write_bag1(tmp_path / "log.bag", bags.rows())


def bag2(tmp_path: Path) -> Path:
    return bags.write_bag2(tmp_path / "log", bags.rows())


def bag2_packed(tmp_path: Path) -> Path:
    return bags.write_bag2(tmp_path / "log", bags.rows(), mode="message")


def bag2_mcap(tmp_path: Path) -> Path:
    return bags.write_bag2(tmp_path / "log", bags.rows(), storage="mcap")


@pytest.mark.parametrize("make", [mcap, parquet, parts, bag1, bag2, bag2_packed, bag2_mcap])
def test_same_as_reading_all(tmp_path, make):
    faults = FaultLog()
    container = open_container(make(tmp_path), faults)
    channels = frozenset(sorted(container.channels)[1:])
    every = [entry[:8] for entry in container.entries(channels)]
    for start_ns in (0, every[0][0], every[len(every) // 2][0], every[-1][0], every[-1][0] + 1):
        found = [entry[:8] for entry in container.entries(channels, start_ns)]
        assert found == [entry for entry in every if entry[0] >= start_ns]
    assert not faults.num_lost
