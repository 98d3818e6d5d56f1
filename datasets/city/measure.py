"""Messages and ground truth of one instant, as pure functions of the world, the instant and the sensor."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from typing import assert_never

import numpy as np

from fbench.datasets.city.camera.picture import picture
from fbench.datasets.city.instant import EGO, BodyStates, Rays
from fbench.datasets.city.rays.caster import EmbreeCaster, Instant
from fbench.datasets.city.rig import POSE, CameraSpec, LidarSpec, RadarSpec, RigSpec, SensorSpec
from fbench.datasets.city.sensors.lidar import sweep
from fbench.datasets.city.sensors.radar import scan
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.weather import Weather
from fbench.replay.data.arrays import Array, Float32, Float64, Int64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import Rig
from fbench.replay.geometry.transforms import wrap_angle


@dataclass(frozen=True, eq=False)
class Seen2D:
    """Bodies in one image, B of them, in ascending order."""

    body: Int64  # (B,) indices of actors
    full_px: Float64  # (B, 4) rectangles around all pixels that show the body or would, if nothing were in front of it
    visible_px: Float64  # (B, 4) those around the pixels that do show it; equal to `full_px` where none does
    num_full: Int64  # (B,) pixels
    num_visible: Int64


@dataclass(frozen=True, eq=False)
class Measured:
    """One message and what it hit."""

    message: Image | PointCloud | RadarScan
    num_points: Int64  # (A,) points or echoes of each actor; zeros of an image
    seen: Seen2D | None = None  # Of an image


def count_hits(body: Array, num_actors: int) -> Int64:
    """Count how often each actor was hit (A,)."""
    return np.bincount(body[body >= 0], minlength=num_actors).astype(np.int64)


def outline_bodies(body: Array, alone: tuple[tuple[int, Int64], ...]) -> Seen2D:
    """Outline bodies in an image, of which `body` (H, W) says what each pixel shows: an actor's index, negative for
    anything else; `alone` are of every actor the ascending indices of pixels, row by row, that would show it if it were
    alone.
    """
    flat, width = body.ravel(), body.shape[1]
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
    """Left, top, right, bottom of pixels, each a unit square around its center."""
    u, v = pixels % width, pixels // width
    return float(u.min()) - 0.5, float(v.min()) - 0.5, float(u.max()) + 0.5, float(v.max()) + 0.5


START_NS = 1_700_000_000_000_000_000  # Stamp of a log's beginning
LEAD_S = 1.0  # So long the traffic runs before, so that a sensor's turn that ends at the beginning has begun in it
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

    stamp_ns: int  # The instant
    from_ns: int
    to_ns: int
    slots: tuple[Slot, ...]  # By sensor, then by stamp
    poses: tuple[Slot, ...]


def time_s(stamp_ns: int) -> float:
    """Time of the traffic simulation at a stamp."""
    return (stamp_ns - START_NS) / 1e9 + LEAD_S


def plans(rig: RigSpec, seconds: float, seed: int) -> Iterator[Plan]:
    """Yield what is measured in a log of `seconds`, instant by instant."""
    end_ns, from_ns, last_ns = START_NS + round(seconds * 1e9), START_NS, None
    reference = rig.specs[rig.reference]
    for stamp_ns in chain(_stamps(reference.rate_hz, reference.phase_ms, START_NS, end_ns), [end_ns]):
        if last_ns is not None:
            to_ns = (last_ns + stamp_ns) // 2 if stamp_ns < end_ns else end_ns
            slots = [slot for name, spec in rig.specs.items() for slot in _slots(name, spec, seed, from_ns, to_ns)]
            poses = [Slot(POSE, ns, ns + _POSE_LATENCY_NS) for ns in _stamps(rig.pose_rate_hz, 0.0, from_ns, to_ns)]
            yield Plan(last_ns, from_ns, to_ns, tuple(slots), tuple(poses))
            from_ns = to_ns
        last_ns = stamp_ns


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

    caster: EmbreeCaster
    street_lamps_m: Float64  # (L, 3)
    weather: Weather
    seed: int
    rig: Rig


def measure(around: Surroundings, states: BodyStates, spec: CameraSpec | LidarSpec | RadarSpec, slot: Slot) -> Measured:
    """Return what a sensor measures at the instant of `states`, and of which bodies."""
    num, mount = len(around.caster.actors), around.rig.body_T_sensor(slot.sensor)
    now = Instant(around.caster, states, around.weather, around.street_lamps_m, around.seed, slot.sensor, mount,
                  slot.stamp_ns, slot.log_ns)  # fmt: skip
    match spec:
        case CameraSpec():
            shot = picture(now, spec)
            return Measured(shot.image, np.zeros(num, np.int64), outline_bodies(shot.body, shot.alone))
        case LidarSpec():
            turn = sweep(now, spec)
            return Measured(turn.cloud, count_hits(turn.body, num))
        case RadarSpec():
            echoes = scan(now, spec)
            return Measured(echoes.message, count_hits(echoes.body, num))
        case _:
            assert_never(spec)


EYE_M = 1.8  # Height of the point above the ego vehicle's middle from which bodies are looked at
_GRID = 12  # Rays across a body, in both directions


def visible_shares(caster: EmbreeCaster, states: BodyStates, bodies: Int64, range_m: float) -> Float64:
    """Return the visible share (B,) of each of `bodies` (B,), 0 to 1, in clear air. Of the rays over a body's outline
    that would hit it if it were alone, the share that do; seen from `EYE_M` above the middle of the ego vehicle. A body
    that no ray of its grid hits counts as unseen.
    """
    if not len(bodies):
        return np.zeros(0)
    origin = states.position_m[EGO] + [0.0, 0.0, EYE_M]
    directions = np.concatenate([_rays_over(caster, states, int(i), origin) for i in bodies])
    owner = np.repeat(bodies, _GRID * _GRID)
    hits = caster.cast(Rays(origin[None], directions, range_m), states)
    alone = {body: rays[owner[rays] == body] for body, rays in hits.alone}
    shares = {body: float((hits.body[rays] == body).mean()) for body, rays in alone.items() if len(rays)}
    return np.array([shares.get(int(i), 0.0) for i in bodies])


def _rays_over(caster: EmbreeCaster, states: BodyStates, i: int, origin: Float64) -> Float32:
    """Unit vectors (`_GRID` squared, 3) evenly over the angles that the box of body `i` takes."""
    length, width, height = caster.actors[i].body.size_lwh_m
    to_body, cos, sin = states.position_m[i] - origin, np.cos(states.yaw_rad[i]), np.sin(states.yaw_rad[i])
    # Corners of the footprint, and its point nearest to the origin, where its box looks tallest, in its axes.
    half_l, half_w = length / 2, width / 2
    x = np.array([-half_l, -half_l, half_l, half_l, np.clip(-cos * to_body[0] - sin * to_body[1], -half_l, half_l)])
    y = np.array([-half_w, half_w, -half_w, half_w, np.clip(sin * to_body[0] - cos * to_body[1], -half_w, half_w)])
    x, y = x * cos - y * sin + to_body[0], x * sin + y * cos + to_body[1]
    heading = np.arctan2(to_body[1], to_body[0])
    azimuth = (np.arctan2(y, x) - heading + np.pi) % (2 * np.pi) - np.pi
    altitude = np.arctan2(to_body[2] + np.array([[0.0], [height]]), np.hypot(x, y))
    steps = (np.arange(_GRID) + 0.5) / _GRID
    across = heading + azimuth.min() + steps * (azimuth.max() - azimuth.min())
    up = altitude.min() + steps * (altitude.max() - altitude.min())
    a, e = np.meshgrid(across, up)
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    return rays.reshape(-1, 3).astype(np.float32)


MIN_PIXELS = 30
MIN_VISIBLE = 0.1
"""Bodies of which an image shows less, in pixels or as a share, are ignored there: nobody could find them."""


def truth_at(
    caster: EmbreeCaster, states: BodyStates, stamp_ns: int, measured: Sequence[Measured], range_m: float
) -> Truth:
    """Return all bodies within `range_m` [m] of the ego vehicle and all that images show.

    Boxes are in body coordinates at `stamp_ns`, velocities over ground in body axes. Bodies that can't be seen from the
    ego vehicle in clear air, whatever its sensors, are marked as ignored.

    `states` are those of all bodies at the stamp, `measured` the messages that belong to it.
    """
    offset = states.position_m[:, :2] - states.position_m[EGO, :2]
    near = np.sqrt((offset * offset).sum(axis=1)) <= range_m
    near[EGO] = False
    bodies = np.flatnonzero(near)
    visibility = visible_shares(caster, states, bodies, 2 * range_m)
    labels, centers = _labels_and_centers(caster, states, bodies)
    num_points = {kind: np.zeros(len(caster.actors), np.int64) for kind in (PointCloud, RadarScan, Image)}
    for one in measured:
        num_points[type(one.message)] += one.num_points
    moves = (states.velocity_mps[bodies] != 0).any(axis=1)
    attributes = ["parked" if caster.actors[i].parked else "moving" if m else "stopped"
                  for i, m in zip(bodies, moves, strict=True)]  # fmt: skip
    boxes = Boxes3D(
        center_m=centers,
        size_lwh_m=np.array([caster.actors[i].body.size_lwh_m for i in bodies], np.float64).reshape(-1, 3),
        yaw_rad=wrap_angle(states.yaw_rad[bodies] - states.yaw_rad[EGO]),
        velocity_mps=_in_body(states, states.velocity_mps[bodies]), label=labels, track_id=bodies,
        visibility=visibility, attribute=np.array(attributes, np.str_), num_lidar_pts=num_points[PointCloud][bodies],
        num_radar_pts=num_points[RadarScan][bodies], ignore=visibility == 0, source_label=labels,
    )  # fmt: skip
    seen = [(one.message.sensor, one.seen) for one in measured if one.seen is not None]
    return Truth(stamp_ns, stamp_ns, boxes, _boxes2d(caster, states, seen) if seen else None)


def _boxes2d(caster: EmbreeCaster, states: BodyStates, images: Sequence[tuple[str, Seen2D]]) -> Boxes2D:
    bodies, full_px, visible_px, num_full, num_visible = (
        np.concatenate([getattr(seen, field.name) for _, seen in images]) for field in fields(Seen2D)
    )
    labels, centers = _labels_and_centers(caster, states, bodies)
    shares, distance = num_visible / num_full, np.sqrt((centers * centers).sum(axis=1))
    relative = _in_body(states, states.velocity_mps[bodies] - states.velocity_mps[EGO])
    return Boxes2D(
        camera=np.array([name for name, seen in images for _ in seen.body], np.str_),
        xyxy_px=full_px, visible_xyxy_px=visible_px, label=labels, track_id=bodies, distance_m=distance,
        range_rate_mps=(centers * relative).sum(axis=1) / np.maximum(distance, 1e-9), visibility=shares,
        ignore=(num_visible < MIN_PIXELS) | (shares < MIN_VISIBLE), source_label=labels,
    )  # fmt: skip


def _labels_and_centers(
    caster: EmbreeCaster, states: BodyStates, bodies: Int64
) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.str_]], Float64]:
    """Labels (B,), and middles of boxes (B, 3) in body coordinates."""
    own = [caster.actors[i].body for i in bodies]
    half = np.array([[0, 0, body.size_lwh_m[2] / 2] for body in own], np.float64).reshape(-1, 3)
    centers = _in_body(states, states.position_m[bodies] + half - states.position_m[EGO])
    return np.array([body.label for body in own], np.str_), centers


def _in_body(states: BodyStates, xyz: Float64) -> Float64:
    """Turn vectors (B, 3) from the world's axes into those of the ego vehicle."""
    cos, sin = np.cos(states.yaw_rad[EGO]), np.sin(states.yaw_rad[EGO])
    x, y, z = xyz[:, 0], xyz[:, 1], xyz[:, 2]
    return np.stack([cos * x + sin * y, cos * y - sin * x, z], axis=1)
