"""Steps of a disturbance: what one condition, or several weathers together, makes of a message."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.weather import combine
from fbench.replay.conditions.weathers import disturb_by_weather
from fbench.replay.contracts.conditions import (
    ChangesTimes,
    Level,
    MakesWeather,
    Measurement,
    Need,
    Part,
    Site,
    needs_of,
)
from fbench.replay.contracts.errors import INTERRUPTS, FbenchError, LogError, RunError, one_line
from fbench.replay.data.arrays import own_arrays
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan

RAW = "bgr8"
"""Encoding in which conditions get images."""
_MAX_NS = 1 << 62


@dataclass(frozen=True, eq=False)
class Step:
    """One condition, or several weathers together."""

    parts: tuple[Part, ...]

    @property
    def is_weather(self) -> bool:
        """Whether it is weather."""
        return isinstance(self.parts[0].condition, MakesWeather)

    @property
    def window(self) -> tuple[int | None, int | None]:
        """When it acts [ns] after the log's first message."""
        return self.parts[0].from_ns, self.parts[0].to_ns

    @property
    def id(self) -> str:
        """What random numbers depend on."""
        return "+".join(part.id for part in self.parts)

    @property
    def needs(self) -> set[Need]:
        """What its parts need."""
        return {need for part in self.parts for need in needs_of(part.condition)}

    @property
    def changes_times(self) -> bool:
        """Whether it drops, delays or restamps messages."""
        return any(isinstance(p.condition, ChangesTimes) and p.condition.changes_times for p in self.parts)

    def holds(self, log_ns: int, first_ns: int) -> bool:
        """Tell whether a message of this log time is within the window."""
        at_ns, (from_ns, to_ns) = log_ns - first_ns, self.window
        return (from_ns is None or at_ns >= from_ns) and (to_ns is None or at_ns < to_ns)

    def apply(self, message: Measurement, site: Site) -> Sequence[Measurement]:
        """Disturb a message. Raises RunError where the condition fails, or gives what it may not."""
        part = self.parts[0]
        with guard_condition(part.name):
            if self.is_weather:
                weathers = [p.condition.weather(p.level) for p in self.parts if isinstance(p.condition, MakesWeather)]
                return (disturb_by_weather(message, combine(weathers), site),)
            results = _disturb(part, message, site)
            for result in results:
                if wrong := find_wrong(message, result):
                    raise RunError(f"condition '{part.name}' {wrong}", "COR001")
            if not self.changes_times and times_of(results) != times_of([message]):
                what = "drops, repeats, delays or restamps messages, but doesn't say changes_times = True"
                raise RunError(f"condition '{part.name}' {what}", "COR001")
            return results


def _disturb(part: Part, message: Measurement, site: Site) -> tuple[Measurement, ...]:
    """Disturb a message. A plug-in gets a copy: by force it can write into what other pipelines read, too. Raises
    RunError where it did.
    """
    if type(part.condition).__module__.startswith("fbench."):
        return tuple(part.condition.disturb(message, site_level(part), site))
    given = own_arrays(message)
    results = tuple(part.condition.disturb(given, site_level(part), site))
    for name, value in vars(message).items():
        other = vars(given).get(name)
        if other is not value and not (
            isinstance(value, np.ndarray) and isinstance(other, np.ndarray) and other.tobytes() == value.tobytes()
        ):
            raise RunError(f"condition '{part.name}' changed '{name}' of the message that it was given", "COR001")
    return tuple(message if result is given else result for result in results)


def times_of(messages: Sequence[Measurement]) -> list[tuple[int, int, int | None]]:
    """Return the stamp, time of delivery and frame number of each message."""
    return [(message.stamp_ns, message.log_ns, message.frame_number) for message in messages]


def find_wrong(message: Measurement, result: object) -> str:
    """Say why a condition may not give a result for a message; empty where it may."""
    if type(result) is not type(message):
        return f"gave {type(result).__name__} for {type(message).__name__}"
    if result.sensor != message.sensor:
        return f"gave a message of '{result.sensor}' for one of '{message.sensor}'"
    if result.log_ns < message.log_ns:
        return f"delivered a message {(message.log_ns - result.log_ns) / 1e6:g} ms before it was recorded"
    if not max(abs(result.stamp_ns), result.log_ns) < _MAX_NS:
        return "set a time beyond the year 2116, more than frames can hold"
    if isinstance(result, Image) and isinstance(message, Image) and result.size_wh != message.size_wh:
        return f"gave an image of {result.size_wh} px for one of {message.size_wh}"
    return ""


