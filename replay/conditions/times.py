"""Conditions of time and transport: messages that are lost, late, restamped or repeated, payloads unchanged."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.rig import Kind


class _Times:
    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("camera", "lidar", "radar")
    changes_times: ClassVar[bool] = True


class Dropout(_Times):
    """The sensor is silent once, for a while: a window drawn evenly from the log's length. With a window of one's own,
    as in `dropout.radar@5s-8s`, give severity 5 to cover it whole where it is shorter than 5 s.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"silent_s": (0.2, 0.5, 1.0, 2.0, 5.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Drop messages within the window."""
        silent_ns = round(level["silent_s"] * 1e9)
        room_ns = max(0, site.last_ns - site.first_ns - silent_ns)
        begin_ns = site.first_ns + round(float(site.rng("window").random()) * room_ns)
        return () if begin_ns <= message.log_ns < begin_ns + silent_ns else (message,)


class Loss(_Times):
    """Each message is lost with a probability, whatever became of others."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.05, 0.1, 0.2, 0.4, 0.6)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Drop the message, or don't."""
        return () if site.rng_of(message).random() < level["lost_share"] else (message,)


class Delay(_Times):
    """Messages arrive late; their stamps stay."""

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"delay_ms": (20.0, 50.0, 100.0, 200.0, 500.0)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Deliver the message later."""
        return (replace(message, log_ns=message.log_ns + round(level["delay_ms"] * 1e6)),)
