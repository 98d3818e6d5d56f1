"""The queue in front of a pipeline, against a simulation of events written apart from it."""

import heapq
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.engine.service_queue import LatencyModel, OverloadPolicy, ServiceQueue, make_latency

NEWEST, SKIP = OverloadPolicy(), OverloadPolicy("skip")
ARRIVE, FREE = 1, 0  # At one instant the pipeline becomes free before a frame arrives


def run(policy, ready_ns, service_ns):
    served = []

    def serve(frame):
        served.append(frame)
        return f"of {frame}", service_ns[frame]

    found = list(ServiceQueue(policy, serve).run(enumerate(ready_ns)))
    assert [frame for frame, _ in found] == list(range(len(ready_ns)))
    assert served == [frame for frame, service in found if service is not None]
    assert all(service is None or service.result == f"of {frame}" for frame, service in found)
    return [None if service is None else (service.start_ns, service.done_ns) for _, service in found]


def simulate(policy, ready_ns, service_ns):
    """A server with a waiting room, driven by a heap of events."""
    events = [(t, ARRIVE, frame) for frame, t in enumerate(ready_ns)]
    heapq.heapify(events)
    room, found, is_busy = [], [None] * len(ready_ns), False
    capacity = {"newest": 1, "skip": 0, "fifo": policy.depth}[policy.kind]

    def start(frame, now):
        nonlocal is_busy
        is_busy, found[frame] = True, (now, now + service_ns[frame])
        heapq.heappush(events, (now + service_ns[frame], FREE, frame))

    while events:
        now, kind, frame = heapq.heappop(events)
        if kind == FREE:
            is_busy = False
            # For 'newest' a frame that arrives right now takes the place of the one that waits.
            if policy.kind == "newest" and room and any(t == now and k == ARRIVE for t, k, _ in events):
                room.clear()
            if room:
                start(room.pop(0), now)
        elif not is_busy:
            start(frame, now)
        elif len(room) < capacity:
            room.append(frame)
        elif policy.kind == "newest":
            room[:] = [frame]
    return found


policies = st.one_of(st.just(NEWEST), st.just(SKIP), st.builds(OverloadPolicy, st.just("fifo"), st.integers(1, 4)))
frames = st.lists(st.tuples(st.integers(0, 12), st.integers(0, 40)), min_size=1, max_size=60)
"""Gaps before frames and service times: small, so that instants coincide often."""


@settings(max_examples=200)
@given(policies, frames, st.sampled_from([1, 7_919, 1_000_003]), st.integers(-5, 2**62))
def test_it_agrees_with_a_simulation_to_the_nanosecond(policy, steps, unit_ns, begin_ns):
    ready, now = [], begin_ns
    for gap, _ in steps:
        now += gap * unit_ns
        ready.append(now)
    service = [length * unit_ns for _, length in steps]
    assert run(policy, ready, service) == simulate(policy, ready, service)


@settings(max_examples=50)
@given(policies, st.lists(st.integers(0, 3), max_size=30))
def test_without_latency_nothing_waits_or_is_dropped(policy, gaps):
    ready = [sum(gaps[:i]) for i in range(len(gaps))]
    assert run(policy, ready, [0] * len(ready)) == [(t, t) for t in ready]


@pytest.mark.parametrize(
    ("policy", "expected"),
    [
        (NEWEST, [(0, 25), None, (25, 50), None, (50, 75), (75, 100)]),
        (SKIP, [(0, 25), None, None, (30, 55), None, (60, 85)]),
        (OverloadPolicy("fifo", 1), [(0, 25), (25, 50), None, (50, 75), None, (75, 100)]),
        (OverloadPolicy("fifo", 2), [(0, 25), (25, 50), (50, 75), (75, 100), None, (100, 125)]),
    ],
)
def test_each_policy_by_hand(policy, expected):
    """Five frames every 10, then one later; each takes 25."""
    assert run(policy, [0, 10, 20, 30, 40, 60], [25] * 6) == expected


def test_a_frame_that_arrives_when_the_pipeline_becomes_free_is_the_newest():
    assert run(NEWEST, [0, 10, 20], [20, 5, 5]) == [(0, 20), None, (20, 25)]
    assert run(OverloadPolicy("fifo", 1), [0, 10, 20], [20, 5, 5]) == [(0, 20), (20, 25), (25, 30)]
    assert run(SKIP, [0, 10, 20], [20, 5, 5]) == [(0, 20), None, (20, 25)]


def test_options():
    assert make_latency(None, None, None) is None
    assert make_latency("fixed:80ms", None, None) == LatencyModel(80_000_000, NEWEST)
    assert make_latency("fixed:0.5us", "fifo:3", 2.0) == LatencyModel(500, OverloadPolicy("fifo", 3), Fraction(2))
    assert make_latency("measured", "skip", 0.1) == LatencyModel(None, SKIP, Fraction(1, 10))
    assert str(OverloadPolicy("fifo", 3)) == "fifo:3"


def test_at_twice_the_rate_twice_as_much_log_time_passes():
    assert make_latency("fixed:80ms", None, 2.0).service_ns(5) == 160_000_000
    assert make_latency("measured", None, 0.1).service_ns(1_000_000_019) == 100_000_001


@pytest.mark.parametrize("text", ["", "80ms", "fixed", "fixed:", "fixed:-1ms", "fixed:80", "fixed:nanms", "profile:"])
def test_a_latency_that_is_none_is_refused(text):
    with pytest.raises(ConfigError, match=r"--latency .*: expected 'measured', a time such as 'fixed:80ms'"):
        make_latency(text, None, None)


@pytest.mark.parametrize("text", ["", "fifo", "fifo:0", "fifo:x", "fifo:100001", "oldest"])
def test_an_overload_that_is_none_is_refused(text):
    with pytest.raises(ConfigError, match=r"--overload .*: expected 'newest', 'skip', or 'fifo:N'"):
        make_latency("measured", text, None)


def test_overload_goes_with_latency():
    with pytest.raises(ConfigError, match="--overload skip: is about --latency, which is missing"):
        make_latency(None, "skip", None)


@pytest.mark.parametrize(("latency", "rate"), [("fixed:999999999s", None), ("fixed:80ms", 1e12)])
def test_times_beyond_a_day_are_refused(latency, rate):
    with pytest.raises(ConfigError, match="is more than a day of log time"):
        make_latency(latency, None, rate)
