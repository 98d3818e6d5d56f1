"""A simulated log as a stream of messages and truth, in the order in which they arrive."""

import heapq
import os
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from fbench.datasets.city.instant import EGO, BodyStates
from fbench.datasets.city.measure import Measured, Plan, Slot, Surroundings, measure, plans, time_s, truth_at
from fbench.datasets.city.rays.caster import EmbreeCaster
from fbench.datasets.city.scenery.scenery import scenery
from fbench.datasets.city.spec import VERSION, CitySpec, WorldName
from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Motion, Traffic
from fbench.datasets.city.world.city_map import Layout
from fbench.datasets.city.world.urban import layout
from fbench.replay.data.messages import Message, Pose, Truth
from fbench.replay.data.metadata import REGIONS, SCENE_ID, Region, regions_text
from fbench.replay.data.rig import LogInfo, Rig

_NUM_KEPT = 4  # Both worlds of a seed, with normal and dense traffic


@dataclass(frozen=True, eq=False)
class City:
    """A world and the traffic that goes on in it."""

    layout: Layout
    caster: EmbreeCaster
    traffic: Traffic


class Cities:
    """Keeps the last few cities: weathers of one scene share one, and a city takes seconds to build."""

    def __init__(self) -> None:
        self._kept: dict[tuple[WorldName, bool, int], City] = {}

    def of(self, spec: CitySpec) -> City:
        """Return the city of a drive, with its traffic at the beginning."""
        key = (spec.world, spec.condition.is_dense, spec.seed)
        if key not in self._kept:
            if len(self._kept) == _NUM_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = build_city(layout(spec.world, spec.seed), *key)
        city = self._kept[key]
        return replace(city, traffic=city.traffic.rewind())


def build_city(plan: Layout, world: WorldName, is_dense: bool, seed: int) -> City:
    """Build the world of a plan with all who move in it; weather, sensors and length play no part in it."""
    traffic = Traffic(plan, TrafficParams.of(world, "dense" if is_dense else "normal"), seed)
    return City(plan, EmbreeCaster(scenery(plan, seed), traffic.actors), traffic)


_AHEAD = 2  # Periods under way beside the one that is awaited, so that no thread idles at its end


@dataclass(frozen=True, eq=False)
class Period:
    """All that belongs to one instant of the reference sensor."""

    from_ns: int  # Nothing in it, or after it, was measured before: nothing arrives before
    measured: tuple[Measured, ...]
    poses: tuple[Pose, ...]
    truth: Truth
    num_lost: int


@dataclass(frozen=True, eq=False)
class _PeriodUnderWay:
    plan: Plan
    states: BodyStates
    futures: list[Future[Measured]]
    poses: tuple[Pose, ...]


def periods(spec: CitySpec, city: City, around: Surroundings, num_threads: int) -> Iterator[Period]:
    """Yield all periods of a log, whose messages are made at the same time."""
    waiting: deque[_PeriodUnderWay] = deque()
    with ThreadPoolExecutor(num_threads, "fbench-city") as pool:
        try:
            for plan in plans(spec.rig, spec.seconds, spec.seed):
                motion = city.traffic.motion(time_s(plan.from_ns), time_s(plan.to_ns))
                futures = [
                    pool.submit(measure, around, motion.at(time_s(slot.stamp_ns)), spec.rig.specs[slot.sensor], slot)
                    for slot in plan.slots if not slot.is_lost
                ]  # fmt: skip
                poses = tuple(_pose(motion, slot) for slot in plan.poses)
                waiting.append(_PeriodUnderWay(plan, motion.at(time_s(plan.stamp_ns)), futures, poses))
                if len(waiting) > _AHEAD:
                    yield _finish(waiting.popleft(), city, spec)
            while waiting:
                yield _finish(waiting.popleft(), city, spec)
        finally:
            pool.shutdown(cancel_futures=True)


def _finish(period: _PeriodUnderWay, city: City, spec: CitySpec) -> Period:
    plan, nearest = period.plan, dict[str, Measured]()
    measured = tuple(future.result() for future in period.futures)

    def far_ns(one: Measured) -> int:
        return abs(one.message.stamp_ns - plan.stamp_ns)

    for one in measured:  # of each sensor the nearest to the instant, the earlier one of two
        name = one.message.sensor
        if name not in nearest or far_ns(one) < far_ns(nearest[name]):
            nearest[name] = one
    truth = truth_at(city.caster, period.states, plan.stamp_ns, list(nearest.values()), spec.truth_range_m)
    return Period(plan.from_ns, measured, period.poses, truth, sum(slot.is_lost for slot in plan.slots))


