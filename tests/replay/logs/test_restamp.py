"""Which stamp counts, and clocks that aren't one."""

from dataclasses import replace

import pytest
from tests.replay.fakes import MS, Echo, FakeLog, cloud, scan

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.logs.setup import MAX_SKEW_NS, StampParams, make_stamp_params

S = 1_000 * MS


def skewed(radar_skew_ns, radar_first=False, lidar_skew_ns=0):
    """LiDAR and radar whose stamps differ by a constant from the time of recording."""
    items = []
    for i in range(3):
        arrival = 1_700_000_000 * S + 100 * MS * i
        items.append(replace(cloud(arrival + lidar_skew_ns), log_ns=arrival))
        arrival += -MS if radar_first else MS
        items.append(replace(scan(arrival + radar_skew_ns), log_ns=arrival))
    return FakeLog(items)


def play(log, tmp_path, **stamps):
    plan = Plan(Echo(), "echo", sync=SyncParams(reference="lidar"), stamps=StampParams(**stamps))
    return replay(log, plan, tmp_path / "run", FaultLog())


@pytest.mark.parametrize("radar_first", [False, True])
@pytest.mark.parametrize(("skew_s", "said"), [(-1_700_000_000 + 5, "-1699999995.000"), (61, "61.000")])
def test_another_clock_is_fatal(tmp_path, radar_first, skew_s, said):
    with pytest.raises(
        LogError,
        match=rf"sensor 'radar': its clock differs from that of 'lidar' by {said} s; "
        rf"give --offset radar={-skew_s * 1000} or --stamps log",
    ):
        play(skewed(skew_s * S, radar_first), tmp_path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("skew_ns", [0, 59 * S, MAX_SKEW_NS, -MAX_SKEW_NS])
def test_delay_is_no_other_clock(tmp_path, skew_ns):
    play(skewed(skew_ns), tmp_path)


def test_clock_that_all_sensors_share_may_be_any(tmp_path):
    play(skewed(-1_000_000 * S, lidar_skew_ns=-1_000_000 * S), tmp_path)


def test_the_advice_helps(tmp_path):
    play(skewed(-1_600_000_000 * S), tmp_path, offsets_ns={"radar": 1_600_000_000 * S})


def test_the_advice_moves_the_sensor_whose_clock_is_wrong(tmp_path):
    """Here it is the reference that counts from when it was switched on."""
    log = skewed(-2 * S, lidar_skew_ns=-1_600_000_000 * S)
    with pytest.raises(LogError, match="give --offset lidar=1599999998000 or --stamps log"):
        play(log, tmp_path)
    play(log, tmp_path, offsets_ns={"lidar": 1_599_999_998 * S})


def test_log_time_is_one_clock(tmp_path):
    play(skewed(-1_600_000_000 * S), tmp_path, source="log")


def test_options_are_understood():
    params = make_stamp_params("log", ["radar=-12.5", "a=b=3"])
    assert params == StampParams("log", {"a=b": 3 * MS, "radar": -12_500_000})


@pytest.mark.parametrize(
    ("source", "offsets", "message"),
    [
        ("file", [], "--stamps file: expected 'header' or 'log'"),
        ("log", ["radar"], "--offset radar: expected SENSOR=MILLISECONDS"),
        ("log", ["radar=fast"], "--offset radar=fast: expected SENSOR=MILLISECONDS"),
        ("log", ["radar=nan"], "expected SENSOR=MILLISECONDS"),
        ("log", ["radar=inf"], "expected SENSOR=MILLISECONDS"),
        ("log", ["=3"], "expected SENSOR=MILLISECONDS"),
        ("log", ["radar=1", "radar=2"], "--offset radar=2: 'radar' has an offset already"),
    ],
)
def test_bad_options_are_usage_errors(source, offsets, message):
    with pytest.raises(ConfigError, match=message):
        make_stamp_params(source, offsets)
