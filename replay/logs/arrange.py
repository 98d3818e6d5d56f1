"""User settings applied to the topics and messages of a log."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.contracts.faults import UNREAD
from fbench.replay.data.messages import Message, RadarScan
from fbench.replay.data.metadata import EGO, Outline
from fbench.replay.logs.codecs.codec import SENSORS
from fbench.replay.logs.codecs.foxglove.topics import RESULTS2D, RESULTS3D
from fbench.replay.logs.container import Container
from fbench.replay.logs.roles import Role
from fbench.replay.logs.setup import SensorSetup, Setup

_BOXES = ("truth", "detections")
_POSES = ("pose", "odometry")


def arrange(roles: Mapping[int, Role], container: Container, setup: Setup) -> dict[int, Role]:
    """Return the roles as the setup wants them; without a setup, as they are. Raises ConfigError where the setup names
    topics that aren't in the log, that hold something else, or one topic twice.
    """
    _require_once(setup)
    found = _choose_sensors(roles, container, setup) if setup.sensors else _drop_repeats(roles, container)
    if setup.pose:
        _require_topics(f"{setup.source}: body.pose", (setup.pose,), found, (*_POSES, "transform"), container)
        poses = {id_: role for id_, role in sorted(found.items()) if role.kind in _POSES and role.topic == setup.pose}
        # Transforms stay what they are, since they may tell the rig as well: see `TfPoses`.
        found = {id_: role for id_, role in found.items() if role.kind not in _POSES}
        found |= {id_: replace(role, kind="pose") for id_, role in poses.items()}
    else:
        found = {id_: role for id_, role in found.items() if role.kind != "odometry"}
    _require_topics(f"{setup.source}: truth.topics", setup.truth_topics or (), found, _BOXES, container)
    _require_topics(f"{setup.source}: results.topics", setup.result_topics, found, _BOXES, container)
    for id_, role in found.items():
        is_result = role.topic in setup.result_topics
        if role.kind in _BOXES and (is_result or setup.truth_topics is not None):  # else their names tell
            is_truth = role.topic in (setup.truth_topics or ()) and not is_result
            found[id_] = replace(role, kind="truth" if is_truth else "detections")
    return found


def _drop_repeats(roles: Mapping[int, Role], container: Container) -> dict[int, Role]:
    """Leave out topics of which another one has the measurements in a better form."""
    for _, role in sorted(roles.items()):
        if role.same_as:
            what = f"'{role.same_as}' holds the measurements of the same sensor"
            container.once(UNREAD, (role.topic,), f"topic '{role.topic}' is left out: {what}")
    return {id_: role for id_, role in roles.items() if not role.same_as}


def _require_once(setup: Setup) -> None:
    topics: dict[str, str] = {}
    for name, sensor in setup.sensors.items():
        if (first := topics.setdefault(sensor.topic, name)) != name:
            what = f"sensors '{first}' and '{name}' have one topic, '{sensor.topic}'"
            raise ConfigError(f"{setup.source}: {what}", "CFG003")
    for topic in sorted(set(setup.truth_topics or ()) & set(setup.result_topics)):
        raise ConfigError(f"{setup.source}: topic '{topic}' is both truth and results", "CFG003")
    for topic in (*(setup.truth_topics or ()), *setup.result_topics):
        if topic in topics:
            raise ConfigError(f"{setup.source}: topic '{topic}' is both boxes and sensor '{topics[topic]}'", "CFG003")


def _choose_sensors(roles: Mapping[int, Role], container: Container, setup: Setup) -> dict[int, Role]:
    """Take these sensors, with these names, and no others."""
    names = {sensor.topic: name for name, sensor in setup.sensors.items()}
    if not {channel.topic for channel in container.channels.values()} & set(names):
        what = f"none of its topics is in {container.path.name}, so it is about other logs"
        raise ConfigError(f"{setup.source}: {what}; give another with --config FILE, or --config none", "CFG001")
    for name, sensor in setup.sensors.items():
        _require_sensor(f"{setup.source}: sensor '{name}'", sensor, roles, container)
    chosen = {id_: names[role.topic] for id_, role in roles.items() if role.kind in SENSORS and role.topic in names}
    renamed = {roles[id_].sensor: name for id_, name in sorted(chosen.items())}
    found: dict[int, Role] = {}
    for id_, role in roles.items():
        if id_ in chosen:
            sensor = setup.sensors[chosen[id_]]
            frame_id = sensor.frame or role.frame_id
            found[id_] = replace(role, kind=sensor.kind, sensor=chosen[id_], frame_id=frame_id)
        elif role.kind == "calibration" and role.is_own:
            if role.sensor in renamed:
                found[id_] = replace(role, sensor=renamed[role.sensor])
        elif role.kind not in SENSORS:
            found[id_] = role
    return found


def _require_sensor(where: str, sensor: SensorSetup, roles: Mapping[int, Role], container: Container) -> None:
    ids = {id_: channel.topic for id_, channel in container.channels.items()}
    if sensor.topic not in ids.values():
        if not sensor.optional:
            hint = did_you_mean(sensor.topic, set(ids.values()))
            raise ConfigError(f"{where}: the log has no topic '{sensor.topic}'{hint}", "CFG001")
        return
    fitting = [role for role in roles.values() if role.topic == sensor.topic]
    if not fitting:
        empty = not any(container.counts.get(id_, 1) for id_, topic in ids.items() if topic == sensor.topic)
        if empty and sensor.optional:
            return
        unread = "holds nothing that can be read as a sensor; if a decoder plug-in reads it, name that with --decoder"
        what = "has no messages" if empty else unread
        raise ConfigError(f"{where}: topic '{sensor.topic}' {what}", "CFG001")
    for role in fitting:
        possible = (role.kind,) if role.codec is None else role.codec.kinds
        if role.kind not in SENSORS or sensor.kind not in possible:
            raise ConfigError(f"{where}: topic '{sensor.topic}' holds {role.kind}, not {sensor.kind}", "CFG001")


def _require_topics(
    where: str, topics: Iterable[str], roles: Mapping[int, Role], kinds: Collection[str], container: Container
) -> None:
    there = {role.topic: role.kind for _, role in sorted(roles.items())}
    for topic in topics:
        if there.get(topic) in kinds:
            continue
        if topic not in {channel.topic for channel in container.channels.values()}:
            hint = did_you_mean(topic, [name for name, kind in there.items() if kind in kinds])
            raise ConfigError(f"{where}: the log has no topic '{topic}'{hint}", "CFG001")
        what = there.get(topic, "something that can't be read")
        raise ConfigError(f"{where}: topic '{topic}' holds {what}", "CFG001")


def apply_setup(message: Message, setup: Setup) -> Message:
    """Return a message with the signs that fbench gives to its values."""
    sensor = setup.sensors.get(message.sensor)
    if sensor is None or sensor.doppler == "receding" or not isinstance(message, RadarScan):
        return message
    rate = message.radial_velocity_mps
    return message if rate is None else replace(message, radial_velocity_mps=-rate)


def facts(setup: Setup) -> dict[str, str]:
    """Return what pipelines must know of sensors, and scores of the vehicle, as metadata of the log: `radar.NAME.KEY`,
    `ego.KEY`.
    """
    lengths = zip(fields(Outline), setup.outline_m or (), strict=False)
    found = {f"{EGO}.{field.name}": str(length_m) for field, length_m in lengths}
    for name, sensor in setup.sensors.items():
        if sensor.kind == "radar" and sensor.ego_motion == "removed":
            found[f"radar.{name}.ego_motion"] = sensor.ego_motion
        if sensor.kind == "radar" and sensor.velocity_period_mps is not None:
            found[f"radar.{name}.velocity_period_mps"] = f"{sensor.velocity_period_mps:g}"
    return found


def rename(metadata: Mapping[str, str], names: Mapping[str, str]) -> dict[str, str]:
    """Return metadata that speak of sensors by their new names; `names` are these by the old ones."""
    result: dict[str, str] = {}
    for key, value in metadata.items():
        kind, _, rest = key.partition(".")
        sensor, _, fact = rest.rpartition(".")
        result[f"{kind}.{names[sensor]}.{fact}" if kind == "radar" and sensor in names else key] = value
    return result


def box_channels(roles: Mapping[int, Role], topic: str, log: Path) -> frozenset[int]:
    """Channels of a topic with boxes, else of the only one with results. Raises LogError where none or several fit."""
    boxes = {id_: role for id_, role in sorted(roles.items()) if role.kind in _BOXES}
    known = sorted({role.topic for role in boxes.values()})
    if not topic:
        named = {role.topic for role in boxes.values() if role.kind == "detections"}
        # Of one system's boxes in 3D and in images, which importers keep on two topics, those in 3D are meant.
        results = sorted(named - ({RESULTS2D} if RESULTS3D in named else set()))
        if len(results) != 1:
            truth = f", only truth: {', '.join(known)}" if known else " with boxes"
            none = f"there is none{truth}; `fbench replay --detections PATH` takes them from elsewhere"
            choice = f"there are: {', '.join(results)}" if results else none
            raise LogError(f"{log}: which topic holds the results? {choice}", "CFG001")
        topic = results[0]
    found = frozenset(id_ for id_, role in boxes.items() if topic in (role.topic, role.sensor))
    if not found:
        raise LogError(f"{log}: no topic '{topic}' with boxes{did_you_mean(topic, known)}", "CFG001")
    return found
