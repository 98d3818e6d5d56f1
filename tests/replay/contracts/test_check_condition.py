"""`check_condition` refuses what breaks the promise of conditions, each in the way of a known tool or a likely slip."""

import random
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.street import PERIOD_NS
from fbench.replay.contracts.testing import check_condition
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud


class Rise:
    """Lifts clouds: keeps all promises."""

    version, kinds = 1, ("lidar",)
    levels: ClassVar[Mapping[str, tuple[float, ...]]] = {"lifted_m": (1.0, 2.0, 3.0, 4.0, 5.0)}

    def disturb(self, message, level, site):
        return (replace(message, xyz=message.xyz + np.float32([0, 0, self.amount(level, message, site)])),)

    def amount(self, level, message, site):
        return level["lifted_m"]


class Constant(Rise):
    version, levels = 1, {"lifted_m": (0.0,) * 5}


class WeakAtFirst(Rise):
    """An index that is one too low: severity 1 is none."""

    version, levels = 1, {"lifted_m": (0.0, 1.0, 2.0, 3.0, 4.0)}


class Falling(Rise):
    """Like published severities of which the second is weaker than the first."""

    version, levels = 1, {"lifted_m": (3.0, 2.0, 4.0, 5.0, 6.0)}


class Four(Rise):
    version, levels = 1, {"lifted_m": (1.0, 2.0, 3.0, 4.0)}


class Stream(Rise):
    """Draws on from message to message."""

    def __init__(self):
        self.rng = np.random.default_rng(0)

    def amount(self, level, message, site):
        return level["lifted_m"] * self.rng.random()


class ProcessStream(Rise):
    """The same, of a generator that the whole process shares."""

    def amount(self, level, message, site):
        return level["lifted_m"] * random.random()


class Remembers(Rise):
    """Takes the message before."""

    last = 0

    def amount(self, level, message, site):
        since, self.last = message.stamp_ns - self.last, message.stamp_ns
        return level["lifted_m"] * (1 + since % 7)


class Writes(Rise):
    def disturb(self, message, level, site):
        message.xyz[0] += np.float32(level["lifted_m"])
        return (message,)


class Undefined(Rise):
    def amount(self, level, message, site):
        return np.nan


class Early(Rise):
    def disturb(self, message, level, site):
        return (replace(message, log_ns=message.log_ns - 1),)


class Drops(Rise):
    def disturb(self, message, level, site):
        return ()


class Late(Rise):
    levels, changes_times = {"late_s": (1.0, 2.0, 3.0, 4.0, 5.0)}, True

    def disturb(self, message, level, site):
        return (replace(message, log_ns=message.log_ns + round(level["late_s"]) * PERIOD_NS),)


class Another(Rise):
    def disturb(self, message, level, site):
        return (PointCloud("other", message.stamp_ns, message.log_ns, message.xyz),)


class Boxes(Rise):
    def disturb(self, message, level, site):
        return (Boxes3D.empty(),)


class Fails(Rise):
    def disturb(self, message, level, site):
        raise IndexError("level 5")


class RigAtRandom(Rise):
    def disturb_rig(self, rig, level, site):
        mount = replace(rig.mounts["lidar"], translation_m=np.full(3, random.random()))
        return replace(rig, mounts={**rig.mounts, "lidar": mount})


@pytest.mark.parametrize("condition", [Rise, Late])
def test_what_keeps_the_promise_passes(condition):
    check_condition(condition, num_messages=3)


@pytest.mark.parametrize(
    ("condition", "words"),
    [
        (Constant, "changes nothing at any severity"),
        (WeakAtFirst, "changes nothing of a lidar at severity 1"),
        (Falling, "changes no more of a lidar at higher severities"),
        (Stream, "gives another result after other messages"),
        (ProcessStream, "gives another result after other messages"),
        (Remembers, "gives another result after other messages"),
        (Writes, "fails: ValueError: output array is read-only"),
        (Undefined, "gives numbers that aren't finite"),
        (Early, "before it was recorded"),
        (Drops, "changes times, but doesn't say changes_times = True"),
        (Another, "gave a message of 'other' for one of 'lidar'"),
        (Boxes, "gave Boxes3D for PointCloud"),
        (Fails, "lidar at 1700000000000000000: fails: IndexError: level 5"),
        (RigAtRandom, "gives another rig the second time"),
    ],
)
def test_what_breaks_it_is_refused(condition, words):
    with pytest.raises(AssertionError) as found:
        check_condition(condition, num_messages=3)
    assert words in str(found.value)


def test_levels_are_five_numbers():
    with pytest.raises(ConfigError, match="expected 5 numbers"):
        check_condition(Four, num_messages=3)
