"""Which frame a message would have been in that can't be used."""

from tests.replay.fakes import MS

from fbench.replay.engine.cleaning import Skipped, SkippedMessages


def skipped(*messages):
    found = SkippedMessages(tolerance_ns=50 * MS)
    for message in messages:
        found.add(Skipped(*message))
    return found


def test_nearest_stamp_within_the_tolerance_counts_whatever_the_order():
    found = skipped(
        ("lidar", 300 * MS, None, "late one"), ("lidar", 100 * MS, None, "early one"), ("radar", 0, None, "other")
    )
    assert found.reason("lidar", 140 * MS, None) == "early one"
    assert found.reason("lidar", 150 * MS, None) == "early one"
    assert found.reason("lidar", 250 * MS, None) == "late one"
    assert found.reason("lidar", 200 * MS, None) is None
    assert found.reason("radar", 10 * MS, 3) == "other"
    assert found.reason("camera", 0, None) is None


def test_frame_numbers_decide_where_both_have_one():
    found = skipped(("lidar", 0, 7, "seven"), ("lidar", 10 * MS, 8, "eight"))
    assert found.reason("lidar", 900 * MS, 7) == "seven"
    assert found.reason("lidar", 0, 8) == "eight"
    assert found.reason("lidar", 0, 9) is None
    assert found.reason("lidar", 1 * MS, None) == "seven"
