"""A simulated log as a stream of messages and truth, in the order in which they arrive."""

import heapq
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from fbench.datasets.city.city import Cities, City
from fbench.datasets.city.measure import Surroundings
from fbench.datasets.city.periods import Period, periods
from fbench.datasets.city.spec import VERSION, CitySpec
from fbench.datasets.city.world.layout import Layout
from fbench.datasets.city.world.worlds import layout
from fbench.replay.data import LogInfo, Message, Rig, Truth
from fbench.replay.log_keys import REGIONS, SCENE_ID
from fbench.replay.regions import Region, regions_text


@dataclass(eq=False)
class CityRecording:
    """One simulated log; implements `fbench.replay.protocols.Recording`.

    The same spec gives the same items in any process, with any number of threads.
    """

    spec: CitySpec
    name: str
    """Of the log."""
    num_threads: int | None = None
    """Messages that are made at the same time; `None`: as many as there are processors for us."""
    cities: Cities = field(default_factory=Cities)
    """That of other drives too, where they share worlds."""
    _lines: list[str] = field(default_factory=list, init=False)

    @cached_property
    def info(self) -> LogInfo:
        """Name, id, and what the log is made from."""
        regions = regions_text([Region(p.kind, p.points_m) for p in self._plan.map.polygons])
        metadata = {**self.spec.metadata, SCENE_ID: _scene_id(self.spec), REGIONS: regions}
        return LogInfo(self.name, self.spec.log_id, metadata)

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
        around = Surroundings(
            city.caster, self._plan.map.street_lamps_m, spec.condition.weather, spec.seed, self.rig
        )  # fmt: skip
        counts: Counter[str] = Counter()
        yield from _ordered(periods(spec, city, around, self.num_threads or _num_processors()), counts)
        self._lines = [*self._head(), _world_line(city), *_count_lines(spec, counts)]

    def summary(self) -> Sequence[str]:
        """Lines that say what was simulated."""
        return self._lines or self._head()

    def _head(self) -> list[str]:
        spec = self.spec
        return [f"simulated: {spec.seconds:g} s, {spec.world}, {spec.condition.name}, seed {spec.seed}"]

    @cached_property
    def _plan(self) -> Layout:
        return layout(self.spec.world, self.spec.seed)


def _scene_id(spec: CitySpec) -> str:
    """Who drives where, and of whom truth tells; weather, light and sensors play no part in it."""
    traffic = "dense" if spec.condition.is_dense else "normal"
    length = f"{float(spec.seconds)!r} s, truth within {float(spec.truth_range_m)!r} m"
    return f"fbench city {VERSION}, {spec.world}, {traffic} traffic, seed {spec.seed}, {length}"


def _ordered(found: Iterator[Period], counts: Counter[str]) -> Iterator[Message | Truth]:
    """Put the items of all periods into the order of `log_ns`; equal ones stay in the order in which they come."""
    heap: list[tuple[int, int, Message | Truth]] = []
    num = 0
    for period in found:
        while heap and heap[0][0] < period.from_ns:
            yield heapq.heappop(heap)[2]
        _count(period, counts)
        for item in (*period.poses, *(one.message for one in period.measured), period.truth):
            heapq.heappush(heap, (item.log_ns, num, item))
            num += 1
    while heap:
        yield heapq.heappop(heap)[2]


def _count(period: Period, counts: Counter[str]) -> None:
    counts.update(one.message.sensor for one in period.measured)
    boxes3d, boxes2d = period.truth.boxes3d, period.truth.boxes2d
    counts["3d boxes"] += 0 if boxes3d is None else len(boxes3d)
    counts["2d boxes"] += 0 if boxes2d is None else len(boxes2d)
    counts["instants"] += 1
    counts["lost messages"] += period.num_lost


def _world_line(city: City) -> str:
    labels = Counter(actor.body.label for actor in city.caster.actors[1:])
    bodies = ", ".join(f"{label} {num}" for label, num in sorted(labels.items()))
    return f"world: {bodies}"


def _count_lines(spec: CitySpec, counts: Counter[str]) -> list[str]:
    messages = ", ".join(f"{name} {counts[name]}" for name in spec.rig.names)
    lost = f" ({counts['lost messages']} lost)" if counts["lost messages"] else ""
    images = f", {counts['2d boxes']} in images" if spec.rig.cameras else ""
    return [
        f"messages: {messages}{lost}",
        f"truth: {counts['3d boxes']} boxes at {counts['instants']} instants{images}",
    ]


def _num_processors() -> int:
    return len(os.sched_getaffinity(0))
