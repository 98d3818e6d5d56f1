"""What a pipeline would miss."""

from dataclasses import replace

import pytest
from tests.replay.check.logs import MS, RIG, START, changed, checked, clean, found, problems, write_moving
from tests.replay.fakes import Echo

from fbench.replay.contracts.errors import ConfigError, ModelError, RunError
from fbench.replay.data.messages import PointCloud, RadarScan
from fbench.replay.data.rig import Rig
from fbench.replay.engine.frame_buffer import SyncParams


@pytest.fixture
def path(tmp_path):
    return tmp_path / "log.mcap"


def late(sensor, by_ns, numbers):
    """Messages of a sensor arrive later than they should."""

    def change(item):
        hit = getattr(item, "sensor", "") == sensor and (item.stamp_ns - START) // (100 * MS) in numbers
        return replace(item, log_ns=item.log_ns + by_ns) if hit else item

    return change


def lost(kind, numbers):
    def change(item):
        return None if isinstance(item, kind) and (item.stamp_ns - START) // (100 * MS) in numbers else item

    return change


def test_nothing_is_missing(path):
    result = checked(path, clean(), pipeline=("echo", Echo()))
    assert result.findings == ()


class EchoOfRadar(Echo):
    """A box at the first LiDAR point, and nothing without radar."""

    def step(self, frame):
        return super().step(frame if "radar" in frame.messages else replace(frame, messages={}))


def test_late_and_lost_messages_of_a_sensor_that_it_uses(path):
    items = changed(lost(RadarScan, (9,)), changed(late("radar", 50 * MS, (4, 6)), clean()))
    result = checked(path, items, pipeline=("echo", EchoOfRadar()))
    one = found(result, "CHK009")
    assert (one.source, one.severity, one.count) == ("radar", "warning", 3)
    # Radar arrives 2 + 50 ms after the stamp, the LiDAR that opens the frame 10 ms after it, and the frame waits 30 ms.
    assert one.text == "missing from 3 of 20 frames: 2 late by 12.0 ms (median) to 12.0 ms, 1 never came"
    assert one.advice == "--timeout-ms 42 would wait for all that were late"
    assert result.frames.num_complete == 17


def test_the_advice_is_right(path):
    items = changed(late("radar", 50 * MS, (4, 6)), clean())
    assert problems(checked(path, items, pipeline=("echo", EchoOfRadar()), sync=SyncParams(timeout_ns=41 * MS)))
    assert not problems(checked(path, items, pipeline=("echo", EchoOfRadar()), sync=SyncParams(timeout_ns=42 * MS)))


def test_sensor_that_it_does_not_use_is_information(path):
    result = checked(path, changed(late("radar", 50 * MS, (4,)), clean()), pipeline=("echo", Echo()))
    assert found(result, "CHK009").severity == "info"
    assert found(result, "CHK009").text.endswith("echo doesn't use it")


def test_unused_messages_are_information(path):
    extra = [
        replace(m, stamp_ns=m.stamp_ns + 50 * MS, log_ns=m.log_ns + 50 * MS)
        for m in clean(19)
        if isinstance(m, RadarScan)
    ]
    result = checked(path, [*clean(), *extra], pipeline=("echo", Echo()))
    assert (found(result, "CHK010").source, found(result, "CHK010").count) == ("radar", 19)


def test_pipeline_that_cannot_use_the_rig(path):
    from fbench.pipelines.variants.lidar import Lidar3D

    items = [m for m in clean() if not isinstance(m, PointCloud)]
    mounts = {name: mount for name, mount in RIG.mounts.items() if name != "lidar"}
    result = checked(path, items, Rig(mounts, RIG.cameras), pipeline=("lidar3d", Lidar3D()))
    one = found(result, "CHK008")
    assert one.severity == "error"
    assert "lidar3d can't start: log 'log': lidar3d needs" in one.text


def test_incomplete_rig_keeps_a_pipeline_from_starting(path):
    mounts = {name: mount for name, mount in RIG.mounts.items() if name != "lidar"}
    result = checked(path, clean(), Rig(mounts, RIG.cameras), pipeline=("echo", Echo()))
    assert problems(result) == [("CAL001", "lidar"), ("CHK008", "")]


def test_a_camera_without_calibration_is_information_where_a_pipeline_goes_on_without(path):
    assert problems(checked(path, clean(), Rig(RIG.mounts, {}))) == [("CAL001", "cam")]
    result = checked(path, clean(), Rig(RIG.mounts, {}), pipeline=("echo", Echo()))
    assert (problems(result), found(result, "CAL001").severity) == ([], "info")


class Broken(Echo):
    def step(self, frame):
        raise ValueError("no good")


class BrokenAtStart(Echo):
    def start(self, rig, log_info):
        raise ZeroDivisionError


