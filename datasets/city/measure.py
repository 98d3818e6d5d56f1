"""Making one message: a pure function of the world, the instant and the sensor."""

from dataclasses import dataclass
from typing import assert_never

import numpy as np

from fbench.datasets.city.camera.picture import picture
from fbench.datasets.city.instant import Instant
from fbench.datasets.city.measured import Measured, counted, seen_bodies
from fbench.datasets.city.motion import BodyStates
from fbench.datasets.city.rays.hits import RayCaster
from fbench.datasets.city.rig import CameraSpec, LidarSpec, RadarSpec
from fbench.datasets.city.schedule import Slot
from fbench.datasets.city.sensors.lidar import sweep
from fbench.datasets.city.sensors.radar import scan
from fbench.replay.arrays import Float64
from fbench.replay.data import Rig
from fbench.replay.weather import Weather


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
