import pytest
from tests.replay.fakes import MS, RIG, UPRIGHT, Echo, FakeLog, cloud, drive, scan

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.sensor_settings import choose_sensors, make_sensors
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output
from fbench.replay.data.rig import Mount, Rig, RigChange
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.runs.folder import Run

NAMES = ("front_left", "front_right", "rear", "sensing/lidar/top", "cam[0]")


@pytest.mark.parametrize(
    ("patterns", "expected"),
    [
        ([], sorted(NAMES)),
        (["front*"], ["front_left", "front_right"]),
        (["front_left", "rear"], ["front_left", "rear"]),
        (["!front*"], ["cam[0]", "rear", "sensing/lidar/top"]),
        (["front*", "!*right"], ["front_left"]),
        (["sensing/*"], ["sensing/lidar/top"]),
        (["cam[0]"], ["cam[0]"]),
        (["!front_?ight"], ["cam[0]", "front_left", "rear", "sensing/lidar/top"]),
    ],
)
def test_patterns(patterns, expected):
    assert list(choose_sensors(NAMES, patterns)) == expected


@pytest.mark.parametrize(
    ("patterns", "message"),
    [
        (["frnt_left"], "--sensors frnt_left: fits no sensor; did you mean 'front_left'?"),
        (["!raer"], "--sensors !raer: fits no sensor; did you mean 'rear'?"),
        (["rear", "x*"], "--sensors x*: fits no sensor"),
        (["rear", "!re*"], "--sensors rear,!re*: leaves no sensor; there are: cam[0], front_left"),
    ],
)
def test_patterns_that_choose_nothing(patterns, message):
    with pytest.raises(ConfigError) as error:
        choose_sensors(NAMES, patterns)
    assert str(error.value).startswith(message)


def test_option_is_repeatable_and_takes_commas():
    assert make_sensors(["front*, rear", "!front_left"]) == ["front*", "rear", "!front_left"]
    assert make_sensors([]) == []
    for text in ("", "front,,rear", "!"):
        with pytest.raises(ConfigError, match="a pattern is empty"):
            make_sensors([text])


class Noting:
    """Finds nothing, and remembers what it got."""

    def __init__(self):
        self.rigs, self.frames = [], []

    def start(self, rig, log_info):
        self.rigs.append(tuple(rig.mounts))

    def reset(self, reason):
        pass

    def step(self, frame):
        self.frames.append((frame.index, frame.stamp_ns, tuple(frame.messages), tuple(frame.missing)))
        return Output(Boxes3D.empty(), Boxes3D.empty(), {})


def play(log, folder, *sensors, **plan):
    pipeline, faults = Noting(), FaultLog()
    run = Run(replay(log, Plan(pipeline, "p", sensors=sensors, **plan), folder, faults))
    return run, pipeline, faults


def test_other_sensors_are_neither_waited_for_nor_given(tmp_path):
    whole, _, _ = play(drive(5), tmp_path / "whole")
    run, pipeline, _ = play(drive(5), tmp_path / "part", "!radar")
    assert pipeline.rigs == [("lidar",)]
    assert pipeline.frames == [(i, 100 * MS * i, ("lidar",), ()) for i in range(5)]
    assert run.manifest.log.digest == whole.manifest.log.digest
    assert run.manifest.frames.sensors == ["!radar"]
    assert whole.manifest.frames.sensors == []
    assert sorted(run.manifest.mounts) == ["lidar", "radar"]


def test_instants_are_still_those_of_a_reference_that_is_left_out(tmp_path):
    run, pipeline, _ = play(drive(5), tmp_path / "run", "radar")
    assert run.manifest.frames.reference == "lidar"
    assert pipeline.frames == [(i, 100 * MS * i, ("radar",), ()) for i in range(5)]
    assert [run.truth3d(i) is not None for i in range(5)] == [True, False, True, False, True]


def test_late_sensors_make_frames_late_only_where_they_are_chosen(tmp_path):
    log = drive(3)
    log.items[:] = [cloud(100 * MS * i, late_ns=90 * MS) if i % 2 else cloud(100 * MS * i) for i in range(3)] + [
        scan(100 * MS * i) for i in range(3)
    ]
    _, both, _ = play(log, tmp_path / "both", sync=SyncParams("radar"))
    _, alone, _ = play(log, tmp_path / "alone", "radar", sync=SyncParams("radar"))
    assert [missing for *_, missing in both.frames] == [(), ("lidar",), ()]
    assert [missing for *_, missing in alone.frames] == [(), (), ()]


def test_bad_data_of_other_sensors_are_no_faults(tmp_path):
    log = drive(3)
    log.items[1] = cloud(0, float("nan"), sensor="lidar")
    assert play(log, tmp_path / "a")[2].counts["DAT001"] == 1
    assert play(log, tmp_path / "b", "radar")[2].counts["DAT001"] == 0


class Moving(FakeLog):
    """A log whose radar is moved before its third frame."""

    def messages(self):
        moved = Rig({**RIG.mounts, "radar": Mount("radar", UPRIGHT[1:] + 1.0, UPRIGHT)}, {})
        for i, message in enumerate(super().messages()):
            if i == 4:
                yield RigChange(150 * MS, moved, ("radar",))
            yield message


def test_where_the_rig_changes_the_choice_holds(tmp_path):
    log = Moving(drive(4).items)
    run, pipeline, _ = play(log, tmp_path / "run", "lidar")
    assert pipeline.rigs == [("lidar",), ("lidar",)]
    assert [frame.segment for frame in run.frames] == [0, 0, 1, 1]


def test_unknown_sensors_are_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"--sensors lidr: fits no sensor; did you mean 'lidar'\?"):
        replay(drive(2), Plan(Echo(), "p", sensors=["lidr"]), tmp_path / "run", FaultLog())
