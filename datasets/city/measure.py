"""Making of one message: a pure function of the world, the instant and the sensor."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from typing import assert_never

import numpy as np

from fbench.datasets.city.camera.picture import picture
from fbench.datasets.city.instant import Instant
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.hits import RayCaster
from fbench.datasets.city.rig import POSE, CameraSpec, LidarSpec, RadarSpec, RigSpec, SensorSpec
from fbench.datasets.city.sensors.lidar import sweep
from fbench.datasets.city.sensors.radar import scan
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.arrays import Array, Float64, Int64
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import Rig


@dataclass(frozen=True, eq=False)
class Seen2D:
    """Bodies in one image, B of them, in ascending order."""

    body: Int64
    """(B,) indices of actors."""
    full_px: Float64
    """(B, 4) rectangles around all pixels that show the body or would, if nothing were in front of it."""
    visible_px: Float64
    """(B, 4) those around the pixels that do show it; equal to `full_px` where none does."""
    num_full: Int64
    """(B,) pixels."""
    num_visible: Int64


@dataclass(frozen=True, eq=False)
class Measured:
    """One message and what it hit."""

    message: Image | PointCloud | RadarScan
    num_points: Int64
    """(A,) points or echoes of each actor; zeros of an image."""
    seen: Seen2D | None = None
    """Of an image."""


def counted(body: Array, num_actors: int) -> Int64:
    """Count how often each actor was hit (A,)."""
    return np.bincount(body[body >= 0], minlength=num_actors).astype(np.int64)


def seen_bodies(body: Array, alone: tuple[tuple[int, Int64], ...]) -> Seen2D:
    """Outline bodies in an image.

    Args:
        body: (H, W) what each pixel shows: an actor's index, negative for anything else.
        alone: Of every actor the ascending indices of pixels, row by row, that would show it if it were alone.
    """
    width = body.shape[1]
    flat = body.ravel()
    full = [_rectangle(pixels, width) for _, pixels in alone]
    shown = [pixels[flat[pixels] == i] for i, pixels in alone]
    visible = [_rectangle(px, width) if len(px) else box for px, box in zip(shown, full, strict=True)]
    return Seen2D(
        np.array([i for i, _ in alone], np.int64),
        np.array(full, np.float64).reshape(-1, 4),
        np.array(visible, np.float64).reshape(-1, 4),
        np.array([len(pixels) for _, pixels in alone], np.int64),
        np.array([len(pixels) for pixels in shown], np.int64),
    )


def _rectangle(pixels: Int64, width: int) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of pixels, each a unit square around its centre."""
    u, v = pixels % width, pixels // width
    return float(u.min()) - 0.5, float(v.min()) - 0.5, float(u.max()) + 0.5, float(v.max()) + 0.5


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


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What all messages of a log have in common."""

    caster: RayCaster
    street_lamps_m: Float64
    """(L, 3)."""
    weather: Weather
    seed: int
    rig: Rig


def measure(around: Surroundings, states: BodyStates, spec: CameraSpec | LidarSpec | RadarSpec, slot: Slot) -> Measured:
    """Return what a sensor measures at the instant of `states`, and of which bodies."""
    now, num = _instant(around, states, slot), len(around.caster.actors)
    match spec:
        case CameraSpec():
            shot = picture(now, spec)
            return Measured(shot.image, np.zeros(num, np.int64), seen_bodies(shot.body, shot.alone))
        case LidarSpec():
            turn = sweep(now, spec)
            return Measured(turn.cloud, counted(turn.body, num))
        case RadarSpec():
            echoes = scan(now, spec)
            return Measured(echoes.message, counted(echoes.body, num))
        case _:
            assert_never(spec)


def _instant(around: Surroundings, states: BodyStates, slot: Slot) -> Instant:
    return Instant(
        around.caster, states, around.weather, around.street_lamps_m, around.seed, slot.sensor,
        around.rig.body_T_sensor(slot.sensor), slot.stamp_ns, slot.log_ns,
    )  # fmt: skip
