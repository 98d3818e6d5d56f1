"""Cameras that fail, against counts."""

import numpy as np
import pytest
from tests.replay.conditions.camera.sites import AHEAD, SIZE, edit, even, image, site
from tests.replay.fakes import FakeLog

from fbench.replay.conditions.camera.frames import CameraCrash, FrozenFrames, LostFrames
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.contracts.conditions import Part
from fbench.replay.data.images import decode, encode_jpeg
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import LogSpan, Mount, Rig

PERIOD_NS = 100_000_000


def rig_of(num):
    return Rig({f"camera{i}": Mount("camera", np.zeros(3), AHEAD) for i in range(num)}, {})


def crashed(num, severity, seed):
    rig = rig_of(num)
    return tuple(
        name
        for name in rig.sensors("camera")
        if not edit(CameraCrash(), image(even(90), name), severity, site(name, rig, seed)).any()
    )


@pytest.mark.parametrize("severity", [1, 2, 3, 4, 5])
def test_of_six_cameras_exactly_as_many_crash_as_the_severity_says(severity):
    drawn = {crashed(6, severity, seed) for seed in range(12)}
    assert {len(names) for names in drawn} == {severity}
    assert len(drawn) > 1
    assert len({name for names in drawn for name in names}) == 6


@pytest.mark.parametrize(("num", "counts"), [(1, [1, 1, 1, 1, 1]), (3, [1, 1, 2, 2, 3]), (4, [1, 1, 2, 3, 3])])
def test_of_others_the_nearest_number_and_at_least_one(num, counts):
    assert [len(crashed(num, severity, 0)) for severity in range(1, 6)] == counts


def test_a_crashed_camera_is_black_all_through_the_log():
    rig = rig_of(6)
    for name in rig.sensors("camera"):
        sums = {edit(CameraCrash(), image(even(90), name, s), 3, site(name, rig)).sum() for s in range(0, 1000, 100)}
        assert len(sums) == 1


@pytest.mark.parametrize(("severity", "share"), [(1, 0.17), (3, 0.5), (5, 0.83)])
def test_lost_frames_are_black_and_as_many_as_said(severity, share):
    black = [not edit(LostFrames(), image(even(90, (4, 4)), stamp_ns=s), severity).any() for s in range(2000)]
    assert np.mean(black) == pytest.approx(share, abs=0.035)
    pairs = np.mean([a and b for a, b in zip(black[1:], black[:-1], strict=True)])
    assert pairs == pytest.approx(share**2, abs=0.04)


def numbered(i):
    """A frame that shows its number."""
    return Image("camera0", i * PERIOD_NS, i * PERIOD_NS, encode_jpeg(even(i, (16, 16))), "jpeg", (16, 16), i)


def played(stamps, severity, rig=None, seed=0):
    """Numbers that frames show, by the number that they have."""
    level = {"frozen_share": FrozenFrames.levels["frozen_share"][severity - 1]}
    part = Part("camera.frozen", FrozenFrames(), str(severity), level)
    span = LogSpan(0, max(stamps) * PERIOD_NS, {"camera0": PERIOD_NS})
    log = FakeLog([numbered(i) for i in stamps], rig=rig_of(1))
    reader = DisturbedReader(log, Disturbance((part,), seed, span), Effects())
    messages = [m for m in reader.messages() if isinstance(m, Image)]
    assert [m.stamp_ns for m in messages] == [i * PERIOD_NS for i in stamps] == [m.log_ns for m in messages]
    assert [m.frame_number for m in messages] == list(stamps)
    return {m.frame_number: int(np.median(decode(m))) for m in messages}


@pytest.mark.parametrize(("severity", "share"), [(1, 0.1), (3, 0.5), (5, 0.9)])
def test_frozen_bursts_repeat_the_frame_before_them(severity, share):
    shown = played(range(240), severity)
    frozen = [i for i, number in shown.items() if number != i]
    assert {shown[i] for i in frozen} == {i // 4 * 4 - 1 for i in frozen}
    assert all(shown[i] == i // 4 * 4 - 1 for i in frozen)
    assert {sum(i in frozen for i in range(4 * n, 4 * n + 4)) for n in range(60)} <= {0, 4}
    assert len(frozen) / 240 == pytest.approx(share, abs=0.2)


def test_what_is_frozen_does_not_depend_on_other_frames():
    whole, part = played(range(80), 3), played(range(36, 60), 3)
    assert {i: whole[i] for i in range(40, 60)} == {i: part[i] for i in range(40, 60)}


def test_no_frame_comes_from_before_a_gap():
    shown = played([*range(8), *range(100, 108)], 5)
    assert {shown[i] for i in range(100, 104)} == {100, 101, 102, 103}
    assert min(shown[i] for i in range(104, 108)) >= 103


def test_the_first_frames_of_a_log_pass():
    given = image(even(90), "camera0")
    assert FrozenFrames().disturb(given, {"frozen_share": 1.0}, site("camera0", rig_of(1))) == (given,)
    assert given.size_wh == SIZE
