"""Findings about when messages were measured and recorded."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.replay.check.logs import MS, START, UPRIGHT, S, changed, checked, clean, found, problems, scan

from fbench.replay.check.times import Times, find_repeated, out_of_order, quantile, stream_stats, timeline
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.messages import Pose
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.container import Entry
from fbench.replay.logs.setup import StampParams


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.mcap"


def delayed(sensor, by_ns, of=lambda i: True):
    """Change the stamps of a sensor's messages; they are recorded when they were."""

    def change(item):
        hit = getattr(item, "sensor", "") == sensor and of((item.stamp_ns - START) // (100 * MS))
        return replace(item, stamp_ns=item.stamp_ns + by_ns) if hit else item

    return change


def test_clean_log_is_clean(path):
    result = checked(path, clean())
    assert result.findings == ()
    assert result.num_problems == 0
    assert (result.reference, result.frames.num_frames, result.frames.num_complete) == ("lidar", 20, 20)
    assert (result.num_truths, result.num_labeled) == (20, 20)


def test_numbers_of_a_stream(path):
    result = checked(path, clean())
    lidar = next(s for s in result.streams if s.sensor == "lidar")
    assert (lidar.num_messages, lidar.rate_hz, lidar.median_period_ns, lidar.max_gap_ns) == (
        20,
        10.0,
        100 * MS,
        100 * MS,
    )
    assert (lidar.jitter_p99_ns, lidar.num_lost, lidar.num_gaps) == (0, 0, 0)
    assert (lidar.skew_min_ns, lidar.skew_median_ns, lidar.skew_max_ns) == (10 * MS, 10 * MS, 10 * MS)
    assert (lidar.first_stamp_ns, lidar.last_stamp_ns) == (START, START + 1900 * MS)


def test_exact_duplicates(path):
    items = clean()
    result = checked(path, [*items, *(m for m in items if getattr(m, "sensor", "") == "radar")][:-17])
    one = found(result, "TIM004")
    assert (one.source, one.count, one.first, one.severity) == ("radar", 3, f"stamp {START} ns", "warning")


def test_same_stamp_with_other_content(path):
    result = checked(path, [*clean(), scan(99, START + 300 * MS, late_ns=3 * MS)])
    assert problems(result) == [("TIM003", "radar")]
    assert found(result, "TIM003").first == f"stamp {START + 300 * MS} ns"


def test_stamps_out_of_order(path):
    def swap(item):
        if getattr(item, "sensor", "") != "radar":
            return item
        i = (item.stamp_ns - START) // (100 * MS)
        return replace(item, stamp_ns=item.stamp_ns + {5: 100 * MS, 6: -100 * MS}.get(i, 0))

    result = checked(path, changed(swap, clean()))
    one = found(result, "TIM001")
    assert (one.source, one.count) == ("radar", 1)
    assert "by up to 100.0 ms" in one.text
    assert one.first == f"stamp {START + 500 * MS} ns"


def test_clock_that_jumps_back(path):
    result = checked(path, changed(delayed("radar", -10 * S, lambda i: i >= 10), clean()))
    one = found(result, "TIM005")
    assert (one.source, one.count) == ("radar", 1)
    assert "9.900 s" in one.text


def test_gap(path):
    later = [replace(m, stamp_ns=m.stamp_ns + 5 * S, log_ns=m.log_ns + 5 * S) for m in clean()]
    result = checked(path, [*clean(), *later])
    assert problems(result) == [("TIM007", name) for name in ("cam", "gnss", "lidar", "radar")]
    one = next(f for f in result.findings if f.source == "lidar")
    assert "1 gap, the longest of 3.100 s" in one.text
    assert one.first == f"after stamp {START + 1900 * MS} ns"
    assert result.frames.breaks == ("gap of 3.100 s before frame 20",)
    assert checked(path, sync=SyncParams(max_gap_ns=4 * S)).num_problems == 3  # messages count as lost then


def test_lost_messages_are_a_warning_when_they_are_many(path):
    def without(*numbers):
        return [
            m
            for m in clean(60)
            if getattr(m, "sensor", "") != "radar" or (m.stamp_ns - START) // (100 * MS) not in numbers
        ]

    few, many = checked(path, without(5, 7)), checked(path, without(5, 7, 20, 21, 40))
    assert (found(few, "CHK003").severity, found(few, "CHK003").count) == ("info", 2)
    assert (found(many, "CHK003").severity, found(many, "CHK003").count) == ("warning", 5)


def test_irregular_periods(path):
    rng = np.random.Generator(np.random.Philox(1))
    shifts = {START + i * 100 * MS: int(rng.uniform(0, 80)) * MS for i in range(40)}
    items = [
        replace(m, stamp_ns=m.stamp_ns + shifts[m.stamp_ns], log_ns=m.log_ns + shifts[m.stamp_ns])
        if getattr(m, "sensor", "") == "radar"
        else m
        for m in clean(40)
    ]
    assert ("CHK002", "radar") in problems(checked(path, items))


def test_boot_time_beside_unix_time(path):
    result = checked(path, changed(delayed("radar", -(START - 100 * S)), clean()))
    one = found(result, "TIM008")
    assert (one.source, one.severity) == ("radar", "error")
    assert one.text == "its clock is 1699999899.992 s behind that of lidar"
    assert one.advice == "synchronize the clocks, or give --offset radar=1699999899992 or --stamps log"


def test_offset_puts_a_clock_right(path):
    items = changed(delayed("radar", -(START - 100 * S)), clean())
    assert checked(path, items, stamps=StampParams(offsets_ns={"radar": START - 100 * S})).num_problems == 0
    result = checked(path, stamps=StampParams(source="log"))
    assert (result.num_problems, result.num_labeled) == (0, 20)  # truth goes by the stamps that were recorded
    with pytest.raises(ConfigError, match="--offset radr: no such sensor; did you mean 'radar'"):
        checked(path, stamps=StampParams(offsets_ns={"radr": 1}))


def test_stamps_far_older_than_arrival(path):
    items = [replace(m, log_ns=m.log_ns + 500 * MS) for m in clean()]
    result = checked(path, items)
    assert {code for code, _ in problems(result)} == {"TIM009"}
    one = next(f for f in result.findings if f.source == "lidar")
    assert one.text.startswith("header stamps are 510.0 ms older than arrival (median; ")


def test_stamps_of_when_a_sweep_began_are_nothing_to_warn_of(path):
    assert checked(path, [replace(m, log_ns=m.log_ns + 98 * MS) for m in clean()]).num_problems == 0


def test_stamps_ahead_of_arrival(path):
    result = checked(path, changed(delayed("radar", 60 * MS), clean()))
    assert ("TIM009", "radar") in problems(result)
    text = found(result, "TIM009").text
    assert text.startswith("header stamps are ")
    assert text.endswith(" ms): measured after it was recorded?")


def test_stamps_of_zero(path):
    def zero(item):
        return replace(item, stamp_ns=0) if getattr(item, "sensor", "") == "radar" else item

    result = checked(path, changed(zero, clean()))
    assert problems(result) == [("CHK001", "radar"), ("FRM001", "radar")]
    assert found(result, "CHK001").text == "20 of 20 stamps are 0"


def test_recorded_in_another_order(path):
    from tests.replay.check.logs import RIG
    from tests.replay.logs.builders import write

    write(path, reversed(clean()), RIG)
    result = checked(path)
    assert problems(result) == []
    assert {f.source for f in result.findings if f.code == "CHK004"} == {"cam", "gnss", "lidar", "radar"}


def times_of(stamps, digests=None):
    times = Times()
    for i, stamp in enumerate(stamps):
        content = bytes([0 if digests is None else digests[i]])
        pose = Pose("p", stamp, i, np.zeros(3), UPRIGHT)
        times.add(Entry(i, "/p", 0, 0, i, 1, 0, stamp, memoryview(content)), pose)
    return times


@given(st.lists(st.integers(1, 60), max_size=30), st.integers(1, 50))
def test_disorder_and_jumps_against_a_plain_count(stamps, max_jump):
    line = timeline(times_of(stamps), max_jump)
    jumps = [i for i in range(1, len(stamps)) if stamps[i - 1] - stamps[i] > max_jump]
    expected, top = [], 0
    for i, stamp in enumerate(stamps):
        top = stamp if i == 0 or i in jumps else max(top, stamp)
        expected += [(i, top - stamp)] if stamp < top else []
    rows, behind = out_of_order(line)
    assert list(zip(rows.tolist(), behind.tolist(), strict=True)) == expected
    assert len(line.pieces) - 1 == len(jumps)


@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 2)), max_size=25))
def test_duplicates_against_a_plain_count(pairs):
    same, other = find_repeated(timeline(times_of([s for s, _ in pairs], [d for _, d in pairs]), 1000))
    assert len(same) == len(pairs) - len(set(pairs))
    assert len(other) == len(set(pairs)) - len({s for s, _ in pairs})


@given(st.lists(st.integers(-5, 5), min_size=1, max_size=30), st.floats(0, 1))
def test_quantile_is_that_of_numpy(values, share):
    expected = np.quantile(values, share, method="inverted_cdf") if share > 0 else min(values)
    assert quantile(np.array(values), share) == expected


@pytest.mark.slow
def test_only_some_bytes_of_each_message_are_kept():
    tracemalloc.start()
    times = times_of(range(START, START + 50_000))
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 50_000 * 40
    assert stream_stats("p", "pose", timeline(times, S), 2 * S).num_messages == 50_000
