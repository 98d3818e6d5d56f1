"""Applying to messages what a user says about their sensors."""

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
