"""Recovery after an outage, on runs made by hand."""

from pathlib import Path

import numpy as np
import pytest
from tests.metrics.conftest import boxes3d, make_manifest

from fbench.metrics.core.bootstrap import Bootstrap
from fbench.metrics.robustness.recovery import Outage, find_outages, mean_recovery
from fbench.replay.data.messages import Truth
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter

TRUTH = boxes3d((10, 0), label="car", ids=[1])
HIT, MISS = boxes3d((10, 0), label="car", score=[0.9], ids=[1]), boxes3d()
STEP_NS = 100_000_000


def write(folder: Path, hits: str, lost: str) -> Run:
    """A frame a character: `+` where the truth is found, `x` where the LiDAR is missing."""
    with RunWriter(folder) as writer:
        for i, (hit, away) in enumerate(zip(hits, lost, strict=True)):
            missing = {"lidar": "never came"} if away == "x" else {}
            writer.add_frame(FrameRecord(i, i * STEP_NS, 0, None, missing, "", ""), {"total": 1})
            for name in ("detections", "tracks"):
                writer.add_boxes(name, i, HIT if hit == "+" else MISS)
            writer.label_frame(i, Truth(i * STEP_NS, i * STEP_NS, TRUTH))
        return Run(writer.finish(make_manifest(num_frames=len(hits))))


@pytest.mark.parametrize(
    ("hits", "recovery_s"),
    [
        ("++---+++++", 0.1),  # as good in the first frame with the sensor
        ("++-----+++", 0.3),
        ("++---++-++", None),  # three frames in a row are needed
        ("++--------", None),
        ("++++++++++", 0.0),  # nothing was lost
    ],
)
def test_recovery_counts_from_the_last_frame_without_the_sensor(tmp_path, hits, recovery_s):
    clear = write(tmp_path / "clear", "+" * 10, "." * 10)
    outages = find_outages(clear, write(tmp_path / "away", hits, "..xxx....."), ScoreOptions())
    assert [(o.sensor, o.first_frame, o.last_frame) for o in outages] == [("lidar", 2, 4)]
    assert outages[0].silent_s == pytest.approx(0.2)
    assert outages[0].recovery_s == (None if recovery_s is None else pytest.approx(recovery_s))


def outages(*recovery_s):
    return [Outage("lidar", 2, 4, 0.2, seconds) for seconds in recovery_s]


def test_the_mean_over_outages_and_its_interval():
    few, many = (mean_recovery(outages(*seconds), Bootstrap()) for seconds in ((0.1, 0.4), (0.1, 0.4) * 50))
    assert (few.value, few.low, few.high) == (pytest.approx(250), None, None)
    half = 1.96 * 150 / np.sqrt(100)  # normal: a hundred of deviation 150 ms
    assert (many.value, many.low, many.high) == pytest.approx((250, 250 - half, 250 + half), rel=0.02)
    assert mean_recovery(outages(*[0.3] * 5), Bootstrap()).high == pytest.approx(300)


def test_no_mean_where_one_never_recovered_or_nothing_was_away():
    assert mean_recovery(outages(0.1, None), Bootstrap()).reason == "not recovered in 1 of 2 outages"
    assert mean_recovery([], Bootstrap()).reason == "no frame lacks a sensor"


def test_what_is_missing_in_clear_weather_too_is_no_outage(tmp_path):
    clear = write(tmp_path / "clear", "+" * 6, "xx....")
    assert find_outages(clear, write(tmp_path / "away", "+" * 6, "xx...."), ScoreOptions()) == []
