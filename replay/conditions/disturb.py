"""Disturbing a log while it plays: a reader whose messages went through conditions."""

import heapq
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, islice
from typing import TypeAlias, TypeVar

from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.steps import Deferred, Step, apply_all, guard_condition, site_level
from fbench.replay.contracts.conditions import (
    MAX_HISTORY,
    DisturbsRig,
    MakesWeather,
    Measurement,
    Part,
    Site,
    needs_of,
)  # fmt: skip
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.contracts.protocols import Reader, ReaderWrapper
from fbench.replay.contracts.sensor_settings import choose_sensors
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, Tick
from fbench.replay.data.rig import KINDS, LogSpan, Rig, RigChange

Event: TypeAlias = Message | RigChange | Tick

S = TypeVar("S")
T = TypeVar("T")
_TRUTH_NS = 50_000_000  # Truth is of a message's instant up to this far away
_CLOUD_NS = 300_000_000
_AT_ONCE = 64  # Messages of one log time that are held at most


@dataclass(frozen=True, eq=False)
class Disturbance:
    """What disturbs a replay; without parts nothing does."""

    parts: Sequence[Part] = ()
    seed: int = 0
    span: LogSpan = field(default_factory=lambda: LogSpan(0, 0))

    def __bool__(self) -> bool:
        return bool(self.parts)

    def rig(self, rig: Rig, log_id: str) -> Rig:
        """Return the rig that a pipeline is given. Raises RunError where a condition fails, LogError where it can't
        act on a sensor.
        """
        result = rig
        for part in self.parts:
            if isinstance(part.condition, DisturbsRig):
                for sensor in _sensors_of(part, rig):
                    site = make_site(self, Step((part,)), log_id, rig, sensor)
                    with guard_condition(part.name):
                        result = part.condition.disturb_rig(result, site_level(part), site)
        return result

    def require_fits(self, rig: Rig) -> None:
        """Refuse what can't act on a log. Raises ConfigError where no sensor is in a part's scope, or its window lies
        outside of the log. Raises LogError where the rig lacks what a condition needs.
        """
        length_ns = self.span.last_ns - self.span.first_ns
        for part in self.parts:
            sensors, needs = _sensors_of(part, rig), needs_of(part.condition)
            if not sensors:
                there = ", ".join(rig.sensors("camera", "lidar", "radar"))
                raise ConfigError(f"--condition {part}: the log has no such sensor; it has: {there}", "CFG001")
            if part.from_ns is not None and part.from_ns > length_ns:
                lasts = f"the log, which lasts {length_ns / 1e9:.3f} s"
                raise ConfigError(f"--condition {part}: the window begins after {lasts}")
            if isinstance(part.condition, DisturbsRig) and (part.from_ns, part.to_ns) != (None, None):
                raise ConfigError(
                    f"--condition {part}: a wrong calibration holds for the whole log; leave out the window"
                )
            if "calibration" in needs and (bare := sorted(set(sensors) - set(rig.cameras))):
                raise LogError(f"condition {part} can't act: {', '.join(bare)} has no calibration", "COR002")
            if "cloud" in needs and not rig.sensors("lidar"):
                raise LogError(f"condition {part} can't act: the log has no LiDAR", "COR002")

    def steps(self, rig: Rig) -> dict[str, list[Step]]:
        """What acts on the messages of each sensor, in order: weathers of one scope and window as one."""
        found: dict[str, list[Step]] = {}
        for part in self.parts:
            for sensor in _sensors_of(part, rig):
                own = found.setdefault(sensor, [])
                last = own[-1] if own else None
                is_same = last is not None and last.is_weather and isinstance(part.condition, MakesWeather)
                if is_same and last is not None and last.window == (part.from_ns, part.to_ns):
                    own[-1] = Step((*last.parts, part))
                else:
                    own.append(Step((part,)))
        return found


def _sensors_of(part: Part, rig: Rig) -> tuple[str, ...]:
    """Names of the sensors that a part disturbs."""
    kinds = [KINDS[part.sensors]] if part.sensors in KINDS else list(part.condition.kinds)
    names = rig.sensors(*(kind for kind in kinds if kind in part.condition.kinds))
    if not part.sensors or part.sensors in KINDS:
        return names
    try:
        return choose_sensors(names, [part.sensors])
    except ConfigError:
        return ()


def make_site(disturbance: Disturbance, step: Step, log_id: str, rig: Rig, sensor: str) -> Site:
    """Return what a condition knows of a sensor before any message."""
    span, (from_ns, to_ns) = disturbance.span, step.window
    period_ns = span.period_ns.get(sensor, Site.period_ns)
    first_ns = span.first_ns + (from_ns or 0)
    last_ns = span.last_ns if to_ns is None else min(span.last_ns, span.first_ns + to_ns)
    key = (disturbance.seed, step.id, log_id, sensor)
    return Site(key, rig, sensor, rig.kinds[sensor], first_ns, last_ns, period_ns)


class DisturbedReader(ReaderWrapper):
    """A log under conditions.

    Messages come in canonical order of when they are delivered. Where conditions change times, each message of the
    sensor is preceded by a `Tick` as it was recorded, so that frames keep their instants. Truth, poses and the rig
    stay as they are. Messages of sensors that aren't used come as recorded, unless conditions change their times.
    Raises ConfigError and LogError as `Disturbance.require_fits` does.
    """

    def __init__(
        self, reader: Reader, disturbance: Disturbance, effects: Effects,
        is_used: Callable[[str], bool] = lambda sensor: True,
    ) -> None:  # fmt: skip
        super().__init__(reader)
        self._disturbance, self._effects, self._is_used = disturbance, effects, is_used
        disturbance.require_fits(reader.rig)

    def pass_on(self, messages: Iterator[Event]) -> Iterator[Event]:
        """Yield all messages as they are delivered."""
        for item in self.defer(messages):
            if isinstance(item, Deferred):
                yield item.take(self._effects, is_used=self._is_used(item.recorded.sensor))
            else:
                yield item

    def defer(self, messages: Iterator[Event]) -> Iterator[Event | Deferred]:
        """Yield all messages as they are delivered, those that only change what they hold before they are changed."""
        disturber = Disturber(self._reader, self._disturbance, self._effects)
        known = disturber.look_ahead(messages, lambda item: item.log_ns, lambda item: item)
        return in_order_of_delivery(known, disturber.defer, lambda item: item.log_ns)


