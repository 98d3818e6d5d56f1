"""Applying to messages what a user says about their sensors."""

from collections.abc import Mapping
from dataclasses import replace

from fbench.replay.data import Message, RadarScan
from fbench.replay.logs.setup import Setup

EGO_MOTION = "ego_motion"
VELOCITY_PERIOD = "velocity_period_mps"


def as_set_up(message: Message, setup: Setup) -> Message:
    """Return a message with the signs that fbench gives to its values."""
    sensor = setup.sensors.get(message.sensor)
    if sensor is None or sensor.doppler == "receding" or not isinstance(message, RadarScan):
        return message
    rate = message.radial_velocity_mps
    return message if rate is None else replace(message, radial_velocity_mps=-rate)


def facts(setup: Setup) -> dict[str, str]:
    """Return what pipelines must know of sensors, as metadata of the log: `radar.NAME.KEY`."""
    found: dict[str, str] = {}
    for name, sensor in setup.sensors.items():
        if sensor.kind != "radar":
            continue
        if sensor.ego_motion == "removed":
            found[f"radar.{name}.{EGO_MOTION}"] = sensor.ego_motion
        if sensor.velocity_period_mps is not None:
            found[f"radar.{name}.{VELOCITY_PERIOD}"] = f"{sensor.velocity_period_mps:g}"
    return found


def with_names(metadata: Mapping[str, str], names: Mapping[str, str]) -> dict[str, str]:
    """Return metadata that speak of sensors by their new names; `names` are these by the old ones."""
    return {_renamed(key, names): value for key, value in metadata.items()}


def _renamed(key: str, names: Mapping[str, str]) -> str:
    kind, _, rest = key.partition(".")
    sensor, _, fact = rest.rpartition(".")
    return f"{kind}.{names[sensor]}.{fact}" if kind == "radar" and sensor in names else key
