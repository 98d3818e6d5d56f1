import pytest

from fbench.replay.clock import PacedClock, VirtualClock, make_clock
from fbench.replay.errors import ConfigError

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
    clock = PacedClock(2.0, 5 * S, wall.now_ns, wall.sleep_s)
    for second in (10, 11, 13):
        clock.wait_until(second * S)
    assert wall.slept_s == [0.5, 1.0]


def test_slow_pipeline_catches_up_without_drift():
    wall = Wall()
    clock = PacedClock(1.0, 5 * S, wall.now_ns, wall.sleep_s)
    clock.wait_until(0)
    wall.ns += round(1.5 * S)  # the pipeline took 1.5 s
    clock.wait_until(1 * S)
    clock.wait_until(2 * S)
    assert wall.slept_s == [0.5]


def test_gaps_are_not_waited_for():
    wall = Wall()
    clock = PacedClock(1.0, 5 * S, wall.now_ns, wall.sleep_s)
    for second in (0, 5, 1000, 1001):
        clock.wait_until(second * S)
    assert wall.slept_s == [5.0, 1.0]


def test_make_clock():
    assert isinstance(make_clock("max", S), VirtualClock)
    assert isinstance(make_clock("0.5", S), PacedClock)


@pytest.mark.parametrize("rate", ["0", "-1", "fast", "nan", "inf", ""])
def test_bad_rates(rate):
    with pytest.raises(ConfigError, match="expected 'max' or a positive number"):
        make_clock(rate, S)