def in_order_of_delivery(
    recorded: Iterable[S], disturb: Callable[[S], Iterable[T]], log_ns: Callable[[S | T], int]
) -> Iterator[T]:
    """Yield what becomes of items, which come in the order of their log time and are delayed at most, in that of the
    time of their delivery.
    """
    waiting: list[tuple[int, int, T]] = []
    num = 0
    for item in recorded:
        now_ns = log_ns(item)
        for result in disturb(item):
            heapq.heappush(waiting, (max(log_ns(result), now_ns), num, result))
            num += 1
        while waiting and waiting[0][0] <= now_ns:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


class Disturber:
    """Disturbs the messages of a log one by one, and remembers what conditions may know of earlier ones. Raises
    LogError where a condition needs truth that the log lacks.
    """

    def __init__(self, reader: Reader, disturbance: Disturbance, effects: Effects) -> None:
        self._disturbance, self._effects, self._log_id = disturbance, effects, reader.info.log_id
        self._clouds: dict[str, PointCloud] = {}
        self._set_rig(reader.rig)
        needs = {need for steps in self._steps.values() for step in steps for need in step.needs}
        self._truths = list(reader.truths()) if "truth" in needs else []
        self._require_truth("truth" in needs)
        self._stamps = [truth.stamp_ns for truth in self._truths]

    def _set_rig(self, rig: Rig) -> None:
        self._rig, self._steps = rig, self._disturbance.steps(rig)
        self._ticking = {name for name, steps in self._steps.items() if any(step.changes_times for step in steps)}
        self._history: dict[str, deque[Measurement]] = {name: deque(maxlen=MAX_HISTORY) for name in self._steps}

    def _require_truth(self, is_needed: bool) -> None:
        self._truths = [t for t in self._truths if t.boxes3d is not None and not t.in_world]
        self._truths.sort(key=lambda truth: truth.stamp_ns)
        if is_needed and not self._truths:
            names = {str(p) for p in self._disturbance.parts if "truth" in needs_of(p.condition)}
            raise LogError(f"condition {min(names)} needs 3D truth in body coordinates; the log has none", "COR002")

    def look_ahead(self, items: Iterable[T], log_ns: Callable[[T], int], content: Callable[[T], object]) -> Iterator[T]:
        """Pass items on, but keep the clouds of a log time before them: images may come first, and many datasets give
        all sensors the same time.
        """
        for _, instant in groupby(items, key=log_ns):
            while at_once := list(islice(instant, _AT_ONCE)):
                self._clouds |= {
                    cloud.sensor: cloud for cloud in map(content, at_once) if isinstance(cloud, PointCloud)
                }
                yield from at_once

    def disturb(self, recorded: Event) -> Iterator[Event]:
        """Yield what becomes of a message, with its instant before it where conditions change times."""
        for item in self.defer(recorded):
            yield item.take(self._effects) if isinstance(item, Deferred) else item

    def defer(self, recorded: Event) -> Iterator[Event | Deferred]:
        """Yield the same, before it is changed where its times stay."""
        if isinstance(recorded, RigChange):
            self._set_rig(recorded.rig)
            self._clouds = {name: c for name, c in self._clouds.items() if c.log_ns >= recorded.log_ns}  # looked ahead
        if isinstance(recorded, RigChange | Tick | Pose) or recorded.sensor not in self._steps:
            if isinstance(recorded, PointCloud):
                self._clouds[recorded.sensor] = recorded
            yield recorded
            return
        first_ns = self._disturbance.span.first_ns
        acting = [step for step in self._steps[recorded.sensor] if step.holds(recorded.log_ns, first_ns)]
        steps = [(step, self._site(step, recorded)) for step in acting]
        self._history[recorded.sensor].append(recorded)
        if isinstance(recorded, PointCloud):
            self._clouds[recorded.sensor] = recorded
        if recorded.sensor not in self._ticking:
            yield Deferred(recorded, steps)
            return
        yield Tick(recorded.sensor, recorded.stamp_ns, recorded.log_ns, recorded.frame_number)
        results, raw = apply_all(steps, recorded)
        self._effects.add(recorded, results, raw)
        yield from results

    def _site(self, step: Step, message: Measurement) -> Site:
        site = make_site(self._disturbance, step, self._log_id, self._rig, message.sensor)
        cloud = None
        if isinstance(message, Image):
            near = [c for _, c in sorted(self._clouds.items()) if abs(message.stamp_ns - c.stamp_ns) <= _CLOUD_NS]
            cloud = max(near, key=lambda c: len(c.xyz), default=None)
        history = tuple(self._history[message.sensor])
        return replace(site, history=history, cloud=cloud, truth=self._truth(message.stamp_ns))

    def _truth(self, stamp_ns: int) -> Boxes3D | None:
        at = bisect_left(self._stamps, stamp_ns)
        near = [t for t in self._truths[max(0, at - 1) : at + 1] if abs(t.stamp_ns - stamp_ns) <= _TRUTH_NS]
        return min(near, key=lambda t: abs(t.stamp_ns - stamp_ns)).boxes3d if near else None
