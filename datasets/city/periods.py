"""The simulation's loop: from one instant of the reference sensor to the next, in several threads."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from fbench.datasets.city.city import City
from fbench.datasets.city.measure import Surroundings, measure
from fbench.datasets.city.measured import Measured
from fbench.datasets.city.motion import EGO, BodyStates, Motion
from fbench.datasets.city.schedule import Plan, Slot, plans, time_s
from fbench.datasets.city.spec import CitySpec
from fbench.datasets.city.truth import truth_at
from fbench.replay.data import Pose, Truth

_AHEAD = 2
"""Periods under way beside the one that is awaited, so that no thread idles at its end."""


@dataclass(frozen=True, eq=False)
class Period:
    """All that belongs to one instant of the reference sensor."""

    from_ns: int
    """Nothing in it, or after it, was measured before: nothing arrives before."""
    measured: tuple[Measured, ...]
    poses: tuple[Pose, ...]
    truth: Truth
    num_lost: int


@dataclass(frozen=True, eq=False)
class _UnderWay:
    plan: Plan
    states: BodyStates
    futures: tuple[Future[Measured], ...]
    poses: tuple[Pose, ...]


def periods(spec: CitySpec, city: City, around: Surroundings, num_threads: int) -> Iterator[Period]:
    """Yield all periods of a log, whose messages are made at the same time."""
    waiting: deque[_UnderWay] = deque()
    with ThreadPoolExecutor(num_threads, "fbench-city") as pool:
        try:
            for plan in plans(spec.rig, spec.seconds, spec.seed):
                waiting.append(_begun(plan, spec, city, around, pool))
                if len(waiting) > _AHEAD:
                    yield _finished(waiting.popleft(), city, spec)
            while waiting:
                yield _finished(waiting.popleft(), city, spec)
        finally:
            pool.shutdown(cancel_futures=True)


def _begun(plan: Plan, spec: CitySpec, city: City, around: Surroundings, pool: ThreadPoolExecutor) -> _UnderWay:
    motion = city.traffic.motion(time_s(plan.from_ns), time_s(plan.to_ns))
    futures = []
    for slot in plan.slots:
        if not slot.is_lost:
            states = motion.at(time_s(slot.stamp_ns))
            futures.append(pool.submit(measure, around, states, spec.rig.specs[slot.sensor], slot))
    poses = tuple(_pose(motion, slot) for slot in plan.poses)
    return _UnderWay(plan, motion.at(time_s(plan.stamp_ns)), tuple(futures), poses)


def _finished(period: _UnderWay, city: City, spec: CitySpec) -> Period:
    plan = period.plan
    measured = tuple(future.result() for future in period.futures)
    truth = truth_at(city.caster, period.states, plan.stamp_ns, _nearest(measured, plan.stamp_ns), spec.truth_range_m)
    return Period(plan.from_ns, measured, period.poses, truth, sum(slot.is_lost for slot in plan.slots))


def _nearest(measured: tuple[Measured, ...], stamp_ns: int) -> list[Measured]:
    """Of each sensor the message nearest to an instant, the earlier one of two."""
    best: dict[str, Measured] = {}
    for one in measured:
        name = one.message.sensor
        far_ns = abs(one.message.stamp_ns - stamp_ns)
        if name not in best or far_ns < abs(best[name].message.stamp_ns - stamp_ns):
            best[name] = one
    return list(best.values())


def _pose(motion: Motion, slot: Slot) -> Pose:
    states = motion.at(time_s(slot.stamp_ns))
    half = float(states.yaw_rad[EGO]) / 2
    rotation = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
    return Pose(slot.sensor, slot.stamp_ns, slot.log_ns, states.position_m[EGO].copy(), rotation)
