"""Splitting into parts that are one log."""

import numpy as np
import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.convert.helpers import content, conversion, converted, digest, messages

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.messages import Pose

NONE = np.array([0, 0, 0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    "how", [{"split_s": 0.7}, {"split_s": 0.05}, {"split_mb": 0.004}, {"split_s": 1, "split_mb": 0.01}]
)
def test_parts_are_the_log(tmp_path, drive, how):
    result, faults = conversion(drive, tmp_path / "parts", chunk_size=2000, **how)
    assert len(result.parts) >= 2
    assert sorted(p.name for p in result.path.iterdir()) == sorted(result.parts)
    assert not faults.num_lost
    assert messages(result.path) == messages(drive)
    assert (content(result.path), digest(result.path)) == (content(drive), digest(drive))
    joined = converted(result.path, tmp_path / "joined.mcap")
    assert messages(joined) == messages(drive)
    assert messages(converted(converted(result.path, tmp_path / "j.parquet"), tmp_path / "back.mcap")) == messages(
        drive
    )


def test_three_parts_by_time(tmp_path, drive):
    result, _ = conversion(drive, tmp_path / "drive", split_s=0.7)
    assert result.parts == ("drive_0.mcap", "drive_1.mcap", "drive_2.mcap")
    starts = [[m[1] for m in messages(result.path / name)] for name in result.parts]
    assert [(min(s) - 10**9) // 700_000_000 for s in starts] == [0, 1, 2]
    assert [(max(s) - 10**9) // 700_000_000 for s in starts] == [0, 1, 2]


def test_a_split_between_equal_stamps_changes_nothing(tmp_path):
    items = [Pose(name, i, 5, np.full(3, i), NONE) for i in range(60) for name in ("a", "b")]
    path = b.write(tmp_path / "log.mcap", items)
    result, _ = conversion(path, tmp_path / "parts", split_mb=0.002, chunk_size=500, compression="none")
    assert len(result.parts) > 3
    assert messages(result.path) == messages(path)
    assert digest(result.path) == digest(path)


def test_ten_parts_and_more_come_in_the_order_of_their_numbers(tmp_path, drive):
    result, _ = conversion(drive, tmp_path / "parts", split_s=0.1)
    assert len(result.parts) == 20
    assert result.parts[10] == "parts_10.mcap"
    assert digest(result.path) == digest(drive)


def test_a_pause_leaves_no_empty_parts(tmp_path):
    path = b.write(tmp_path / "log.mcap", [Pose("a", i, i * 10**9, np.zeros(3), NONE) for i in (1, 2, 50)])
    result, _ = conversion(path, tmp_path / "parts", split_s=1)
    assert [len(messages(result.path / name)) for name in result.parts] == [1, 1, 1]


def test_a_folder_may_be_called_like_a_file(tmp_path, drive):
    result, _ = conversion(drive, tmp_path / "x.mcap", split_s=1)
    assert result.parts == ("x_0.mcap", "x_1.mcap")
    assert digest(result.path) == digest(drive)


@pytest.mark.parametrize(
    "how", [{"split_s": 0}, {"split_s": -1}, {"split_mb": float("nan")}, {"split_s": float("inf")}]
)
def test_splits_that_make_no_sense(tmp_path, drive, how):
    with pytest.raises(ConfigError, match=r"--split-(s|mb) .*: expected a positive number"):
        conversion(drive, tmp_path / "parts", **how)


def test_parquet_is_not_split(tmp_path, drive):
    with pytest.raises(ConfigError, match="--split-s and --split-mb is for MCAP, not for Parquet"):
        conversion(drive, tmp_path / "x.parquet", split_s=1)
