"""Conditions of time: exact times, shares and lengths of bursts against their formulas."""

from dataclasses import replace
from functools import cache
from itertools import groupby

import numpy as np
import pytest

from fbench.replay.conditions.times import (
    BurstLoss,
    ClockJump,
    Delay,
    Drift,
    Dropout,
    Duplicate,
    Jitter,
    Loss,
    Offset,
    Reorder,
)
from fbench.replay.contracts.conditions import Site
from fbench.replay.contracts.street import Street
from fbench.replay.data.messages import PointCloud

MS = 1_000_000
FIRST = 1_700_000_000_000_000_000
NUM = 3000
SITE = Site((3, "x@1:3", "log", "lidar"), Street().rig, "lidar", "lidar", FIRST, FIRST + NUM * 100 * MS)


@cache
def cloud(index):
    at = FIRST + index * 100 * MS
    return PointCloud("lidar", at - 5 * MS, at, np.zeros((0, 3), np.float32))


def results(condition, num=NUM, site=SITE, **level):
    return [condition.disturb(cloud(i), level, site) for i in range(num)]


def late_ms(found):
    return np.array([(m.log_ns - cloud(i).log_ns) / MS for i, ms in enumerate(found) for m in ms])


def ahead_ms(found):
    return np.array([(m.stamp_ns - cloud(i).stamp_ns) / MS for i, ms in enumerate(found) for m in ms])


def test_dropout_is_one_silence_of_the_given_length_within_the_log():
    begins = set()
    for seed in range(5):
        site = replace(SITE, key=(seed, *SITE.key[1:]))
        gone = [i for i, found in enumerate(results(Dropout(), silent_s=2.0, site=site)) if not found]
        assert len(gone) == 20
        assert gone[-1] - gone[0] == 19
        begins.add(gone[0])
    assert len(begins) == 5
    assert not any(results(Dropout(), num=10, silent_s=2.0, site=replace(SITE, last_ns=FIRST + 1000 * MS)))


def test_loss_has_its_share():
    gone = np.array([not found for found in results(Loss(), lost_share=0.2)])
    assert gone.mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.2 * 0.8 / NUM))


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4, 0.6])
def test_bursts_have_their_share_and_length(share):
    gone = [not found for found in results(BurstLoss(), num=40_000, lost_share=share)]
    bursts = [len(list(group)) for is_gone, group in groupby(gone) if is_gone]
    # A mean over bursts whose lengths are geometric with mean 4, and over good stays between them.
    assert np.mean(bursts) == pytest.approx(4, abs=4 * 4 / np.sqrt(len(bursts)))
    assert np.mean(gone) == pytest.approx(share, abs=0.03)
    assert len(set(bursts)) > 5


def test_a_message_is_lost_whichever_others_are_asked_for():
    alone = [BurstLoss().disturb(cloud(i), {"lost_share": 0.3}, SITE) for i in reversed(range(700))][::-1]
    assert [len(a) for a in alone] == [len(b) for b in results(BurstLoss(), num=700, lost_share=0.3)]
    assert results(BurstLoss(), num=5, lost_share=1.0) == [()] * 5
    assert all(results(BurstLoss(), num=5, lost_share=0.0))


def test_delay_and_offset_are_exact():
    assert set(late_ms(results(Delay(), num=9, delay_ms=50.0))) == {50.0}
    assert set(ahead_ms(results(Delay(), num=9, delay_ms=50.0))) == {0.0}
    assert set(ahead_ms(results(Offset(), num=9, offset_ms=20.0))) == {20.0}
    assert set(late_ms(results(Offset(), num=9, offset_ms=20.0))) == {0.0}


def test_jitter_is_half_normal():
    late = late_ms(results(Jitter(), sigma_ms=5.0))
    assert late.min() >= 0
    assert late.mean() == pytest.approx(5 * np.sqrt(2 / np.pi), rel=0.05)
    assert np.sqrt((late**2).mean()) == pytest.approx(5, rel=0.05)
    assert (late > 10).mean() == pytest.approx(0.0455, abs=0.015)  # beyond two sigma


def test_duplicates_are_the_same_message_a_little_later():
    found = results(Duplicate(), repeated_share=0.2)
    twice = [ms for ms in found if len(ms) == 2]
    assert len(twice) / NUM == pytest.approx(0.2, abs=0.03)
    assert all(len(ms) in (1, 2) for ms in found)
    late = [(b.log_ns - a.log_ns) / MS for a, b in twice]
    assert 0 <= min(late) < 5
    assert 95 < max(late) <= 100
    assert all(a.stamp_ns == b.stamp_ns for a, b in twice)


@pytest.mark.parametrize("num", [1, 4])
def test_messages_are_overtaken_by_at_most_so_many(num):
    found = [ms[0] for ms in results(Reorder(), num=400, overtaking=float(num))]
    late = {round((m.log_ns - cloud(i).log_ns) / MS) for i, m in enumerate(found)}
    assert late == {0, *(100 * k + 50 for k in range(1, num + 1))}
    delivered = sorted(range(400), key=lambda i: found[i].log_ns)
    place = {index: at for at, index in enumerate(delivered)}
    overtaken = [sum(place[j] < place[i] for j in range(i + 1, min(400, i + 20))) for i in range(380)]
    assert max(overtaken) == num
    assert [m.stamp_ns for m in found] == [cloud(i).stamp_ns for i in range(400)]


def test_drift_grows_from_the_first_message_on_exactly():
    ahead = [ms[0].stamp_ns - cloud(i).stamp_ns for i, ms in enumerate(results(Drift(), num=101, fast_ppm=100.0))]
    assert ahead == [10_000 * i for i in range(101)]  # 100 ppm of 100 ms are 10 us


def test_a_clock_jumps_once_in_the_middle_half():
    ahead = ahead_ms(results(ClockJump(), jump_s=60.0))
    jumps = np.flatnonzero(np.diff(ahead))
    assert len(jumps) == 1
    assert NUM / 4 <= jumps[0] + 1 <= 3 * NUM / 4
    assert set(ahead) == {0.0, 60_000.0}