def _pose(motion: Motion, slot: Slot) -> Pose:
    states = motion.at(time_s(slot.stamp_ns))
    half = float(states.yaw_rad[EGO]) / 2
    rotation = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
    return Pose(slot.sensor, slot.stamp_ns, slot.log_ns, states.position_m[EGO].copy(), rotation)


@dataclass(eq=False)
class CityRecording:
    """One simulated log; implements `fbench.replay.contracts.protocols.Recording`. The same spec gives the same items
    in any process, with any number of threads.
    """

    spec: CitySpec
    name: str  # Of the log
    num_threads: int | None = None
    """Messages that are made at the same time; `None`: as many as there are processors for us."""
    cities: Cities = field(default_factory=Cities)  # That of other drives too, where they share worlds
    _lines: list[str] = field(default_factory=list, init=False)

    @cached_property
    def info(self) -> LogInfo:
        """Name, id, and what the log is made from."""
        regions = regions_text([Region(p.kind, p.points_m) for p in self._plan.map.polygons])
        # Who drives where, and who is in the truth: weather, light and sensors play no part in the scene.
        spec, traffic = self.spec, "dense" if self.spec.condition.is_dense else "normal"
        length = f"{float(spec.seconds)!r} s, truth within {float(spec.truth_range_m)!r} m"
        scene = f"fbench city {VERSION}, {spec.world}, {traffic} traffic, seed {spec.seed}, {length}"
        return LogInfo(self.name, spec.log_id, {**spec.metadata, SCENE_ID: scene, REGIONS: regions})

    @cached_property
    def rig(self) -> Rig:
        """The sensors and their calibration."""
        return self.spec.rig.rig()

    @property
    def num_items(self) -> int:
        """About how many items there are, messages that are lost included."""
        rig = self.spec.rig
        hz = sum(spec.rate_hz for spec in rig.specs.values()) + rig.pose_rate_hz + rig.specs[rig.reference].rate_hz
        return round(self.spec.seconds * hz)

    def items(self) -> Iterator[Message | Truth]:
        """Yield poses, messages and truth in the order of `log_ns`; memory doesn't grow with the length."""
        spec = self.spec
        city = self.cities.of(spec)
        around = Surroundings(city.caster, self._plan.map.street_lamps_m, spec.condition.weather, spec.seed, self.rig)
        counts: Counter[str] = Counter()
        found = periods(spec, city, around, self.num_threads or len(os.sched_getaffinity(0)))
        yield from _sort_messages(found, counts)
        labels = Counter(actor.body.label for actor in city.caster.actors[1:])
        lost = f" ({counts['lost messages']} lost)" if counts["lost messages"] else ""
        images = f", {counts['2d boxes']} in images" if spec.rig.cameras else ""
        self._lines = [
            *self.summary()[:1],
            f"world: {', '.join(f'{label} {num}' for label, num in sorted(labels.items()))}",
            f"messages: {', '.join(f'{name} {counts[name]}' for name in spec.rig.names)}{lost}",
            f"truth: {counts['3d boxes']} boxes at {counts['instants']} instants{images}",
        ]

    def summary(self) -> Sequence[str]:
        """Lines that say what was simulated."""
        spec = self.spec
        head = f"simulated: {spec.seconds:g} s, {spec.world}, {spec.condition.name}, seed {spec.seed}"
        return self._lines or [head]

    @cached_property
    def _plan(self) -> Layout:
        return layout(self.spec.world, self.spec.seed)


def _sort_messages(found: Iterator[Period], counts: Counter[str]) -> Iterator[Message | Truth]:
    """Put the items of all periods into the order of `log_ns`; equal ones stay in the order in which they come."""
    heap: list[tuple[int, int, Message | Truth]] = []
    num = 0
    for period in found:
        while heap and heap[0][0] < period.from_ns:
            yield heapq.heappop(heap)[2]
        truth = period.truth
        counts.update(one.message.sensor for one in period.measured)
        counts["3d boxes"] += 0 if truth.boxes3d is None else len(truth.boxes3d)
        counts["2d boxes"] += 0 if truth.boxes2d is None else len(truth.boxes2d)
        counts["instants"] += 1
        counts["lost messages"] += period.num_lost
        for item in (*period.poses, *(one.message for one in period.measured), truth):
            heapq.heappush(heap, (item.log_ns, num, item))
            num += 1
    while heap:
        yield heapq.heappop(heap)[2]
