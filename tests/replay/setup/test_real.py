"""Real recordings, and how much is read of long ones."""

from collections.abc import Iterator

import pytest
from tests.replay.setup import drive as d

from fbench.datasets.astyx import Astyx
from fbench.datasets.importing.run import import_one
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.logs.container import Entry
from fbench.replay.logs.containers.mcap.file import McapFile
from fbench.replay.setup.guess_sensors import choose_sensors
from fbench.replay.setup.guess_truth import classes_table
from fbench.replay.setup.inspection import MAX_ENTRIES, NUM_WINDOWS, inspect_log


def test_kitti_in_ros2(guess, shared):
    config, text = guess(shared / "data/mcap/kitti_raw_12frames_ros2.mcap")
    assert {name: sensor.topic for name, sensor in config.sensors.items()} == {
        "camera_color_left": "/kitti/camera_color_left/image_raw",
        "velodyne": "/kitti/velodyne_points",
    }
    assert config.frames.reference == "velodyne"
    assert config.body.frame == "base_link"
    assert "guess: " not in text


@pytest.mark.slow
def test_astyx_keeps_its_names_and_the_meaning_of_own_logs(guess, shared, tmp_path):
    import_one(Astyx(), shared / "data/astyx", tmp_path / "astyx.mcap")
    config, text = guess(tmp_path / "astyx.mcap")
    assert sorted(config.sensors) == ["camera_front", "lidar_vlp16", "radar_6455"]
    radar = config.sensors["radar_6455"]
    assert (radar.doppler, radar.ego_motion, radar.velocity_period_mps) == ("receding", "included", None)
    assert config.classes["Car"] == "car"
    assert "guess: " not in text


class Counting(McapFile):
    """Counts what is taken out of a file."""

    num = 0

    def _counted(self, entries: Iterator[Entry]) -> Iterator[Entry]:
        for entry in entries:
            self.num += 1
            yield entry

    def entries(self, channels: frozenset[int], start_ns: int | None = None) -> Iterator[Entry]:
        return self._counted(super().entries(channels, start_ns))


@pytest.mark.slow
def test_long_logs_are_only_sampled(tmp_path):
    log = d.Drive()
    num = 12_000
    for i, ns in d.steps(num, 100):
        log.add("/gt", ns, d.boxes(ns, ["car"]))
        log.add("/lidar/points", ns, d.points("base_link", ns, 2))
        if i == num - 100:
            log.add("/late/points", ns, d.points("base_link", ns, 2))
    container = Counting(log.write(tmp_path / "log.mcap"), FaultLog())
    look = inspect_log(container)
    sensors = {s.name: s for s in choose_sensors(look.topics)[0]}
    # Each window ends with one message too many.
    assert container.num <= NUM_WINDOWS * MAX_ENTRIES + 10
    assert sensors["lidar"].sampled.num_messages == num
    assert {seen.window for seen in sensors["lidar"].sampled.samples} == set(range(NUM_WINDOWS))
    spread = [seen.log_ns for seen in sensors["lidar"].sampled.samples]
    assert max(spread) - min(spread) > 0.7 * num * 100 * d.MS
    before = container.num
    assert classes_table(look) is not None
    assert container.num - before <= 500 * NUM_WINDOWS + 10
