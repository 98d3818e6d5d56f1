"""Sensors that come, but are in hardly any frame: data were lost, and what to do is said."""

import json
import re
from dataclasses import replace

import pytest
from tests.replay.engine.test_run import play
from tests.replay.fakes import MS, Echo, FakeLog, cloud, scan

from fbench.replay.contracts.errors import DataError, RunError
from fbench.replay.contracts.faults import FaultBudget, FaultLog
from fbench.replay.data.frames import Fault
from fbench.replay.data.rig import Mount, Rig
from fbench.replay.engine.excerpt import make_excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.logs.setup import make_stamp_params


class Needing(Echo):
    """Needs LiDAR and radars."""

    def __init__(self, *required):
        super().__init__()
        self.required = required or ("lidar", "radar")

    def required_sensors(self):
        return self.required


class Doubting(Echo):
    """Warns at the end."""

    def __init__(self, *faults):
        super().__init__()
        self.faults = faults

    def warnings(self):
        return self.faults


def test_warnings_of_a_pipeline_are_flagged_once_and_lose_nothing(tmp_path):
    faults = FaultLog()
    run = play(log([]), tmp_path / "run", Doubting(Fault("PRD005", "lidar: 9 of 9")), faults)
    rows = {row["code"]: row for row in json.loads((run.folder / "faults.json").read_text())["rows"]}
    assert (rows["PRD005"]["count"], rows["PRD005"]["places"]) == (1, ["lidar: 9 of 9"])
    assert run.manifest.complete
    with pytest.raises(DataError, match="isn't a fault of the table"):
        play(log([]), tmp_path / "other", Doubting(Fault("XYZ", "")), FaultLog())


def log(radars, num=20, period_ms=100):
    return FakeLog([cloud(period_ms * MS * i + 10_000 * MS) for i in range(num)] + list(radars))


def radar(stamp_ms, arrives_ms=None, sensor="radar"):
    one = replace(scan(round((stamp_ms + 10_000) * MS)), sensor=sensor)
    return one if arrives_ms is None else replace(one, log_ns=round((arrives_ms + 10_000) * MS))


def shortages(run):
    rows = {row["code"]: row for row in json.loads((run.folder / "faults.json").read_text())["rows"]}
    assert run.manifest.complete == (rows["FRM001"]["count"] == 0)
    return rows["FRM001"]["places"]


def reasons(run):
    return {re.sub(r"[\d.]+", "N", why) for frame in run.frames for why in frame.missing.values()}


LATE = [radar(100 * i, 100 * i + 500) for i in range(20)]
BEHIND = [radar(100 * i - 5000, 100 * i) for i in range(20)]
AHEAD = [radar(100 * i + 7000, 100 * i) for i in range(20)]
FAR_BEHIND = [radar(100 * i, 100 * i + 30_000) for i in range(20)]
RARE = [radar(1000)]
CASES = {
    "late": (LATE, "released 470.0 ms too soon for it", {"late by N ms"}, {"timeout-ms": "500"}),
    "clock behind": (BEHIND, "stamped 5000.0 ms before", {"off by N ms"}, {"offset": "radar=5000"}),
    "clock ahead": (AHEAD, "stamped 7000.0 ms after", {"off by N ms"}, {"offset": "radar=-7000"}),
    "arrival far behind": (FAR_BEHIND, "released 30.0 s too soon", {"late by N ms"}, {"offset": "radar=29970"}),
    "rate": (RARE, "although 1 message of it came, over 0.0 s", {"never came"}, {"reference": "radar"}),
}


@pytest.mark.parametrize(("radars", "why", "said", "options"), CASES.values(), ids=CASES.keys())
def test_what_came_is_never_said_to_have_never_come(tmp_path, radars, why, said, options):
    run = play(log(radars), tmp_path / "run", Needing(), sync=SyncParams("lidar"))
    (place,) = shortages(run)
    present = len([m for m in radars if m is RARE[0]])
    assert place.startswith(f"radar is in {present} of 20 frames, although {len(radars)} message")
    assert why in place
    assert reasons(run) == said
    for option, value in options.items():
        assert f"--{option} {value}" in place


def test_the_advice_helps(tmp_path):
    sync = SyncParams(timeout_ns=500 * MS)
    assert shortages(play(log(LATE), tmp_path / "late", Needing(), sync=sync)) == []
    for name, radars, offset in (("behind", BEHIND, 5000), ("ahead", AHEAD, -7000)):
        stamps = make_stamp_params("header", [f"radar={offset}"])
        assert shortages(play(log(radars), tmp_path / name, Needing(), stamps=stamps)) == []


def test_a_tolerance_that_is_too_small(tmp_path):
    off = [radar(1000 * i + 200 + 10 * i, 1000 * i + 20) for i in range(20)]
    slow = log(off, period_ms=1000)
    (place,) = shortages(play(slow, tmp_path / "run", Needing()))
    assert "stamped 300.0 ms after the frames' instants (tolerance 50.0 ms); --tolerance-ms 390 would" in place
    wide = SyncParams(tolerance_ns=390 * MS)
    assert shortages(play(slow, tmp_path / "wide", Needing(), sync=wide)) == []


def test_a_tenth_is_enough(tmp_path):
    assert shortages(play(log([radar(0), radar(1000)]), tmp_path / "run", Needing(), sync=SyncParams("lidar"))) == []


def test_what_a_pipeline_does_not_need_is_no_loss(tmp_path):
    assert shortages(play(log(RARE), tmp_path / "said", Needing("lidar"), sync=SyncParams("lidar"))) == []
    assert shortages(play(log(RARE), tmp_path / "unsaid", Echo(), sync=SyncParams("lidar"))) == []


def test_a_sensor_that_the_log_lacks_is_needed_where_nothing_else_goes_on(tmp_path):
    mount = Mount("camera", [0.0, 0, 0], [0.0, 0, 0, 1])
    seeing = replace(log([]), rig=Rig({**log([]).rig.mounts, "camera": mount}, {}))
    assert shortages(play(seeing, tmp_path / "camera", Needing("lidar", "camera"))) == []
    assert shortages(play(log([]), tmp_path / "radar", Needing())) == []
    (place,) = shortages(play(log([]), tmp_path / "none", Needing("radar")))
    assert place == "radar is in 0 of 20 frames: the log has no message of it; --sensors '!radar' leaves it out"


def test_a_few_frames_of_a_log_say_nothing(tmp_path):
    few, enough = (make_excerpt(None, None, text) for text in (":9", ":10"))
    assert shortages(play(log(LATE), tmp_path / "few", Needing(), excerpt=few)) == []
    assert len(shortages(play(log(LATE), tmp_path / "enough", Needing(), excerpt=enough))) == 1


def test_the_budget_may_allow_it(tmp_path):
    faults = FaultLog()
    run = play(log(LATE), tmp_path / "run", Needing(), faults, budget=FaultBudget(0, {"FRM001": 1}))
    assert (run.manifest.complete, faults.counts["FRM001"]) == (True, 1)


def test_a_pipeline_that_cannot_say_what_it_needs(tmp_path):
    class Unsure(Echo):
        def required_sensors(self):
            raise ZeroDivisionError

    with pytest.raises(RunError, match="can't say which sensors it needs"):
        play(log(LATE), tmp_path / "run", Unsure())
