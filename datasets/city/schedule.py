"""When sensors measure, when their messages arrive, and which never do."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain

from fbench.datasets.city.rig import POSE, RigSpec, SensorSpec
from fbench.replay.draws import generator

START_NS = 1_700_000_000_000_000_000
"""Stamp of a log's beginning."""
LEAD_S = 1.0
"""So long the traffic runs before, so that a sensor's turn that ends at the beginning has begun in it."""
_POSE_LATENCY_NS = 1_000_000


@dataclass(frozen=True)
class Slot:
    """One message to be made."""

    sensor: str
    stamp_ns: int
    log_ns: int
    is_lost: bool = False


@dataclass(frozen=True)
class Plan:
    """All that is measured around one instant of the reference sensor, half way to the instants before and after it."""

    stamp_ns: int
    """The instant."""
    from_ns: int
    to_ns: int
    slots: tuple[Slot, ...]
    """By sensor, then by stamp."""
    poses: tuple[Slot, ...]


def time_s(stamp_ns: int) -> float:
    """Time of the traffic simulation at a stamp."""
    return (stamp_ns - START_NS) / 1e9 + LEAD_S


def plans(rig: RigSpec, seconds: float, seed: int) -> Iterator[Plan]:
    """Yield what is measured in a log of `seconds`, instant by instant."""
    end_ns = START_NS + round(seconds * 1e9)
    reference = rig.specs[rig.reference]
    from_ns = START_NS
    last_ns: int | None = None
    for stamp_ns in chain(_stamps(reference.rate_hz, reference.phase_ms, START_NS, end_ns), [end_ns]):
        if last_ns is not None:
            to_ns = (last_ns + stamp_ns) // 2 if stamp_ns < end_ns else end_ns
            yield _plan(rig, seed, last_ns, from_ns, to_ns)
            from_ns = to_ns
        last_ns = stamp_ns


def _plan(rig: RigSpec, seed: int, stamp_ns: int, from_ns: int, to_ns: int) -> Plan:
    slots = [slot for name, spec in rig.specs.items() for slot in _slots(name, spec, seed, from_ns, to_ns)]
    poses = [Slot(POSE, ns, ns + _POSE_LATENCY_NS) for ns in _stamps(rig.pose_rate_hz, 0.0, from_ns, to_ns)]
    return Plan(stamp_ns, from_ns, to_ns, tuple(slots), tuple(poses))


def _slots(sensor: str, spec: SensorSpec, seed: int, from_ns: int, to_ns: int) -> Iterator[Slot]:
    for stamp_ns in _stamps(spec.rate_hz, spec.phase_ms, from_ns, to_ns):
        draw = generator(seed, "arrival", sensor, stamp_ns)
        late_ns = round((spec.latency_ms + spec.jitter_ms * draw.random()) * 1e6)
        yield Slot(sensor, stamp_ns, stamp_ns + late_ns, bool(draw.random() < spec.loss))


def _stamps(rate_hz: float, phase_ms: float, from_ns: int, to_ns: int) -> Iterator[int]:
    """Yield the stamps of a clock, from `from_ns` to before `to_ns`."""
    first_ns = START_NS + round(phase_ms * 1e6)
    k = max(int((from_ns - first_ns) * rate_hz / 1e9) - 1, 0)
    while (stamp_ns := first_ns + round(k * 1e9 / rate_hz)) < to_ns:
        if stamp_ns >= from_ns:
            yield stamp_ns
        k += 1