def site_level(part: Part) -> Level:
    """Return the numbers of a part, which its condition can't change."""
    return MappingProxyType(dict(part.level))


@contextmanager
def guard_condition(name: str) -> Iterator[None]:
    """Tell whatever a condition raises in one line, so that it never counts as clean data. Raises RunError."""
    try:
        yield
    except (FbenchError, *INTERRUPTS):
        raise
    except BaseException as error:
        raise RunError(f"condition '{name}' failed: {one_line(error)}", "COR001") from error


class Deferred:
    """A message that conditions change once somebody needs it: when that is computed doesn't matter, since they depend
    on nothing but what was known at its place. Neither its times nor that it comes change.
    """

    def __init__(self, recorded: Measurement, steps: Sequence[tuple[Step, Site]]) -> None:
        self.recorded, self._steps = recorded, steps
        self.result: Measurement | None = None  # Once it was computed, until it is forgotten
        self._counts: Mapping[str, float] = {}

    @property
    def log_ns(self) -> int:
        """When it was recorded, and is delivered."""
        return self.recorded.log_ns

    def take(self, effects: Effects, *, is_used: bool = True) -> Measurement:
        """Return what becomes of the message; itself where its content isn't used, so that it costs nothing. Raises
        LogError and RunError as conditions do, also on what isn't used where it lacks what they need.
        """
        if not is_used:
            for step, _ in self._steps:
                _require_needs(step, self.recorded)
            effects.count(self.recorded.sensor, {"messages": 1, "unused": 1})
            return self.recorded
        if self.result is None:
            (self.result,), raw = apply_all(self._steps, self.recorded)
            self._counts = effects.measure(self.recorded, [self.result], raw)
        effects.count(self.recorded.sensor, self._counts)
        return self.result

    def forget(self) -> None:
        """Compute it anew when it is needed again."""
        self.result = None


def apply_all(steps: Sequence[tuple[Step, Site]], recorded: Measurement) -> tuple[list[Measurement], Measurement]:
    """Return what becomes of a message, and the message itself as conditions got it: images are decoded for them."""
    raw, results = recorded, [recorded]
    for step, site in steps:
        if isinstance(recorded, Image) and not step.changes_times:
            raw = _decode(raw)
            results = [raw if result is recorded else _decode(result) for result in results]
        results = [item for result in results for item in _apply(step, result, site)]
    return [recorded if result is raw else result for result in results], raw


def _decode(message: Measurement) -> Measurement:
    """Return an image as raw BGR, or as it is where it can't be decoded."""
    if not isinstance(message, Image) or message.encoding == RAW or (pixels := decode(message)) is None:
        return message
    return replace(message, data=pixels.tobytes(), encoding=RAW, video=None)


def _apply(step: Step, message: Measurement, site: Site) -> Sequence[Measurement]:
    """Disturb a message, unless it is an image that can't be decoded. Raises LogError where the message lacks what the
    condition needs.
    """
    _require_needs(step, message)
    is_damaged = isinstance(message, Image) and message.encoding != RAW and not step.changes_times
    return (message,) if is_damaged else step.apply(message, site)


def _require_needs(step: Step, message: Measurement) -> None:
    lacking = [need for need in sorted(step.needs) if not _has(message, need)]
    if lacking:
        what = f"'{message.sensor}' has no {', '.join(lacking)}"
        raise LogError(f"condition {step.parts[0]} can't act: {what}", "COR002")


def _has(message: Measurement, need: Need) -> bool:
    """Tell whether a message has what a condition needs; what a log must have is found out elsewhere."""
    match message, need:
        case PointCloud(), "ring":
            return message.ring is not None
        case PointCloud(), "intensity":
            return message.intensity is not None
        case PointCloud(), "time":
            return message.offset_ns is not None
        case RadarScan(), "velocity":
            return message.radial_velocity_mps is not None
        case RadarScan(), "rcs":
            return message.rcs_dbsm is not None
        case _:
            return True
