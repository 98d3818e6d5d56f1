"""What a user says about the topics of a log goes before what the log says."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

from fbench.replay.errors import ConfigError
from fbench.replay.logs.codec import SENSORS
from fbench.replay.logs.container import Container
from fbench.replay.logs.roles import Role
from fbench.replay.logs.setup import SensorSetup, Setup
from fbench.replay.names import did_you_mean

_BOXES = ("truth", "detections")
_POSES = ("pose", "odometry")


def arranged(roles: Mapping[int, Role], container: Container, setup: Setup) -> dict[int, Role]:
    """Return the roles as the setup wants them; without a setup, as they are.

    Raises:
        ConfigError: where the setup names topics that aren't in the log, that hold something else, or one topic twice.
    """
    _require_once(setup)
    found = dict(roles)
    if setup.sensors:
        found = _only_sensors(found, container, setup)
    if setup.pose:
        found = _only_pose(found, container, setup)
    else:
        found = {id_: role for id_, role in found.items() if role.kind != "odometry"}
    return _boxes(found, container, setup)


def _require_once(setup: Setup) -> None:
    topics: dict[str, str] = {}
    for name, sensor in setup.sensors.items():
        if sensor.topic in topics:
            first = topics[sensor.topic]
            raise ConfigError(
                f"{setup.source}: sensors '{first}' and '{name}' have one topic, '{sensor.topic}'", "CFG003"
            )
        topics[sensor.topic] = name
    twice = set(setup.truth_topics or ()) & set(setup.result_topics)
    for topic in sorted(twice):
        raise ConfigError(f"{setup.source}: topic '{topic}' is both truth and results", "CFG003")
    for topic in (*(setup.truth_topics or ()), *setup.result_topics):
        if topic in topics:
            raise ConfigError(f"{setup.source}: topic '{topic}' is both boxes and sensor '{topics[topic]}'", "CFG003")


def _only_sensors(roles: Mapping[int, Role], container: Container, setup: Setup) -> dict[int, Role]:
    """Take these sensors, with these names, and no others."""
    names = {sensor.topic: name for name, sensor in setup.sensors.items()}
    if not {channel.topic for channel in container.channels.values()} & set(names):
        what = f"none of its topics is in {container.path.name}, so it is about other logs"
        raise ConfigError(f"{setup.source}: {what}; give another with --config FILE, or --config none", "CFG001")
    for name, sensor in setup.sensors.items():
        _require_sensor(name, sensor, roles, container, setup)
    renamed = {
        role.sensor: names[role.topic]
        for _, role in sorted(roles.items())
        if role.kind in SENSORS and role.topic in names
    }
    found: dict[int, Role] = {}
    for id_, role in roles.items():
        if role.topic in names and (role.kind in SENSORS):
            found[id_] = _as_sensor(role, names[role.topic], setup.sensors[names[role.topic]])
        elif role.kind == "calibration" and role.is_own:
            if role.sensor in renamed:
                found[id_] = replace(role, sensor=renamed[role.sensor])
        elif role.kind not in SENSORS:
            found[id_] = role
    return found


def _require_sensor(
    name: str, sensor: SensorSetup, roles: Mapping[int, Role], container: Container, setup: Setup
) -> None:
    topics = {channel.topic for channel in container.channels.values()}
    where = f"{setup.source}: sensor '{name}'"
    if sensor.topic not in topics:
        if not sensor.optional:
            hint = did_you_mean(sensor.topic, topics)
            raise ConfigError(f"{where}: the log has no topic '{sensor.topic}'{hint}", "CFG001")
        return
    fitting = [role for role in roles.values() if role.topic == sensor.topic]
    if not fitting:
        empty = not any(container.counts.get(i, 1) for i, c in container.channels.items() if c.topic == sensor.topic)
        if empty and sensor.optional:
            return
        what = "has no messages" if empty else "holds nothing that can be read as a sensor"
        raise ConfigError(f"{where}: topic '{sensor.topic}' {what}", "CFG001")
    for role in fitting:
        possible = (role.kind,) if role.codec is None else role.codec.kinds
        if role.kind not in SENSORS or sensor.kind not in possible:
            raise ConfigError(f"{where}: topic '{sensor.topic}' holds {role.kind}, not {sensor.kind}", "CFG001")


def _as_sensor(role: Role, name: str, sensor: SensorSetup) -> Role:
    return replace(role, kind=sensor.kind, sensor=name, frame_id=sensor.frame or role.frame_id)


def _only_pose(roles: Mapping[int, Role], container: Container, setup: Setup) -> dict[int, Role]:
    chosen = {id_ for id_, role in roles.items() if role.topic == setup.pose}
    _require_topics("body.pose", (setup.pose,), roles, (*_POSES, "transform"), container, setup)
    kept = {id_: role for id_, role in roles.items() if role.kind not in _POSES}
    # Transforms stay what they are, since they may tell the rig as well: see `tf_poses`.
    return kept | {id_: replace(roles[id_], kind="pose") for id_ in sorted(chosen) if roles[id_].kind in _POSES}


def _boxes(roles: Mapping[int, Role], container: Container, setup: Setup) -> dict[int, Role]:
    """Tell truth from results by the topics that are named, else by their names."""
    truth = setup.truth_topics
    _require_topics("truth.topics", truth or (), roles, _BOXES, container, setup)
    _require_topics("results.topics", setup.result_topics, roles, _BOXES, container, setup)

    def kind(role: Role) -> str:
        if role.topic in setup.result_topics:
            return "detections"
        if truth is None:
            return role.kind
        return "truth" if role.topic in truth else "detections"

    return {id_: replace(role, kind=kind(role)) if role.kind in _BOXES else role for id_, role in roles.items()}


def _require_topics(
    key: str,
    topics: Iterable[str],
    roles: Mapping[int, Role],
    kinds: Collection[str],
    container: Container,
    setup: Setup,
) -> None:
    there = {role.topic: role.kind for _, role in sorted(roles.items())}
    for topic in topics:
        if there.get(topic) in kinds:
            continue
        if topic not in {channel.topic for channel in container.channels.values()}:
            known = [name for name, kind in there.items() if kind in kinds]
            raise ConfigError(
                f"{setup.source}: {key}: the log has no topic '{topic}'{did_you_mean(topic, known)}", "CFG001"
            )
        what = there.get(topic, "something that can't be read")
        raise ConfigError(f"{setup.source}: {key}: topic '{topic}' holds {what}", "CFG001")