@pytest.mark.parametrize(("pipeline", "text"), [(Broken(), "ValueError: no good"), (BrokenAtStart(), "can't start")])
def test_pipeline_that_fails(path, pipeline, text):
    one = found(checked(path, clean(), pipeline=("mine", pipeline)), "PRD002")
    assert text in one.text
    assert one.severity == "error"


@pytest.mark.parametrize("error", [RunError("no GPU"), ModelError("no GPU")])
def test_failure_of_its_own_is_a_finding_in_its_own_words(path, error):
    class Failing(Echo):
        def start(self, rig, log_info):
            raise error

    assert found(checked(path, clean(), pipeline=("mine", Failing())), "PRD002").text == "mine can't start: no GPU"


def test_wrong_configuration_is_no_finding(path):
    class Wrong(Echo):
        def start(self, rig, log_info):
            raise ConfigError("--set x=1: no such sensor")

    with pytest.raises(ConfigError, match="no such sensor"):
        checked(path, clean(), pipeline=("mine", Wrong()))


def test_no_complete_frame_is_tried_all_the_same(path):
    items = [m for m in clean() if not isinstance(m, RadarScan)]
    assert ("PRD002", "") in problems(checked(path, items, pipeline=("mine", Broken())))


class Measured(Echo):
    """Notes where the radar is in each frame, and fails where it has moved."""

    def __init__(self, fails=False):
        super().__init__()
        self.radar_x_m, self._fails = {}, fails

    def step(self, frame):
        x_m = float(self.rig.mounts["radar"].translation_m[0])
        self.radar_x_m[(frame.stamp_ns - START) // (100 * MS)] = x_m
        if self._fails and x_m:
            raise ValueError("no good")
        return super().step(frame)


@pytest.mark.parametrize("fails", [False, True])
def test_frames_are_tried_with_the_rig_that_they_were_measured_with(path, fails):
    """Five items are a whole frame; the radar moves within frame 1, and is lost in all frames but 0, 3, and 4."""
    kept = changed(lost(RadarScan, {*range(20)} - {0, 3, 4}), clean())
    write_moving(path, 7, kept)
    pipeline = Measured(fails)
    result = checked(path, pipeline=("mine", pipeline))
    assert pipeline.radar_x_m == ({0: 0.0, 3: 0.1} if fails else {0: 0.0, 3: 0.1, 4: 0.1})
    if fails:
        assert found(result, "PRD002").text.startswith("mine: ValueError: no good")


def test_the_only_frame_to_try_has_the_rig_from_before_a_change(path):
    write_moving(path, 7, [m for m in clean() if not isinstance(m, RadarScan)])
    pipeline = Measured()
    checked(path, pipeline=("mine", pipeline))
    assert pipeline.radar_x_m == {0: 0.0}


def test_sensor_that_the_pipeline_cant_use(path):
    class Blind(Echo):
        def step(self, frame):
            return replace(super().step(frame), missing={"cam": "no weights"})

    one = found(checked(path, clean(), pipeline=("blind", Blind())), "CHK009")
    assert (one.source, one.text) == ("cam", "blind can't use it: no weights")
    assert one.advice == "see fbench plugins pipelines blind for what it needs, and give it with --set"


def test_a_sensor_in_hardly_any_frame_is_a_finding_with_or_without_a_pipeline(path):
    from fbench.pipelines.variants.lidar import Lidar3D
    from fbench.pipelines.variants.radar import Radar3D

    items = changed(late("radar", 500 * MS, range(20)), clean())
    for options, severity in (
        ({}, "error"), ({"pipeline": ("radar3d", Radar3D())}, "error"), ({"pipeline": ("lidar3d", Lidar3D())}, "info"),
    ):  # fmt: skip
        one = found(checked(path, items, **options), "FRM001")
        assert (one.source, one.severity) == ("radar", severity)
        # It comes 502 ms after its stamp, the LiDAR 10 ms, and frames wait 30 ms.
        assert one.text == (
            "is in 0 of 20 frames, although 20 messages of it came: 20 frames were released 462.0 ms too soon for it"
        )
        assert one.advice == "--timeout-ms 492 would wait for all of them"
    waiting = checked(path, items, sync=SyncParams(timeout_ns=492 * MS))
    assert (waiting.frames.num_complete, problems(waiting)) == (20, [("TIM009", "radar")])


def test_a_shifted_clock_is_a_finding(path):
    items = changed(lambda m: replace(m, stamp_ns=m.stamp_ns - 7000 * MS) if isinstance(m, RadarScan) else m, clean())
    one = found(checked(path, items), "FRM001")
    assert "they are stamped 7000.0 ms before the frames' instants" in one.text
    assert one.advice == "if its clock is shifted, give --offset radar=7000"


def test_poses_are_in_frames_or_between_them(path):
    items = [m for m in clean() if getattr(m, "sensor", "") != "gnss" or m.stamp_ns == START]
    assert problems(checked(path, items)) == []
