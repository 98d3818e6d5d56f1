import numpy as np
import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.engine.clock import Clock, Pace, make_clock

S = 1_000_000_000


class Wall:
    """A wall clock that only sleeping moves."""

    def __init__(self):
        self.ns = 0
        self.slept_s = []

    def now_ns(self):
        return self.ns

    def sleep_s(self, seconds):
        self.slept_s.append(seconds)
        self.ns += round(seconds * S)


def test_paced_clock_waits_by_rate():
    wall = Wall()
    clock = Clock(2.0, 5 * S, wall.now_ns, wall.sleep_s)
    for second in (10, 11, 13):
        clock.wait_until(second * S)
    assert wall.slept_s == [0.5, 1.0]


def test_slow_pipeline_catches_up_without_drift():
    wall = Wall()
    clock = Clock(1.0, 5 * S, wall.now_ns, wall.sleep_s)
    clock.wait_until(0)
    wall.ns += round(1.5 * S)  # the pipeline took 1.5 s
    clock.wait_until(1 * S)
    clock.wait_until(2 * S)
    assert wall.slept_s == [0.5]


def test_gaps_are_not_waited_for():
    wall = Wall()
    clock = Clock(1.0, 5 * S, wall.now_ns, wall.sleep_s)
    for second in (0, 5, 1000, 1001):
        clock.wait_until(second * S)
    assert wall.slept_s == [5.0, 1.0]


def test_make_clock():
    assert make_clock("max", S).pace.asked is None
    assert make_clock("0.5", S).pace.asked == 0.5


@pytest.mark.parametrize("rate", ["0", "-1", "fast", "nan", "inf", ""])
def test_bad_rates(rate):
    with pytest.raises(ConfigError, match="expected 'max' or a positive number"):
        make_clock(rate, S)


def test_pace_says_what_was_achieved_and_how_late():
    wall = Wall()
    clock = Clock(2.0, 5 * S, wall.now_ns, wall.sleep_s)
    assert clock.pace == Pace(2.0, None)
    for second in range(10):
        clock.wait_until(second * S)
    assert clock.pace == Pace(2.0, 2.0, 0.0, 0.0, 0.0)
    wall.ns += round(1.5 * S)  # the pipeline takes three times as long as it may
    clock.wait_until(10 * S)
    assert clock.pace == Pace(2.0, pytest.approx(10 / 6), 1000.0, 1000.0, 0.0)


def test_sleep_that_returns_late_is_jitter_and_no_drift():
    wall = Wall()

    def sleep_s(seconds):
        wall.sleep_s(seconds + 0.001)

    clock = Clock(1.0, 5 * S, wall.now_ns, sleep_s)
    for i in range(100_000):
        clock.wait_until(i * S // 100)
    assert wall.ns == (99_999 * S // 100) + S // 1000
    assert clock.pace == Pace(1.0, pytest.approx(1.0, rel=1e-5), 1.0, 1.0, pytest.approx(0.0, abs=1e-9))


@pytest.mark.parametrize("rate", [0.5, 1.0, 2.0, 3.7, 4.0, 8.0])
def test_a_paced_replay_keeps_its_schedule(rate):
    """Ten minutes of messages, uneven; sleeps overshoot by up to 0.9 ms and work takes up to half of the time between
    messages: each goes on within these 0.9 ms of its instant, so nothing adds up, and the pace tells it.
    """
    wall, random = Wall(), np.random.default_rng(5)
    stamps = np.cumsum(random.integers(20_000_000, 80_000_000, 12_000))
    late = iter(random.integers(0, 900_000, len(stamps)).tolist())

    def sleep_s(seconds):
        wall.ns += round(seconds * 1e9) + next(late)

    clock, start = Clock(rate, 5 * S, wall.now_ns, sleep_s), wall.ns
    for stamp in stamps.tolist():
        clock.wait_until(stamp)
        off_ns = wall.ns - start - (stamp - int(stamps[0])) / rate
        assert -2 <= off_ns <= 900_002
        wall.ns += round(0.5 * random.random() * 20_000_000 / rate)
    assert clock.pace.achieved == pytest.approx(rate, rel=1e-5)
    assert clock.pace.max_late_ms <= 0.901
    assert 0.8 < clock.pace.p99_late_ms <= clock.pace.max_late_ms
    assert abs(clock.pace.drift_ms_per_min) < 0.1


def test_drift_of_the_schedule_is_told_apart_from_lateness():
    wall, late_ns = Wall(), iter([0, 90_000_000, 0, 50_000_000, 0, 70_000_000, 0] * 20)
    clock = Clock(1.0, 5 * S, wall.now_ns, lambda seconds: wall.sleep_s(seconds) or wall.sleep_s(next(late_ns) / 1e9))
    for second in range(120):
        clock.wait_until(second * S)
    assert clock.pace.drift_ms_per_min == pytest.approx(0.0, abs=1e-6)
    wall, slip = Wall(), iter(range(1000))  # each sleep returns 1 ms later than the one before
    clock = Clock(1.0, 5 * S, wall.now_ns, lambda seconds: wall.sleep_s(seconds + next(slip) / 1000))
    for second in range(121):
        clock.wait_until(second * S)
    assert clock.pace.drift_ms_per_min == pytest.approx(60.0, rel=0.03)


def test_pauses_do_not_count_as_pace():
    wall = Wall()
    clock = Clock(1.0, 5 * S, wall.now_ns, wall.sleep_s)
    for second in (0, 4, 1000, 1002):
        clock.wait_until(second * S)
    assert clock.pace.achieved == pytest.approx(1.0)


def test_a_clock_without_rate_knows_its_pace_too():
    wall = Wall()
    clock = Clock(None, 5 * S, wall.now_ns)
    assert clock.pace == Pace(None, None)
    for second in (0, 4, 1000, 1002):
        clock.wait_until(second * S)
        wall.ns += S // 10
    assert clock.pace == Pace(None, pytest.approx(6 / 0.2))
