"""Conditions of time and transport: messages that are lost, late, restamped or repeated, payloads unchanged.

Numbers are those of fbench, after Dong et al. (CVPR 2023), MultiCorrupt (2024) and Yu et al. (2022) where they have
some. What acts "once" does so within the window of the condition, else within the log.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import ClassVar

import numpy as np

from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.arrays import Bool
from fbench.replay.data.rig import Kind

_BLOCK = 512  # Slots over which the state of a channel is drawn at once
_BURST = 4.0  # Mean length of a burst, in messages


class _Times:
    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("camera", "lidar", "radar")
    changes_times: ClassVar[bool] = True


class Dropout(_Times):
    """The sensor is silent once, for a while: from a moment that is drawn evenly, so that the silence ends in time."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"silent_s": (0.2, 0.5, 1.0, 2.0, 5.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Drop messages within the silence."""
        silent_ns = round(level["silent_s"] * 1e9)
        room_ns = max(0, site.last_ns - site.first_ns - silent_ns)
        begin_ns = site.first_ns + round(float(site.rng("begin").random()) * room_ns)
        return () if begin_ns <= message.log_ns < begin_ns + silent_ns else (message,)


class Loss(_Times):
    """Each message is lost with a probability, whatever became of others.

    Levels: .2, .4, .6 as MultiCorrupt (2024).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.05, 0.1, 0.2, 0.4, 0.6)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Drop the message, or don't."""
        return () if site.rng_of(message).random() < level["lost_share"] else (message,)


class BurstLoss(_Times):
    """Messages are lost in bursts of 4 on average: the channel is good or bad, and all is lost while it is bad.

    Gilbert's chain of two states (1960), a step each period of the sensor: bad becomes good with probability
    q = 1/4, good becomes bad with q s / (1 - s), so that a share s of all steps is bad. Chains begin anew every 512
    steps, with that share, so that the state at a moment doesn't depend on all before it.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.05, 0.1, 0.2, 0.4, 0.6)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Drop messages while the channel is bad."""
        block, slot = divmod(max(0, message.log_ns - site.first_ns) // max(1, site.period_ns), _BLOCK)
        share = level["lost_share"]
        if not 0 < share < 1:
            return () if share >= 1 else (message,)
        return () if _bad_slots(site.key, int(block), share)[slot] else (message,)


@lru_cache(64)
def _bad_slots(key: tuple[str | int, ...], block: int, share: float) -> Bool:
    """In which of its steps (512,) a channel is bad; kept, because the messages of a block ask for the same."""
    rng = generator(int(key[0]), *key[1:], "channel", block)
    begins_bad = rng.random() < share
    to_good = 1 / _BURST
    to_bad = min(1.0, to_good * share / (1 - share))
    # Stays in a state are geometric; of each pair the first is in the state that the chain begins with.
    stays = rng.geometric([to_good, to_bad] if begins_bad else [to_bad, to_good], (_BLOCK, 2))
    num_changes = np.searchsorted(np.cumsum(stays), np.arange(_BLOCK), side="right")
    return np.asarray(begins_bad == (num_changes % 2 == 0))


class Delay(_Times):
    """Messages arrive late; their stamps stay."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"delay_ms": (20.0, 50.0, 100.0, 200.0, 500.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Deliver the message later."""
        return (_deliver(message, round(level["delay_ms"] * 1e6)),)


class Jitter(_Times):
    """Each message arrives late by |N(0, sigma)|, a half-normal time; their order may change, their stamps stay."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"sigma_ms": (1.0, 2.0, 5.0, 10.0, 20.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Deliver the message later."""
        late_ms = abs(float(site.rng_of(message).standard_normal())) * level["sigma_ms"]
        return (_deliver(message, round(late_ms * 1e6)),)


class Duplicate(_Times):
    """A share of the messages arrives twice, with the same stamp: the second time up to one period later."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"repeated_share": (0.01, 0.02, 0.05, 0.1, 0.2)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Repeat the message, or don't."""
        rng = site.rng_of(message)
        if rng.random() >= level["repeated_share"]:
            return (message,)
        return (message, _deliver(message, round(float(rng.random()) * site.period_ns)))


class Reorder(_Times):
    """Messages are overtaken by later ones of their sensor: each arrives late by k + 1/2 periods, k drawn evenly from 1
    to the level's number, or in time where k is 0, which is drawn as often. Their stamps stay.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"overtaking": (1.0, 2.0, 4.0, 8.0, 16.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Deliver the message later, or don't."""
        num = int(site.rng_of(message).integers(0, int(level["overtaking"]) + 1))
        return (_deliver(message, num * site.period_ns + site.period_ns // 2 if num else 0),)


class Offset(_Times):
    """Stamps are later than the measurement by a constant; times of delivery stay.

    Levels: 2 to 10 frames in Dong et al. (CVPR 2023), up to 200 ms here.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"offset_ms": (10.0, 20.0, 50.0, 100.0, 200.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Move the stamp."""
        return (_restamp(message, round(level["offset_ms"] * 1e6)),)


class Drift(_Times):
    """The sensor's clock runs fast by parts per million, from the first message on: stamps are ever later than the
    measurement.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"fast_ppm": (10.0, 50.0, 100.0, 500.0, 1000.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Move the stamp."""
        elapsed_ns = message.log_ns - site.first_ns
        return (_restamp(message, elapsed_ns * round(level["fast_ppm"] * 1000) // 10**9),)


class ClockJump(_Times):
    """The sensor's clock is set forward once, at a moment drawn evenly from the middle half; it stays ahead."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"jump_s": (0.1, 0.5, 1.0, 5.0, 60.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Move the stamps after the jump."""
        share = 0.25 + 0.5 * float(site.rng("moment").random())
        moment_ns = site.first_ns + round(share * (site.last_ns - site.first_ns))
        return (_restamp(message, round(level["jump_s"] * 1e9) if message.log_ns >= moment_ns else 0),)


def _deliver(message: Measurement, late_ns: int) -> Measurement:
    return replace(message, log_ns=message.log_ns + late_ns) if late_ns else message


def _restamp(message: Measurement, ahead_ns: int) -> Measurement:
    return replace(message, stamp_ns=message.stamp_ns + ahead_ns) if ahead_ns else message
