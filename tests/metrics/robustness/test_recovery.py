"""Recovery after an outage, on runs made by hand."""

from pathlib import Path

import pytest
from tests.metrics.conftest import boxes3d, make_manifest

from fbench.metrics.robustness.recovery import find_outages
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


def test_what_is_missing_in_clear_weather_too_is_no_outage(tmp_path):
    clear = write(tmp_path / "clear", "+" * 6, "xx....")
    assert find_outages(clear, write(tmp_path / "away", "+" * 6, "xx...."), ScoreOptions()) == []
